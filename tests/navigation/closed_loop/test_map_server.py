"""The first scenario of the paper in README.md: configs/ros_map_server.yaml.

Its map comes from a map_server on a real ROS 1 network.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from bridge.hub.wire.qos import Durability, Qos
from bridge.messages.actions import GoalState
from tests.peers.navigation.chain import Chain
from tests.peers.ros1.network import ROS1_PYTHON, RosMaster, needs_ros1
from tests.support.process import Process
from tests.support.wait import until

ROOT = Path(__file__).parents[3]
KEPT = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
MAP_SERVER = ROOT / "tests" / "peers" / "ros1" / "map_server.py"


@pytest.mark.thorough
@needs_ros1
def test_the_robot_drives_on_the_map_of_a_map_server(tmp_path: Path) -> None:
    written: dict[str, Any] = yaml.safe_load((ROOT / "configs" / "ros_map_server.yaml").read_text())
    assert "maps" not in written["store"]
    master = RosMaster()
    chain = Chain(tmp_path)
    for part in ("navigation", "modules"):
        chain.config[part] = written[part]
    chain.config["store"] = {"locations": str(ROOT / "configs" / written["store"]["locations"])}
    chain.config["ros1"] = {"enabled": True, "master": master.uri}
    server = None
    try:
        master.start()
        with chain:
            chain.start()
            server = Process([ROS1_PYTHON, MAP_SERVER, ROOT / "configs" / "apartment" / "apartment.yaml"], master.env)
            said: list[str] = []
            heard = lambda message: said.append(message["data"])  # noqa: E731
            chain.client.node.subscription("/localization/status", "std_msgs/msg/String", heard, KEPT)
            until(lambda: said[-1:] == ["localized_ok"], "the localizer has the map of map_server", 40)
            # each module subscribes to the map itself, and a planner without a map refuses goals
            until(lambda: chain.status("robot_path_planner").get("map"), "the planner has the map too", 40)
            asked = chain.goto("living_room")
            until(lambda: asked.ended, "the drive ends", 60)
            assert asked.status is GoalState.SUCCEEDED, asked
            assert chain.distance_to("living_room") < 0.3
    finally:
        if server is not None:
            server.stop()
        master.close()
