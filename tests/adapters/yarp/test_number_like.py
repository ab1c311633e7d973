"""A daemon whose name YARP could read as a number, at a name server that behaves like ``yarpserver``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.adapters.yarp.network import DAEMON, OWNER, PRESENCE
from tests.adapters.yarp.conftest import Place
from tests.peers.yarp.name_server import RealNameServer
from tests.support.ports import free_port
from tests.support.wait import until

STRING, OUTPUT = "std_msgs/String", "/midspan/chatter:o"


@pytest.fixture(name="server")
def fixture_server() -> Iterator[RealNameServer]:
    with RealNameServer(free_port(room=20)) as server:
        yield server


@pytest.fixture(name="site")
def fixture_site(tmp_path: Path, server: RealNameServer) -> Iterator[Place]:
    """A place with this name server."""
    place = Place(tmp_path)
    place.names.stop()
    place.names = server
    try:
        yield place
    finally:
        place.close()


@pytest.mark.parametrize("name", ["1e5", "42", "0x10", "010", "1-2", "true", "null", "inf"])
def test_daemon_bridges_and_recognizes_its_ports(site: Place, server: RealNameServer, name: str) -> None:
    """The name is stored as it is, and a port keeps its owner when the name server has lost its registrations."""
    site.bridge(name=name)
    publisher = site.far.advertise("/chatter", STRING, latched=True)
    site.far.publish(publisher, {"data": "hello"})
    listener = site.port("/listener")
    listener.listen_to(OUTPUT)
    assert listener.bottles() == [["hello"]]

    def owner() -> list[str]:
        return [str(value) for value in server.client.get_property(OUTPUT, OWNER)]

    until(owner, "the port is marked")
    (before,) = owner()
    presence = PRESENCE + before
    assert presence in server.ports
    until(lambda: server.stored(presence, DAEMON) == [name], "the daemon's name is stored")
    server.clear()
    until(lambda: owner() == [before], "the port is registered again with its owner", 20)


NUMBERS = ["1e5", "42", "0x10", "010", "-", "1.5-2", "75e5e286e164", "+5", ".5", "true", "false", "null", "nan"]
LISTS = ["[ok]", "[vocab]", "[a b]", "(a b)", "(a", "{1 2}", "a b", "a,b", "a\\b", "a\nb", ""]


@pytest.mark.parametrize("text", [*NUMBERS, *LISTS])
def test_property_is_stored_as_it_is(server: RealNameServer, text: str) -> None:
    server.client.register("/port")
    server.client.set_property("/port", "key", text)
    assert server.stored("/port", "key") == [text]
