"""A name server client limits pending commands in time while other threads start more of them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.support.ports import free_port
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.naming.server import NameServer


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
