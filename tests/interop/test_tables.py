"""configs/tables.yaml, unchanged: a robot with a depth camera drives around a table that its laser does not see.

A real rclpy program receives the layer, a real rospy program the bumper.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.interop.test_mapper3d import value
from tests.peers.daemon.deployment import Deployment
from tests.support.missing import DART, need
from tests.support.ports import free_port
from tests.support.wait import until

CONFIGS = Path(__file__).parents[2] / "configs"
SIDEBOARD = (3.4, 1.1)
BOARDS = [(2.05, 2.55), (2.25, 2.35), (2.45, 2.15)]
"""Places under the dining table, on the straight line from the dock to the goal. The robot drives around them only if
the camera sees them. The middle and the far end of the tabletop are visible briefly or not at all, depending on the
path."""


@pytest.mark.thorough
@pytest.mark.timeout(300)  # the robot drives for about 40 s of simulated time
def test_a_goal_on_the_far_side_of_a_table_is_reached_without_contact(deployment: Deployment) -> None:
    need(DART)
    config: dict[str, Any] = yaml.safe_load((CONFIGS / "tables.yaml").read_text())
    config["yarp"] |= {"address": f"127.0.0.1:{free_port()}"}
    config["store"] = {key: str(CONFIGS / file) for key, file in config["store"].items()}
    deployment.start(**{key: section for key, section in config.items() if key != "name"})
    ros1, ros2 = deployment.ros1(), deployment.ros2()
    bumps = ros1.subscribe("/bumper", "std_msgs/Bool")
    assert ros1.wait(bumps, 1)

    def stored() -> bool:
        return "sideboard" in deployment.command("location", "list").stdout.split()

    until(stored, "the locations are in the store", 60, every=1.0)
    went = deployment.command("goto", "sideboard", "--timeout", "240", seconds=280)
    assert went.returncode == 0, went.stdout + went.stderr
    truths = ros2.subscribe("/ground_truth", "nav_msgs/Odometry")
    at = ros2.wait(truths, 1)[-1]["pose"]["pose"]["position"]
    assert math.dist((at["x"], at["y"]), SIDEBOARD) < 0.25
    layers = ros2.subscribe("/mapper3d/layer", "nav_msgs/OccupancyGrid", latched=True, depth=1)
    layer = ros2.wait(layers, 1)[-1]
    assert layer["header"]["frame_id"] == "map"
    assert [value(layer, *cell) for cell in BOARDS] == [100] * len(BOARDS)
    contacts = [message["data"] for message in ros1.wait(bumps, 1)]
    assert len(contacts) > 50
    assert not any(contacts), "the robot ran into something"
