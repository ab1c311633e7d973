"""Beside a ``yarpserver --ros``: what is ROS 1's crosses by the ROS 1 side alone."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bridge.adapters.yarp.graph import Ros1Ports
from tests.adapters.yarp.conftest import Place
from tests.support.ports import free_port
from tests.support.ros1 import RosMaster, needs_ros1
from tests.support.wait import until
from tests.support.yarp_name_server import RealNameServer
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NamingError
from yarp_compat.ports.port import PortCore
from yarp_compat.wire.binary import encode
from yarp_compat.wire.profile import Profile

pytestmark = needs_ros1

STRING = "std_msgs/String"
ROS_CARRIERS = ("tcp", "fast_tcp", "udp", "tcpros", "rossrv", "xmlrpc")


@pytest.fixture(scope="module", name="master")
def fixture_master() -> Iterator[RosMaster]:
    master = RosMaster()
    master.start()
    yield master
    master.stop()


class NativeNaming(NameClient):
    """A name server's client that tells of the carriers which a C++ program with YARP's ROS support has."""

    def announce(self, name: str, alive: bool = True) -> None:
        self.set_property(name, "offers", *ROS_CARRIERS)
        self.set_property(name, "type", "std_msgs/String")
        super().announce(name, alive)


class Network:
    """The names of a `Place`, at a name server that behaves as the real one."""

    def __init__(self, server: RealNameServer) -> None:
        self.server = server
        self.client = NameClient(server.address)
        self.endpoint = f"{server.address.host}:{server.address.port}"

    def stop(self) -> None:
        """It ends with its fixture."""


class NativeNode:
    """What a C++ program with a ``yarp::os::Node`` and one port registers; it counts what comes by YARP.

    Args:
        names: the network.
        port: the port's name, with the node's behind its ``@``.
        naming: what its program tells the name server.
    """

    def __init__(self, names: Network, port: str, naming: type[NameClient] = NativeNaming) -> None:
        self.came: list[bytes] = []
        client = naming(names.server.address)
        self.node = PortCore(port.partition("@")[2], naming=client)
        self.port = PortCore(port, naming=client, on_message=self._hear, type_name="std_msgs/String")
        for core in (self.node, self.port):
            core.open()

    def _hear(self, message: PortMessage) -> None:
        self.came.append(bytes(message.payload))

    def stop(self) -> None:
        for core in (self.port, self.node):
            core.close()


@pytest.fixture(name="site")
def fixture_site(tmp_path: Path, master: RosMaster) -> Iterator[Place]:
    """A place whose YARP name server is on the ROS 1 master."""
    with RealNameServer(free_port(room=20), master.uri) as server:
        made = Place(tmp_path)
        made.names.stop()
        made.names = Network(server)  # type: ignore[assignment]
        try:
            yield made
        finally:
            made.close()


def native(site: Place, port: str, naming: type[NameClient] = NativeNaming) -> NativeNode:
    return site.keep(NativeNode(site.names, port, naming))  # type: ignore[no-any-return, arg-type]


def expect_crossing(site: Place, heard: Callable[[], object], what: str) -> None:
    """Publish on the hub until it is heard."""
    publisher = site.far.advertise("/chatter", STRING)

    def once() -> object:
        site.far.publish(publisher, {"data": "hello"})
        return heard()

    until(once, what, every=0.1)


def test_to_a_port_that_is_ros1s_nothing_goes_by_yarp(site: Place, master: RosMaster) -> None:
    """34 of 62 messages came twice: once by TCPROS from the ROS 1 side, once from a port of the YARP side."""
    listener = native(site, "/chatter-@/listener")
    site.bridge(ros1={"enabled": True, "master": master.uri})
    plain = site.port("/plain")
    expect_crossing(site, lambda: "/plain" in connected(site), "the output port of the topic is there")
    expect_crossing(site, lambda: len(plain.messages(5, 0.1)) >= 5, "a port without ROS gets the topic")
    assert not listener.port.inputs()
    assert listener.came == []


def connected(site: Place) -> set[str]:
    """Connect the plain port once the topic's is there; who is connected."""
    with contextlib.suppress(NamingError):
        connections.connect(site.names.client, "/midspan/chatter:o", "/plain")
        return {"/plain"}
    return set()


@pytest.mark.parametrize("where", ["no ROS 1 side", "another master"])
def test_where_the_ros1_side_is_not_on_that_master_it_goes_by_yarp(site: Place, where: str) -> None:
    listener = native(site, "/chatter-@/listener")
    other = f"http://127.0.0.1:{free_port()}/"
    site.bridge(ros1={"enabled": False} if where == "no ROS 1 side" else {"enabled": True, "master": other})
    expect_crossing(site, lambda: listener.came, "the port is written to")


def test_from_a_port_that_is_ros1s_nothing_comes_by_yarp(site: Place, master: RosMaster) -> None:
    """Beside it a program of `yarp_compat`, which the master has in name alone: it speaks no TCPROS."""
    talker, ours = native(site, "/chatter+@/talker"), native(site, "/chatter+@/ours", NameClient)
    site.bridge(ros1={"enabled": True, "master": master.uri})
    heard = site.far.subscribe("/chatter", STRING)
    site.names.client.set_property("/chatter+@/ours", "type", "std_msgs/String")

    def said() -> bool:
        for core, text in ((talker.port, "twice"), (ours.port, "once")):
            core.write(encode([text], Profile.YARP3), strict=True)
        return bool(ours.port.outputs())

    until(said, "the program of yarp_compat is heard by YARP", every=0.1)
    said()
    assert {message["data"] for message in site.far.wait(heard, 1)} == {"once"}
    assert not talker.port.outputs()


def test_a_connection_that_was_made_before_is_ended(site: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """The master may come after the program."""
    known = frozenset[str]()
    monkeypatch.setattr(Ros1Ports, "among", lambda *_: known)
    listener = native(site, "/chatter-@/listener")
    site.bridge()
    expect_crossing(site, lambda: listener.came, "the port is written to")
    known = frozenset({"/chatter-@/listener"})
    until(lambda: not listener.port.inputs(), "the connection is ended")
