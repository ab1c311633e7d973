"""The whole daemon between real ROS 1 and ROS 2 programs and the dialects of zenoh networks."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.interop.test_topics import cross
from tests.peers.daemon.deployment import Deployment
from tests.peers.zenoh.programs import JsonProgram, Ros1Bridge, Ros2ddsBridge
from tests.support.rosbags_messages import Messages
from tests.support.wait import until

PAGE = Path(__file__).parents[2] / "docs" / "sides" / "zenoh.md"
STRING, GRID = "std_msgs/String", "nav_msgs/OccupancyGrid"
MAP = {"info": {"resolution": 0.5, "width": 2, "height": 2}, "data": [0, 100, -1, 50]}
SIDES = ("zenoh_ros2dds", "zenoh_ros1", "zenoh_json")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)


@pytest.fixture
def programs(deployment: Deployment) -> Iterator[dict[str, Any]]:
    """The daemon with all dialects on the hub's own network, and a program on each side and dialect."""
    keys = [
        {"key": f"json/{a}_{b}_{label}", "topic": f"/{a}_{b}_{label}", "type": type_.replace("/", "/msg/")}
        for a, b in (("ros1", "json"), ("ros2", "json"), ("json", "ros1"), ("json", "ros2"))
        for label, type_ in (("text", STRING), ("map", GRID))
    ]
    documented = yaml.safe_load(next(block for block in blocks("yaml") if "robot/mode" in block))
    keys += documented["zenoh"]["dialects"][0]["keys"]
    dialects = [
        {"dialect": "ros2dds"},
        {"dialect": "ros1", "latched": ["/*_map"]},
        {"dialect": "json", "keys": [key | {"latched": "json_" in key["key"] and "map" in key["key"]} for key in keys]},
    ]
    deployment.start(zenoh={"dialects": dialects})
    until(lambda: all(deployment.worker(s).get("state") == "running" for s in SIDES), "the dialects are joined", 40)
    endpoint = f"tcp/127.0.0.1:{deployment.port}"
    bridges = {
        "ros2dds": Ros2ddsBridge(endpoint, Messages(ros1=False)),
        "ros1keys": Ros1Bridge(endpoint, Messages(ros1=True)),
        "json": JsonProgram(endpoint),
    }
    yield {**bridges, "ros1": deployment.ros1(), "ros2": deployment.ros2()}
    for bridge in bridges.values():
        bridge.stop()


def test_real_programs_exchange_messages_with_every_dialect(programs: dict[str, Any], deployment: Deployment) -> None:
    """Texts cross in each direction, late joiners receive a latched map, and the documented script works."""
    pairs = [(a, b) for a in ("ros1", "ros2") for b in ("ros2dds", "ros1keys", "json")]
    for from_, to in pairs + [(b, a) for a, b in pairs]:
        name = f"/{from_}_{to}_text"
        subscription = programs[to].subscribe(f"/json{name}" if to == "json" else name, STRING)
        out = programs[from_].advertise(f"/json{name}" if from_ == "json" else name, STRING)
        assert cross(programs[from_], out, programs[to], subscription, {"data": name})["data"] == name
    for from_, to in pairs:
        name = f"/{from_}_{to}_map"
        out = programs[from_].advertise(name, GRID, latched=True, depth=1)
        programs[from_].publish(out, MAP)
        side = {"ros2dds": "zenoh_ros2dds", "ros1keys": "zenoh_ros1", "json": "zenoh_json"}[to]
        deployment.until_route(side, name, "out", messages=1)
        if to == "json":
            got = programs[to].get(f"json{name}")[0][0]
        else:
            late = programs[to].subscribe(name, GRID, latched=True, depth=1)
            got = programs[to].wait(late, 1)[0]
        assert (got["data"], got["info"]["width"]) == (MAP["data"], 2)
    for to, from_ in pairs:
        name = f"/{from_}_{to}_map"
        out = programs[from_].advertise(f"/json{name}" if from_ == "json" else name, GRID, latched=True, depth=1)
        if from_ != "ros2dds":
            programs[from_].until_subscribed(out)
        programs[from_].publish(out, MAP)
        deployment.until_route(to, name, "out", messages=1)
        late = programs[to].subscribe(name, GRID, latched=True, depth=1)
        assert programs[to].wait(late, 1)[0]["data"] == MAP["data"]
    _the_documented_script(programs, deployment)


def _the_documented_script(programs: dict[str, Any], deployment: Deployment) -> None:
    mode = programs["ros1"].advertise("/mode", STRING, latched=True)
    programs["ros1"].publish(mode, {"data": "autonomous"})
    deployment.until_route("zenoh_json", "/mode", "out", messages=1)
    goal = programs["ros2"].subscribe("/goal", "geometry_msgs/PoseStamped")
    script = blocks("python")[0].replace("tcp/127.0.0.1:7447", f"tcp/127.0.0.1:{deployment.port}")

    def driven() -> list[dict]:
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=30, check=True)
        assert "{'data': 'autonomous'}" in done.stdout
        goals: list[dict] = programs["ros2"].wait(goal, 1, 1.0)
        return goals

    assert until(driven, "the goal reaches ROS 2", 60)[0]["pose"]["position"]["x"] == 1.0

    def printed() -> bool:  # a busy worker may not respond to the command in time
        status = deployment.command("status").stdout
        return all(side in status for side in SIDES) and "hub -> ros2dds keys" in status

    until(printed, "midspan status has all dialects")
