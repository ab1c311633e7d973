"""`hurry` limits the time of a name server client's pending commands, even while other threads start more of them."""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import pytest

from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer
from yarp_compat.ports import sockets
from yarp_compat.ports.naming import NoNameServerError


@pytest.fixture
def eager_threads() -> Iterator[None]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("eager_threads")
def test_hurry_works_while_other_threads_send_queries() -> None:
    address = Address("127.0.0.1", free_port(room=20))
    server = NameServer(address.host, address.port, gc_seconds=0).open()
    client = NameClient(address)
    try:
        with ThreadPoolExecutor(4) as pool:
            queries = [pool.submit(client.query, "/robot") for _ in range(400)]
            while not all(query.done() for query in queries):
                client.hurry(20.0)
            assert [query.result() for query in queries] == [None] * 400
    finally:
        server.close()


def test_hurry_ends_a_connection_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Linux ignores connections to a socket whose backlog is full, as a firewall that drops packets does."""
    connecting = threading.Event()
    connect = sockets.open_connection

    def open_connection(*args: object) -> socket.socket:
        connecting.set()
        return connect(*args)  # type: ignore[arg-type]

    monkeypatch.setattr("yarp_compat.ports.text_client.open_connection", open_connection)
    with ExitStack() as stack:
        full = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
        for _ in range(4):
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(full.getsockname())
        client = NameClient(Address(*full.getsockname()), timeout=60.0)
        with ThreadPoolExecutor(1) as pool:
            query = pool.submit(client.query, "/robot")
            until(connecting.is_set, "the client connects")
            client.hurry(0.1)
            with pytest.raises(NoNameServerError, match=r"no reply within 0\.1 s"):
                query.result(20.0)
