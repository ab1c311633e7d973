"""A real master's node on a machine that loses the address under which the node is registered."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.adapters.ros1.environment import worker_environment
from bridge.config.model import Config
from tests.peers.peer import on_machine
from tests.peers.ros1.adapter import PROGRAM, ROOT
from tests.peers.ros1.network import ROS1_PYTHON, needs_ros1, ros1_environment
from tests.support.netns import Machine, ip, need_namespaces
from tests.support.process import Process
from tests.support.wait import until

pytestmark = needs_ros1

ADDRESS = "203.0.113.7"  # of TEST-NET-3 (RFC 5737)
MASTER = "http://127.0.0.1:11311"


@pytest.fixture
def robot() -> Iterator[Machine]:
    need_namespaces()
    with contextlib.closing(Machine("ros1robot")) as machine:
        yield machine


@pytest.fixture
def roscore(robot: Machine, tmp_path: Path) -> Iterator[Process]:
    log = {"ROS_HOME": str(tmp_path), "ROS_LOG_DIR": str(tmp_path / "log")}
    process = robot.start(ROS1_PYTHON, "/usr/bin/roscore", env={**ros1_environment(MASTER), **log})
    yield process
    process.stop()


def test_a_lost_address_is_reported_until_it_returns(robot: Machine, roscore: Process, tmp_path: Path) -> None:
    """The node stays registered under it, for instance after this machine has joined another Wi-Fi network."""
    address = ("-n", robot.namespace, "address")
    ip(*address, "add", f"{ADDRESS}/32", "dev", "lo")
    section = {"master": MASTER, "ip": ADDRESS, "poll": 0.1}
    config = Config.model_validate({"name": "robot", "state": tmp_path, "ros1": section})
    environ = {k: v for k, v in os.environ.items() if not k.startswith("ROS_")}
    env = {**worker_environment(config, environ), "PYTHONPATH": str(ROOT)}
    words = PROGRAM, config.model_dump_json(by_alias=True), str(tmp_path)
    with on_machine(robot, env, sys.executable, *words) as edge:

        def lost() -> list[Any]:
            return [
                text for text in edge.ask("status")["warnings"] if f"does not have the address {ADDRESS} now" in text
            ]

        edge.ask("start")
        until(lambda: edge.ask("network")["network"], "the edge joins the master")
        assert lost() == []
        ip(*address, "delete", f"{ADDRESS}/32", "dev", "lo")
        (text,) = until(lost, "the address is reported")
        assert "its ROS 1 node is registered" in text
        assert text.endswith("restart the daemon with its current address (ros1.ip, ros1.hostname)")
        ip(*address, "add", f"{ADDRESS}/32", "dev", "lo")
        until(lambda: not lost(), "the warning ends")
        edge.ask("stop", patience=40.0)
