"""A network that appears after the edge's start: rclpy on another machine is discovered after a restart of the edge."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from bridge.adapters.ros2.edge import Ros2Edge
from bridge.adapters.ros2.environment import worker_environment
from bridge.config.model import Config
from bridge.messages.registry import Registry
from tests.peers.listener import Listener
from tests.peers.peer import Peer, on_machine
from tests.peers.ros2.network import ROS2_PEER, ros2_domain, ros2_environment, ros2_python
from tests.support.netns import Cable, Machine, need_namespaces
from tests.support.wait import until

ROOT = Path(__file__).parents[3]
STRING = "std_msgs/String"


@pytest.fixture
def machines() -> Iterator[tuple[Machine, Machine]]:
    """A robot and another computer without a link."""
    need_namespaces()
    pair = Machine("ddsrobot"), Machine("ddsother")
    yield pair
    for machine in pair:
        machine.close()


def edge(machine: Machine, state: Path) -> Peer:
    # the two share one /dev/shm, through which they would discover each other without a network
    section = {"domain": ros2_domain(), "localhost_only": False, "transport": "udp"}
    config = Config.model_validate({"ros2": section})
    env = {**worker_environment(config, os.environ), "PYTHONPATH": str(ROOT), "HOME": str(state)}
    words = "-m", "tests.peers.ros2.adapter_program", json.dumps({"ros2": section}), str(state)
    return on_machine(machine, env, sys.executable, *words)


def test_an_edge_ends_when_a_network_appears_and_its_successor_uses_it(
    machines: tuple[Machine, Machine], tmp_path: Path
) -> None:
    robot, other = machines
    ros2_python()
    first = edge(robot, tmp_path)
    with first:
        assert first.ask("status")["failed"] == []
        Cable(robot, other)
        (reason,) = until(lambda: first.ask("status")["failed"], "the edge requests a restart", 20)
        assert "a new address that the ROS 2 side does not use: 10.77.0.1 on eth77: restarting" in reason
        assert reason.removesuffix(": restarting") in first.ask("status")["warnings"], "status and doctor report it"
    until(lambda: "state UP" in other.run("ip", "link", "show", "eth77"), "the link is up on the other machine, too")
    env = ros2_environment(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET", FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
    with on_machine(other, env, sys.executable, ROS2_PEER, "remote") as remote, edge(robot, tmp_path) as second:
        remote.advertise("/remote", STRING)
        until(lambda: "publisher /remote native" in second.ask("status")["endpoints"], "it discovers the node", 20)
        status = second.ask("status")
        assert (status["failed"], [text for text in status["warnings"] if "new address" in text]) == ([], [])


@pytest.mark.parametrize("profile", [None, "own.xml"])
def test_the_edge_restarts_only_without_a_custom_profile(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, profile: str | None
) -> None:
    failures: list[str] = []

    class Listener:
        edge_failed = staticmethod(failures.append)

    config = Config.model_validate({"ros2": {"localhost_only": False, "profile": profile}})
    ros2 = Ros2Edge(config, Registry(), tmp_path)
    ros2._listener = Listener()  # type: ignore[assignment]
    ros2._use_new_addresses("a new address")
    assert failures == ([] if profile else ["a new address: restarting"])
    assert ("restart the worker" in caplog.text) == bool(profile)


def test_an_address_that_appears_while_the_participant_starts_counts_as_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At boot, Wi-Fi often gets its address in the half second that the participant needs to start."""
    steps: list[str] = []

    def addresses() -> dict[str, list[object]]:
        steps.append("addresses")
        return {}

    def join(*_: object) -> None:
        steps.append("join")
        raise InterruptedError

    ros2 = Ros2Edge(Config.model_validate({"ros2": {"localhost_only": False}}), Registry(), tmp_path)
    monkeypatch.setattr(psutil, "net_if_addrs", addresses)
    monkeypatch.setattr(ros2._dds, "join", join)
    with pytest.raises(InterruptedError):
        ros2.start(Listener())
    assert steps == ["addresses", "join"]
