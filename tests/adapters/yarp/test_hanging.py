"""A name server or port that accepts connections but never responds does not delay the worker's exit."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.adapters.yarp.conftest import Place
from tests.contract.side import WorkerProcess
from tests.support.ports import free_port
from tests.support.processor_share import ProcessorShare
from tests.support.wait import until
from yarp_compat.naming.config import Address

pytestmark = pytest.mark.alone

STRING = "std_msgs/String"
TOPICS = 20
STOP_SECONDS = 2.0
"""Seconds guaranteed by `bridge.worker.Worker.stop`."""


@contextmanager
def hanging(address: Address) -> Iterator[socket.socket]:
    """Listen at an address without ever responding."""
    with socket.create_server((address.host, address.port), backlog=1000) as server:
        server.settimeout(20)
        yield server


def test_hanging_name_server_does_not_delay_the_workers_exit(place: Place) -> None:
    for number in range(TOPICS):
        place.far.advertise(f"/topic_{number}", STRING)
    worker = WorkerProcess("yarp", place.config(), dict(os.environ))
    try:
        until(lambda: len(place.names.client.list("/midspan")) > 2 * TOPICS, "the worker's ports are registered", 20)
        place.names.stop()
        with hanging(place.names.address) as server:
            waiting = server.accept()[0]  # the worker sends a query and gets no reply
            share, began = ProcessorShare(), time.monotonic()
            worker.stop()
            took, limit = time.monotonic() - began, STOP_SECONDS / share.least()
            waiting.close()
        print(f"exited after {took:.2f} s")
        assert took <= limit
    finally:
        worker.process.stop()


def test_hanging_ports_do_not_delay_the_workers_exit(place: Place) -> None:
    address = Address("127.0.0.1", free_port())
    rules = []
    for number in range(TOPICS):
        topic, port = f"/words_{number}", f"/still_{number}"
        rules.append({"topic": topic, "port": port, "direction": "in", "type": "std_msgs/msg/String"})
        place.names.client.lines(["register", port, "tcp", address.host, address.port])
        place.far.subscribe(topic, STRING)
    with hanging(address) as server:
        worker = WorkerProcess("yarp", place.config(yarp={"topics": rules}), dict(os.environ))
        try:
            waiting = [server.accept()[0] for _ in range(8)]  # the worker's concurrent connection requests
            share, began = ProcessorShare(), time.monotonic()
            worker.stop()
            took, limit = time.monotonic() - began, STOP_SECONDS / share.least()
            for connection in waiting:
                connection.close()
        finally:
            worker.process.stop()
    print(f"exited after {took:.2f} s")
    assert took <= limit
    assert [c.name for c in place.names.client.list("/midspan")] == []
