"""A name server or a port that takes connections and never answers holds up nobody's end."""

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
from tests.support.wait import until
from yarp_compat.naming.config import Address

pytestmark = pytest.mark.alone

STRING = "std_msgs/String"
TOPICS = 20
STOP_SECONDS = 2.0
"""What `bridge.worker.Worker.stop` promises."""


@contextmanager
def hanging(address: Address) -> Iterator[socket.socket]:
    """Something that listens there, and does nothing else."""
    with socket.create_server((address.host, address.port), backlog=1000) as server:
        server.settimeout(20)
        yield server


def test_a_hanging_name_server_does_not_hold_up_a_workers_end(place: Place) -> None:
    for number in range(TOPICS):
        place.far.advertise(f"/topic_{number}", STRING)
    worker = WorkerProcess("yarp", place.config(), dict(os.environ))
    try:
        until(lambda: len(place.names.client.list("/midspan")) > 2 * TOPICS, "its ports are registered", 20)
        place.names.stop()
        with hanging(place.names.address) as server:
            waiting = server.accept()[0]  # it asks, and gets no answer
            began = time.monotonic()
            worker.stop()
            took = time.monotonic() - began
            waiting.close()
        print(f"ended after {took:.2f} s")
        assert took <= STOP_SECONDS
    finally:
        worker.process.stop()


def test_hanging_ports_do_not_hold_up_a_workers_end(place: Place) -> None:
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
            waiting = [server.accept()[0] for _ in range(8)]  # as many as the worker asks at once to connect
            began = time.monotonic()
            worker.stop()
            took = time.monotonic() - began
            for connection in waiting:
                connection.close()
        finally:
            worker.process.stop()
    print(f"ended after {took:.2f} s")
    assert took <= STOP_SECONDS
    assert [c.name for c in place.names.client.list("/midspan")] == []
