"""The TCP port numbers of our ports, with a name server that assigns numbers without a check for free ones."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from tests.peers.yarp.name_server import RealNameServer
from tests.support.ports import free_port
from tests.support.wait import until
from tests.yarp_compat.naming.test_restart import are_registered
from yarp_compat.naming import client as client_module
from yarp_compat.naming.allocation import LAST_OFFSET, numbers_outside
from yarp_compat.naming.client import NameClient
from yarp_compat.ports.port import PortCore


@pytest.fixture(name="server")
def fixture_server() -> Iterator[RealNameServer]:
    with RealNameServer(free_port(room=20)) as server:
        yield server


def native_open(names: NameClient, name: str) -> None:
    """Open a port like YARP's ``Port::open``: register, then listen only on the assigned number."""
    contact = names.register(name)
    try:
        with socket.socket() as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.bind(("", contact.port))
            sock.listen()
    finally:
        names.unregister(name)


def test_open_ports_do_not_block_the_numbers_of_new_programs(
    server: RealNameServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A restarted yarpserver assigns its first numbers again; our ports must not use any of them."""
    monkeypatch.setattr(client_module, "PERIOD", 0.05)
    names, native = NameClient(server.address), NameClient(server.address)
    ours = [PortCore(f"/ours/{i}", naming=names) for i in range(5)]
    try:
        for port in ours:
            port.open()
        server.clear()
        for i in range(5):
            native_open(native, f"/at_once/{i}")  # before our ports are registered again
        until(are_registered(names, *ours), "our ports are registered again")
        for i in range(5):
            native_open(native, f"/later/{i}")
    finally:
        for port in ours:
            port.close()
    assert not server.ports


def test_a_reopened_port_keeps_its_number(server: RealNameServer) -> None:
    """This also holds after the name server restarts; if another program listens on the number, another one is used."""
    names = NameClient(server.address)
    port = PortCore("/ours", naming=names)
    first = port.open().port
    port.close()
    server.clear()
    assert port.open().port == first
    port.close()
    with socket.socket() as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a connection of the port may be in TIME_WAIT
        other.bind(("127.0.0.1", first))
        other.listen()
        second = port.open().port
        port.close()
    assert second != first
    assert {first, second} <= set(names.numbers)


@pytest.mark.parametrize("base", [1024, 10000, 45536, 45537, 60000, 65000])
def test_numbers_of_our_ports_are_outside_the_range_of_the_name_server(base: int) -> None:
    """The range is as long as the name server's, and the two are disjoint."""
    numbers = numbers_outside(base)
    assert len(numbers) == LAST_OFFSET + 1
    assert numbers[0] > 1024
    assert numbers[-1] <= 0xFFFF
    assert not set(numbers) & set(range(base, base + LAST_OFFSET + 1))


def test_numbers_are_in_the_requested_range(server: RealNameServer) -> None:
    """A site's firewall may need a fixed range; with an empty range, the name server chooses."""
    base = server.address.port
    for numbers in (range(base + 30, base + 60), range(0)):
        port = PortCore("/ours", naming=NameClient(server.address, numbers=numbers))
        number = port.open().port
        port.close()
        assert number in (numbers or range(base + 2, base + 3))
