"""A YARP script uses ROS topics: a separate program without ROS, which gets the message types from the daemon."""

from __future__ import annotations

from tests.adapters.yarp.conftest import Place
from tests.peers.yarp.script import output_lines, start
from tests.support.wait import until


def test_yarp_script_publishes_and_subscribes(place: Place) -> None:
    place.bridge()
    subscription = place.far.subscribe("/velocity", "geometry_msgs/Twist")
    goal = place.far.advertise("/goal", "geometry_msgs/PoseStamped")
    (place.folder / "yarp.conf").write_text(f"{place.names.address.host} {place.names.address.port} yarp\n")
    script = start("ros_topics", place.folder)
    try:
        velocity = place.far.wait(subscription, 1, 60)[0]
        assert (velocity["linear"]["x"], velocity["angular"]["z"]) == (0.25, -1.5)
        pose = {
            "header": {"stamp": {"sec": 7, "nanosec": 5}, "frame_id": "map"},
            "pose": {
                "position": {"x": 3.5, "y": 0.0, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
        }
        until(lambda: place.far.publish(goal, pose) or script.poll() is not None, "the script ends", 20, 0.1)
        assert output_lines(script) == ["map 7 3.5 1.0"]
    finally:
        script.kill()
        script.wait()
