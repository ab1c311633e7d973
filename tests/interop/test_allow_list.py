"""The shipped allow list in use; the demo runs demo.yaml, and default.yaml changes no default."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from tests.interop.test_life import TWIST, twist
from tests.interop.test_topics import cross
from tests.peers.daemon.deployment import Deployment
from tests.support.wait import until

pytestmark = pytest.mark.thorough

FILE = Path(__file__).parents[2] / "configs" / "allow_list.yaml"
STRING, ODOMETRY = "std_msgs/String", "nav_msgs/Odometry"


def test_unlisted_topics_do_not_cross(deployment: Deployment) -> None:
    deployment.start(**yaml.safe_load(FILE.read_text()))
    ros1, ros2 = deployment.ros1(), deployment.ros2()
    for sender in (ros1, ros2):
        sender.advertise("/unnamed", STRING)
    subscription = ros2.subscribe("/odom", ODOMETRY)
    out = ros1.advertise("/odom", ODOMETRY)
    assert cross(ros1, out, ros2, subscription, {"child_frame_id": "base"})["child_frame_id"] == "base"
    subscription = ros1.subscribe("/cmd_vel", TWIST)
    out = ros2.advertise("/robot1/cmd_vel", TWIST)
    assert cross(ros2, out, ros1, subscription, twist(0.1)) == twist(0.1)
    until(lambda: len(deployment.explain("/unnamed")) == 2, "both sides have decided on /unnamed", 20)
    assert {line["decision"] for line in deployment.explain("/unnamed")} == {"denied"}
    assert not deployment.route("ros2", "/unnamed", "out")
