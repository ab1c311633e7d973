"""Static peers (``ROS_STATIC_PEERS``): rclpy and another daemon on another machine, without multicast."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest

from bridge.adapters.ros2.dds.fast import FastDds
from bridge.adapters.ros2.graph import spdp
from bridge.adapters.ros2.graph.origins import new_prefix
from bridge.adapters.ros2.profile import addresses, static_peers
from bridge.config.model import Config
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
    """Otherwise both would bridge the same nodes. A killed daemon's successor disposes it on the other machine.

    The gateway does not forward multicast.
    """
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
            first.ask("advertise", topic="/mine")
            until(lambda: "publisher /mine midspan" in second.ask("status")["endpoints"], "and the other way round", 20)
            first.popen.kill()
            first.popen.wait()
        with edge(robot, tmp_path / "robot") as successor:
            successor.ask("status")  # it has started
            until(
                lambda: "publisher /mine midspan" not in second.ask("status")["endpoints"],
                "disposed by its successor",
                8,
            )


def test_static_peers_receive_the_disposal_of_a_predecessor(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[tuple[str, bytes]] = []
    monkeypatch.setattr(spdp, "send_all", lambda *_arguments, **_more: None)
    monkeypatch.setattr(spdp, "send_to", lambda peers, messages, _domain: sent.extend(product(peers, messages)))
    dds, dead = FastDds(Config.model_validate({"ros2": {"domain": 1}})), new_prefix(b"\x01\x0f\x12\x34")
    dds._peers = ("10.0.0.2",)
    dds.refresh(new_prefix(b"\x01\x0f\x12\x34"), [dead], 0)
    assert sent == [("10.0.0.2", spdp.disposal(dead))], "not the prompt, which names this machine's loopback"


@pytest.mark.parametrize(("text", "peers"), [("", []), ("10.0.0.1", ["10.0.0.1"]), (" a ;b;;a", ["a", "b"])])
def test_peers_are_separated_by_semicolons(text: str, peers: list[str]) -> None:
    assert static_peers({"ROS_STATIC_PEERS": text}) == peers
    assert static_peers({}) == []


def test_unknown_peers_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    assert list(addresses(["planner..local", "127.0.0.1"])) == ["127.0.0.1"]
    assert "ROS_STATIC_PEERS: planner..local is not a known machine" in caplog.text
