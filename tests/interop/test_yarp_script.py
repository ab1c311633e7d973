"""A YARP script without any ROS exchanges messages with real rospy and rclpy programs, through the daemon."""

from __future__ import annotations

from tests.peers.daemon.deployment import Deployment
from tests.peers.yarp.script import output_lines, start
from tests.support.ports import free_port
from tests.support.wait import until


def test_a_script_exchanges_messages_with_ros1_and_ros2(deployment: Deployment) -> None:
    number = free_port()
    deployment.start(yarp={"address": f"127.0.0.1:{number}", "nameserver": "embedded", "poll": 0.1})
    until(lambda: deployment.worker("yarp").get("state") == "running", "the YARP network is joined", 20)
    (deployment.folder / "yarp.conf").write_text(f"127.0.0.1 {number} yarp\n")
    ros1, ros2 = deployment.ros1(), deployment.ros2()
    velocity = {peer: peer.subscribe("/velocity", "geometry_msgs/Twist") for peer in (ros1, ros2)}
    pose = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 3.5}, "orientation": {"w": 1.0}}}
    for sender in (ros1, ros2):
        goal = sender.advertise("/goal", "geometry_msgs/PoseStamped")
        script = start("ros_topics", deployment.folder)
        try:
            for peer, subscription in velocity.items():
                assert peer.wait(subscription, 1, 30)[0]["angular"]["z"] == -1.5
            until(
                lambda s=sender, g=goal, r=script: s.publish(g, pose) or r.poll() is not None,
                "the script receives",
                30,
                0.1,
            )
            assert output_lines(script) == ["map 0 3.5 1.0"]
        finally:
            script.kill()
            script.wait()
        sender.drop(goal)
