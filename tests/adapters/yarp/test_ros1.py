"""With a ``yarpserver --ros``, topics of ROS 1 nodes cross only through the ROS 1 side."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bridge.adapters.yarp.graph import Ros1Ports
from tests.adapters.yarp.conftest import Place
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.peers.yarp.name_server import RealNameServer
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
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
    """A name server client that announces the carriers of a C++ program with YARP's ROS support."""

    def announce(self, name: str, alive: bool = True) -> None:
        self.set_property(name, "offers", *ROS_CARRIERS)
        self.set_property(name, "type", "std_msgs/String")
        super().announce(name, alive)


class NativeNode:
    """Registers like a C++ program with a ``yarp::os::Node`` and one port, and records messages received over YARP.

    Args:
        address: the name server.
        port: the port's name, ``/topic@/node``.
        naming: the program's name server client.
    """

    def __init__(self, address: Address, port: str, naming: type[NameClient] = NativeNaming) -> None:
        self.received: list[bytes] = []
        client = naming(address)
        self.node = PortCore(port.partition("@")[2], naming=client)
        self.port = PortCore(port, naming=client, on_message=self._on_message, type_name="std_msgs/String")
        for core in (self.node, self.port):
            core.open()

    def _on_message(self, message: PortMessage) -> None:
        self.received.append(bytes(message.payload))

    def stop(self) -> None:
        for core in (self.port, self.node):
            core.close()


@pytest.fixture(name="site")
def fixture_site(tmp_path: Path, master: RosMaster) -> Iterator[Place]:
    """A place whose YARP name server uses the ROS 1 master."""
    with RealNameServer(free_port(room=20), master.uri) as server:
        place = Place(tmp_path)
        place.names.stop()
        place.names = server
        try:
            yield place
        finally:
            place.close()


def native(site: Place, port: str, naming: type[NameClient] = NativeNaming) -> NativeNode:
    return site.keep(NativeNode(site.names.address, port, naming))  # type: ignore[no-any-return]


def publish_until(site: Place, condition: Callable[[], object], description: str) -> None:
    """Publish on the hub until the condition holds."""
    publisher = site.far.advertise("/chatter", STRING)

    def publish_and_check() -> object:
        site.far.publish(publisher, {"data": "hello"})
        return condition()

    until(publish_and_check, description, every=0.1)


def test_yarp_side_does_not_write_to_the_port_of_a_ros1_node(site: Place, master: RosMaster) -> None:
    """34 of 62 messages used to arrive twice: over TCPROS from the ROS 1 side, and from a port of the YARP side."""
    listener = native(site, "/chatter-@/listener")
    site.bridge(ros1={"enabled": True, "master": master.uri})
    plain = site.port("/plain")
    publish_until(site, lambda: connect_plain(site), "the topic's output port is open")
    publish_until(site, lambda: len(plain.messages(5, 0.1)) >= 5, "a port without ROS receives the topic")
    assert not listener.port.inputs()
    assert listener.received == []


def connect_plain(site: Place) -> bool:
    """Connect the topic's output port to ``/plain``; return False if that port is not open yet."""
    with contextlib.suppress(NamingError):
        connections.connect(site.names.client, "/midspan/chatter:o", "/plain")
        return True
    return False


@pytest.mark.parametrize("ros1_side", ["no ROS 1 side", "another master"])
def test_yarp_side_writes_to_the_port_without_a_ros1_side_on_that_master(site: Place, ros1_side: str) -> None:
    listener = native(site, "/chatter-@/listener")
    other = f"http://127.0.0.1:{free_port()}/"
    site.bridge(ros1={"enabled": False} if ros1_side == "no ROS 1 side" else {"enabled": True, "master": other})
    publish_until(site, lambda: listener.received, "the port receives the topic")


def test_yarp_side_does_not_read_the_port_of_a_ros1_node(site: Place, master: RosMaster) -> None:
    """A `yarp_compat` program is read over YARP: the master lists its name, but the program has no TCPROS server."""
    talker, ours = native(site, "/chatter+@/talker"), native(site, "/chatter+@/ours", NameClient)
    site.bridge(ros1={"enabled": True, "master": master.uri})
    subscription = site.far.subscribe("/chatter", STRING)
    site.names.client.set_property("/chatter+@/ours", "type", "std_msgs/String")

    def write_from_both() -> bool:
        for core, text in ((talker.port, "twice"), (ours.port, "once")):
            core.write(encode([text], Profile.YARP3), strict=True)
        return bool(ours.port.outputs())

    until(write_from_both, "the YARP side reads the port of the yarp_compat program", every=0.1)
    write_from_both()
    assert {message["data"] for message in site.far.wait(subscription, 1, 60)} == {"once"}
    assert not talker.port.outputs()


def test_existing_connection_to_a_ros1_node_is_closed(site: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """The connection may already exist, because the master can start after the program."""
    known = frozenset[str]()
    monkeypatch.setattr(Ros1Ports, "select", lambda *_: known)
    listener = native(site, "/chatter-@/listener")
    site.bridge()
    publish_until(site, lambda: listener.received, "the port receives the topic")
    known = frozenset({"/chatter-@/listener"})
    until(lambda: not listener.port.inputs(), "the connection is closed")
