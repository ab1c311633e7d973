"""Discovery servers: those in the environment, and whether they are reached."""

from __future__ import annotations

import errno
import socket
import sys
import threading
from pathlib import Path

import pytest

from bridge.adapters.ros2 import discovery
from bridge.adapters.ros2.discovery import Server, ServerWatch
from tests.adapters.ros2.test_new_interface import STRING, edge, machines
from tests.peers.peer import on_machine
from tests.peers.ros2.network import ROS2_PEER, SERVER, ros2_environment, ros2_python
from tests.support.netns import Cable, Machine
from tests.support.ports import free_port
from tests.support.wait import until

__all__ = ["machines"]
FAR = "192.0.2.1"
"""An address for documentation (RFC 5737), which no machine has."""


@pytest.mark.parametrize(
    ("text", "servers"),
    [
        ("", []),
        ("10.0.0.1", [Server("10.0.0.1", 11811)]),
        (";10.0.0.1:1234; planner.local", [Server("10.0.0.1", 1234), Server("planner.local", 11811)]),
        ("UDPv4:[10.0.0.1]:1234", [Server("10.0.0.1", 1234)]),
        ("TCPv4:[10.0.0.1]:1234;[::1]:1234", []),
    ],
)
def test_discovery_servers_are_read_from_the_environment(text: str, servers: list[Server]) -> None:
    assert discovery.servers({"ROS_DISCOVERY_SERVER": text}) == servers
    assert discovery.servers({}) == []


def test_servers_on_other_machines_are_excluded_by_localhost_only() -> None:
    listed = [Server("127.0.0.1", 1), Server("localhost", 1), Server(FAR, 11811)]
    text = discovery.excluded(listed)
    assert text.startswith(f"ROS_DISCOVERY_SERVER names {FAR}:11811, but ros2.localhost_only keeps")
    assert discovery.excluded(listed[:2]) == ""
    watch = ServerWatch(listed[2:], localhost_only=True)
    texts = until(lambda: watch.texts, "the exclusion is reported")
    assert texts[0] == f"{text}; set ros2.localhost_only: false"
    watch.close()


@pytest.mark.parametrize("server", [Server("127.0.0.1", 99999), Server("robot..local", 11811), Server(64 * "a", 1)])
def test_a_server_with_an_invalid_name_or_port_is_reported(monkeypatch: pytest.MonkeyPatch, server: Server) -> None:
    """Neither ends the worker, or the probes of the other servers."""
    monkeypatch.setattr(discovery, "PERIOD", 0.05)
    assert discovery.failing([server]) == [server]
    watch = ServerWatch([server, Server("127.0.0.1", free_port())], localhost_only=True)
    until(lambda: sum("no discovery server receives at" in text for text in watch.texts) == 2, "both are reported")
    watch.close()


def test_a_server_that_does_not_run_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discovery, "PERIOD", 0.05)
    server = Server("127.0.0.1", free_port())
    watch = ServerWatch([server], localhost_only=True)
    (text,) = until(lambda: watch.texts, "the server is reported")
    assert text.startswith(f"no discovery server receives at {server} (ROS_DISCOVERY_SERVER)")
    assert discovery.failing([server]) == [server]
    with socket.socket(type=socket.SOCK_DGRAM) as receiver:
        receiver.bind(server)
        until(lambda: not watch.texts, "the server runs")
        assert discovery.failing([server]) == []
    until(lambda: watch.texts, "the server has ended")
    with socket.socket(type=socket.SOCK_DGRAM) as receiver:
        receiver.bind(server)
        (text,) = until(lambda: [text for text in watch.texts if "restarted" in text], "the restart is reported")
        assert text.startswith(f"the discovery server at {server} was restarted after the ROS 2 side")
    assert discovery.failing([Server("no-such-machine.invalid", 1)])
    watch.close()


@pytest.mark.parametrize("noticed", [True, False], ids=["noticed", "between two probes"])
@pytest.mark.parametrize("lease", [30.0, 0.0], ids=["soon", "after its lease"])
def test_a_restart_is_reported_unless_fast_dds_has_forgotten_the_server(
    monkeypatch: pytest.MonkeyPatch, noticed: bool, lease: float
) -> None:
    monkeypatch.setattr(discovery, "LEASE", lease)
    server = Server("localhost", free_port())
    watched = discovery._Watched(server)
    for _ in range(2):
        with socket.socket(type=socket.SOCK_DGRAM) as receiver:
            receiver.bind(server)
            first = watched.has_restarted()
            assert not watched.has_restarted()
        if noticed:
            assert not watched.has_restarted()
            assert watched.fails
    assert first is (lease > 0 or not noticed)
    watched.close()


def test_a_slow_look_up_delays_neither_the_start_nor_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot without its network may wait half a minute for each answer of its name server."""
    asked, answered = threading.Event(), threading.Event()

    def look_up(_name: str) -> str:
        asked.set()
        assert answered.wait(40)
        return "127.0.0.1"

    monkeypatch.setattr(socket, "gethostbyname", look_up)
    server = Server("planner.local", free_port())
    watch = ServerWatch([server], localhost_only=False)
    try:
        assert asked.wait(40)
        assert watch.texts == [], "nothing is known yet"
        watch.close()
    finally:
        answered.set()
    until(lambda: "midspan-ros2-servers" not in {t.name for t in threading.enumerate()}, "the look-up ends")
    probe = watch._servers[server]._probe
    assert probe is not None
    assert probe._socket is None, "the check that had to wait closes its socket"


def test_servers_are_probed_again_after_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discovery, "PERIOD", 0.05)
    errors = [OSError(errno.EMFILE, "Too many open files")]
    has_restarted = discovery._Watched.has_restarted

    def check(watched: discovery._Watched) -> bool:
        if errors:
            raise errors.pop()
        return has_restarted(watched)

    monkeypatch.setattr(discovery._Watched, "has_restarted", check)
    watch = ServerWatch([Server("127.0.0.1", free_port())], localhost_only=False)
    until(lambda: watch.texts, "the server is reported")
    watch.close()


def test_a_server_on_another_machine_is_reached_if_not_localhost_only(
    machines: tuple[Machine, Machine], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With ``localhost_only: false`` it is reached; a report of its machine shows when it does not run."""
    robot, other = machines
    ros2_python()
    cable = Cable(robot, other)
    for machine in machines:
        until(lambda of=machine: "state UP" in of.run("ip", "link", "show", "eth77"), "the link is up")
    address, port = cable.addresses[1], free_port()
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", f"{address}:{port}")
    with edge(robot, tmp_path) as ros2:
        (text,) = until(lambda: ros2.ask("status")["warnings"], "the server is reported", 30)
        assert text.startswith(f"no discovery server receives at {address}:{port}")
        with other.start(SERVER, "-i", "0", "-l", address, "-p", str(port), env=ros2_environment()):
            until(lambda: not ros2.ask("status")["warnings"], "the server runs", 30)
            env = ros2_environment(FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
            with on_machine(other, env, sys.executable, ROS2_PEER, "remote") as remote:
                remote.advertise("/remote", STRING)
                until(lambda: "publisher /remote native" in ros2.ask("status")["endpoints"], "the node is found", 40)
