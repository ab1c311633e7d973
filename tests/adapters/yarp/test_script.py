"""A script for YARP speaks with ROS topics: another program, without any ROS, its types told by the daemon."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.adapters.yarp.conftest import Place
from tests.support.wait import until

SCRIPT = Path(__file__).parents[2] / "yarp_compat" / "scripts" / "ros_topics.py"


def test_a_script_publishes_and_subscribes(place: Place) -> None:
    place.bridge()
    heard = place.far.subscribe("/velocity", "geometry_msgs/Twist")
    goal = place.far.advertise("/goal", "geometry_msgs/PoseStamped")
    (place.folder / "yarp.conf").write_text(f"{place.names.address.host} {place.names.address.port} yarp\n")
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("ROS_", "AMENT_", "CMAKE_"))}
    script = subprocess.Popen(
        [sys.executable, "-m", "yarp_compat", str(SCRIPT)],
        env=clean | {"YARP_CONFIG_HOME": str(place.folder), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        velocity = place.far.wait(heard, 1, 20)[0]
        assert (velocity["linear"]["x"], velocity["angular"]["z"]) == (0.25, -1.5)
        pose = {
            "header": {"stamp": {"sec": 7, "nanosec": 5}, "frame_id": "map"},
            "pose": {
                "position": {"x": 3.5, "y": 0.0, "z": 0.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            },
        }
        until(lambda: place.far.publish(goal, pose) or script.poll() is not None, "the script ends", 20, 0.1)
        said = script.communicate(timeout=10)[0]
        assert "map 7 3.5 1.0" in said.splitlines(), said
        assert "no Midspan daemon" not in said
        assert script.returncode == 0, said
    finally:
        script.kill()
        script.wait()
