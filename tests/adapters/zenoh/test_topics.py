"""The queue of received messages of a key."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import zenoh

from bridge.adapters.zenoh.topics import SampleQueue
from bridge.hub.wire.qos import Qos
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.limits import BULK
from tests.support.wait import until


def test_a_large_message_waits_for_the_delivery_of_an_earlier_small_one() -> None:
    small, bulk = Dispatcher("test-small"), Dispatcher("test-bulk")
    small.start()
    bulk.start()
    entered, go_on, received = threading.Event(), threading.Event(), list[int]()

    def deliver(payload: bytes, _source: str, _time_ns: int | None) -> None:
        if len(payload) == 1:
            entered.set()
            go_on.wait(20.0)
        received.append(len(payload))

    context: Any = SimpleNamespace(small=small, bulk=bulk)
    queue = SampleQueue(deliver, Qos(depth=10), context)
    try:
        queue.add(zenoh.ZBytes(b"1"), "source", None)
        assert entered.wait(20.0)
        queue.add(zenoh.ZBytes(bytes(BULK + 1)), "source", None)
        until(lambda: bulk._busy or received, "the large message is handled")
        overtaken = bool(received)
        go_on.set()
        until(lambda: len(received) == 2, "both are delivered")
        assert not overtaken
        assert received == [1, BULK + 1]
    finally:
        go_on.set()
        small.stop()
        bulk.stop()
