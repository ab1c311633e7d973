"""The TCP port numbers of our ports, beside a name server that gives out its own without trying them."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from tests.support.ports import free_port
from tests.support.wait import until
from tests.support.yarp_name_server import RealNameServer
from tests.yarp_compat.naming.test_restart import where
from yarp_compat.naming import client as client_module
from yarp_compat.naming.allocation import LAST_OFFSET, beside
from yarp_compat.naming.client import NameClient
from yarp_compat.ports.port import PortCore


@pytest.fixture(name="server")
def fixture_server() -> Iterator[RealNameServer]:
    with RealNameServer(free_port(room=20)) as server:
        yield server


def native_open(names: NameClient, name: str) -> None:
    """What YARP's own ``Port::open`` does: register, then listen at the number it is given, and at no other."""
    contact = names.register(name)
    try:
        with socket.socket() as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.bind(("", contact.port))
            sock.listen()
    finally:
        names.unregister(name)


def test_surviving_ports_are_no_obstacle_to_new_programs(
    server: RealNameServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A yarpserver that forgot everything gives out its first numbers again: none of our ports holds one of them."""
    monkeypatch.setattr(client_module, "PERIOD", 0.05)
    names, native = NameClient(server.address), NameClient(server.address)
    ours = [PortCore(f"/ours/{i}", naming=names) for i in range(5)]
    try:
        for port in ours:
            port.open()
        server.forget()
        for i in range(5):
            native_open(native, f"/at_once/{i}")  # before ours are known again
        until(where(names, *ours), "ours are registered again")
        for i in range(5):
            native_open(native, f"/later/{i}")
    finally:
        for port in ours:
            port.close()
    assert not server.ports


def test_a_name_gets_its_number_again(server: RealNameServer) -> None:
    """Also at a name server that forgot it, and the next one where somebody listens at it."""
    names = NameClient(server.address)
    port = PortCore("/ours", naming=names)
    first = port.open().port
    port.close()
    server.forget()
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
def test_beside(base: int) -> None:
    """As many numbers as the name server gives out, and none of those."""
    numbers = beside(base)
    assert len(numbers) == LAST_OFFSET + 1
    assert numbers[0] > 1024
    assert numbers[-1] <= 0xFFFF
    assert not set(numbers) & set(range(base, base + LAST_OFFSET + 1))


def test_numbers_are_those_that_are_wanted(server: RealNameServer) -> None:
    """A range that a site's firewall lets through; an empty one leaves the choice to the name server."""
    here = server.address.port
    for numbers in (range(here + 30, here + 60), range(0)):
        port = PortCore("/ours", naming=NameClient(server.address, numbers=numbers))
        number = port.open().port
        port.close()
        assert number in (numbers or range(here + 2, here + 3))
