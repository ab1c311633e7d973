"""Static peers (``ROS_STATIC_PEERS``): rclpy and another daemon on another machine, without multicast."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.adapters.ros2.profile import static_peers
from tests.adapters.ros2.test_new_interface import STRING, edge, machines
from tests.peers.peer import on_machine
from tests.peers.ros2.network import ROS2_PEER, ros2_environment, ros2_python
from tests.support.netns import Cable, Machine
from tests.support.wait import until

__all__ = ["machines"]


def test_a_node_without_multicast_is_discovered(
    machines: tuple[Machine, Machine], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, other = machines
    ros2_python()
    cable = Cable(robot, other)
    for machine in machines:
        until(lambda of=machine: "state UP" in of.run("ip", "link", "show", "eth77"), "the link is up")
    env = ros2_environment(
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", ROS_STATIC_PEERS=cable.addresses[0],
        FASTDDS_BUILTIN_TRANSPORTS="UDPv4",
    )  # fmt: skip
    with on_machine(other, env, sys.executable, ROS2_PEER, "remote") as remote:
        remote.advertise("/remote", STRING)
        monkeypatch.setenv("ROS_STATIC_PEERS", f"no-such-machine.invalid; {cable.addresses[1]}")
        with edge(robot, tmp_path) as ros2:
            until(lambda: "publisher /remote native" in ros2.ask("status")["endpoints"], "it discovers the node", 30)


@pytest.fixture
def gateway() -> Iterator[Machine]:
    machine = Machine("ddsgateway")
    yield machine
    machine.close()


def test_two_daemons_discover_each_other_without_multicast(
    machines: tuple[Machine, Machine], gateway: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise both would bridge the same nodes. The gateway does not forward multicast."""
    ros2_python()
    gateway.run("sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward")
    for machine, net in zip(machines, (77, 78), strict=True):
        cable = Cable(machine, gateway, net)
        until(lambda of=machine, dev=f"eth{net}": "state UP" in of.run("ip", "link", "show", dev), "the link is up")
        machine.run("ip", "route", "add", "default", "via", cable.addresses[1])
    robot, other = machines
    with edge(other, tmp_path / "other") as second:
        monkeypatch.setenv("ROS_STATIC_PEERS", "10.78.0.1")
        with edge(robot, tmp_path / "robot") as first:
            second.ask("announce", record="second")
            until(lambda: "second" in first.ask("sightings")["records"], "it discovers the other daemon", 20)


@pytest.mark.parametrize(("text", "peers"), [("", []), ("10.0.0.1", ["10.0.0.1"]), (" a ;b;;a", ["a", "b"])])
def test_peers_are_separated_by_semicolons(text: str, peers: list[str]) -> None:
    assert static_peers({"ROS_STATIC_PEERS": text}) == peers
    assert static_peers({}) == []
