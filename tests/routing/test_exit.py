"""The exit: which messages from the hub it sends in C, which it leaves to the route, and how it counts them."""

from __future__ import annotations

import gc
import math
import sys
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.routing.counters import LATENCY_BOUNDS, Counters
from bridge.routing.doorway import Deadline
from bridge.routing.exit import Exit
from tests.peers.native import GID, RecordingOutput, foreign_capsule, pass_on

LIMIT = 1000
LARGEST = 64 * 1024
HOUR = 3600 * 10**9
HOURS = tuple(hour * HOUR for hour in range(1, 14))
"""Bounds of buckets that a busy machine does not exceed."""


make: Callable[..., Exit] = Exit


class Way:
    """An exit that may send, with everything that it checks."""

    def __init__(self, limit: int = LIMIT, bounds: tuple[int, ...] = LATENCY_BOUNDS) -> None:
        self.lease, self.hold = Deadline(), SimpleNamespace(held=False)
        self.lease.until = math.inf
        self.line, self.unknown = deque[Any](), deque[Any]()
        self.receiving, self.publishing = threading.Lock(), threading.Lock()
        self.output = RecordingOutput()
        locks = (self.receiving.locked, self.publishing.locked)
        self.exit = Exit(self.lease, self.hold, (self.line, self.unknown), locks, None, limit, bounds)
        self.exit.allow(frozenset((GID, b"other")))
        self.exit.send_by(self.output)
        self.exit.since = -math.inf


@pytest.fixture
def way() -> Way:
    return Way()


def test_a_plain_message_is_sent(way: Way) -> None:
    assert pass_on(way.exit, b"payload")
    assert pass_on(way.exit, b"", b"other")
    assert way.output.sent == [b"payload", b""]
    assert (way.exit.messages, way.exit.bytes) == (2, 7)


OBSTACLES: dict[str, tuple[Callable[[Way], object], Callable[[Way], object]]] = {
    "GID not allowed": (lambda w: w.exit.allow(frozenset([b"other"])), lambda w: w.exit.allow({GID: "source"})),
    "no GID allowed": (lambda w: w.exit.allow(()), lambda w: w.exit.allow([GID])),
    "lease expired": (
        lambda w: setattr(w.lease, "until", time.monotonic() - 0.001),
        lambda w: setattr(w.lease, "until", time.monotonic() + 100),
    ),
    "lease never given": (lambda w: setattr(w.lease, "until", 0.0), lambda w: setattr(w.lease, "until", math.inf)),
    "held velocities": (lambda w: setattr(w.hold, "held", True), lambda w: setattr(w.hold, "held", False)),
    "no state of the hold": (lambda w: delattr(w.hold, "held"), lambda w: setattr(w.hold, "held", False)),
    "queued message": (lambda w: w.line.append("x"), lambda w: w.line.clear()),
    "unknown publisher's message": (lambda w: w.unknown.append("x"), lambda w: w.unknown.clear()),
    "queue's lock": (lambda w: w.receiving.acquire(), lambda w: w.receiving.release()),
    "lock of the publishing": (lambda w: w.publishing.acquire(), lambda w: w.publishing.release()),
    "output not ready": (lambda w: setattr(w.output, "ready", False), lambda w: setattr(w.output, "ready", True)),
    "output fails": (lambda w: setattr(w.output, "accepts", False), lambda w: setattr(w.output, "accepts", True)),
    "no output": (lambda w: w.exit.send_by(None), lambda w: w.exit.send_by(w.output)),
    "not open": (lambda w: setattr(w.exit, "open", False), lambda w: setattr(w.exit, "open", True)),
}


@pytest.mark.parametrize("name", OBSTACLES)
def test_a_message_is_refused_while_something_prevents_it(way: Way, name: str) -> None:
    begin, end = OBSTACLES[name]
    begin(way)
    assert not pass_on(way.exit, b"x")
    assert (way.output.sent, way.exit.messages, way.exit.bytes, way.exit.last) == ([], 0, 0, 0.0)
    assert (way.exit.latencies, sum(way.exit.buckets), way.exit.waited) == ([], 0, 0)
    end(way)
    assert pass_on(way.exit, b"sent")
    assert way.output.sent == [b"sent"]


def test_a_lock_that_cannot_be_checked_counts_as_held() -> None:
    way = Way()
    way.exit = Exit(way.lease, None, (), (lambda: 1 // 0 == 0,), None, LIMIT, ())
    way.exit.allow((GID,))
    way.exit.send_by(way.output)
    with pytest.raises(ZeroDivisionError):
        pass_on(way.exit, b"x")
    assert way.output.sent == []


def test_a_route_without_a_hold_needs_none() -> None:
    way = Way()
    way.exit = Exit(way.lease, None, (), (), None, LIMIT, ())
    way.exit.allow((GID,))
    way.exit.send_by(way.output)
    assert pass_on(way.exit, b"x")


@pytest.mark.parametrize("limit", [0, 10, LARGEST, 2 * LARGEST])
def test_a_message_larger_than_the_limit_is_refused(limit: int) -> None:
    way, most = Way(limit), min(limit, LARGEST)
    largest = bytes(range(256)) * 256
    assert pass_on(way.exit, largest[:most])
    assert not pass_on(way.exit, bytes(most + 1))
    assert way.output.sent == [largest[:most]]


def test_the_newest_output_sends(way: Way) -> None:
    other = RecordingOutput()
    pass_on(way.exit, b"1")
    way.exit.send_by(other)
    pass_on(way.exit, b"2")
    assert (way.output.sent, other.sent) == ([b"1"], [b"2"])


def test_an_output_that_is_not_valid_is_refused(way: Way) -> None:
    other = RecordingOutput()
    other.output = foreign_capsule()
    for owner, error in ((object(), AttributeError), (other, ValueError)):
        with pytest.raises(error):
            way.exit.send_by(owner)
    assert pass_on(way.exit, b"x")
    assert way.output.sent == [b"x"], "the earlier output stays"


def test_an_exit_without_arguments_refuses_messages() -> None:
    assert not pass_on(Exit.__new__(Exit), b"x")


def test_an_exit_is_made_once_with_valid_arguments(way: Way) -> None:
    valid: list[Any] = [way.lease, None, (), (), None, LIMIT, ()]
    with pytest.raises(ValueError, match="one exit"):
        way.exit.__init__(*valid)  # type: ignore[misc]  # on the object itself
    with pytest.raises(ValueError, match="15 bounds"):
        make(*valid[:-1], tuple(range(16)))
    for at, wrong in ((0, object()), (2, [deque()]), (3, []), (4, (True, 0)), (5, "1"), (6, [1])):
        with pytest.raises(TypeError):
            make(*valid[:at], wrong, *valid[at + 1 :])


def test_messages_are_counted_with_those_of_python(way: Way) -> None:
    counters = Counters()
    counters.exit = way.exit
    counters.crossed(100)
    before = time.monotonic()
    pass_on(way.exit, b"12345")
    assert before <= way.exit.last <= time.monotonic()
    figures = counters.as_dict()
    assert (counters.messages, figures["messages"], figures["bytes"]) == (2, 2, 105)
    assert 0 <= figures["age"] <= time.monotonic() - before + 0.001


def test_latencies_are_counted_in_buckets() -> None:
    way = Way(bounds=HOURS)
    for hours in (0.5, 1.5, 1.5, 12.5, 13.5, 100):
        pass_on(way.exit, b"x", time_ns=time.time_ns() - int(hours * HOUR))
    assert way.exit.buckets == [1, 2, *[0] * 10, 1, 1 + 1]
    assert way.exit.waited == pytest.approx(129.5 * HOUR, abs=0.5 * HOUR)
    assert way.exit.latencies == pytest.approx([h * HOUR for h in (0.5, 1.5, 1.5, 12.5, 13.5, 100)], abs=0.1 * HOUR)


def test_a_message_of_a_clock_ahead_waited_no_time(way: Way) -> None:
    pass_on(way.exit, b"x", time_ns=time.time_ns() + HOUR)
    assert (way.exit.buckets[0], way.exit.waited) == (1, 0)
    assert way.exit.latencies[0] < 0


def test_latencies_are_counted_with_those_of_python() -> None:
    way, counters = Way(bounds=HOURS), Counters()
    counters.exit = way.exit
    counters.add_latency(100)
    counters.add_latency(14 * HOUR)
    for hours in (0.5, 1.5, 13.5):
        pass_on(way.exit, b"x", time_ns=time.time_ns() - int(hours * HOUR))
    figures = counters.as_dict()
    assert figures["latency"]["buckets"] == [2, 1, *[0] * 11, 2]
    assert figures["latency"]["seconds"] == pytest.approx(29.5 * 3600, abs=600)
    assert figures["latency_ms"]["p50"] == pytest.approx(1.5 * 3.6e6, abs=6e5)
    assert figures["latency_ms"]["p99"] == pytest.approx(14 * 3.6e6, abs=6e5)


def test_quantiles_cover_the_last_512_messages() -> None:
    way = Way(bounds=HOURS)
    for hours, count in ((1.5, 600), (2.5, 511)):
        for _ in range(count):
            pass_on(way.exit, b"x", time_ns=time.time_ns() - int(hours * HOUR))
    assert len(way.exit.latencies) == 512
    assert sum(latency < 2 * HOUR for latency in way.exit.latencies) == 1
    assert way.exit.buckets[:3] == [0, 600, 511]


def test_quantiles_cover_the_last_messages_of_c_and_python_together() -> None:
    way, counters = Way(bounds=HOURS), Counters()
    counters.exit = way.exit
    for _ in range(256):
        pass_on(way.exit, b"x")
        counters.add_latency(7 * HOUR)
    for _ in range(255):
        counters.add_latency(9 * HOUR)
    assert way.exit.latencies.count(9 * HOUR) == 255
    assert way.exit.latencies.count(7 * HOUR) == 129
    assert counters.as_dict()["latency_ms"]["p50"] == 7 * 3.6e6
    assert counters.as_dict()["latency"]["buckets"] == way.exit.buckets
    with pytest.raises(OverflowError):
        counters.add_latency(2**63)


@pytest.mark.parametrize("time_ns", [-1, -(2**63)])
def test_a_time_before_the_clocks_zero_counts_as_zero(way: Way, time_ns: int) -> None:
    before = time.time_ns()
    pass_on(way.exit, b"x", time_ns=time_ns)
    (latency,) = way.exit.latencies
    assert before <= latency <= time.time_ns()
    assert (way.exit.buckets[-1], way.exit.waited) == (1, latency)


def test_the_latency_of_a_message_from_before_the_subscription_is_not_counted(way: Way) -> None:
    way.exit.since = time.monotonic() - 1800
    pass_on(way.exit, b"old", time_ns=time.time_ns() - HOUR)
    assert (way.exit.messages, way.exit.latencies, sum(way.exit.buckets), way.exit.waited) == (1, [], 0, 0)
    pass_on(way.exit, b"new")
    assert (way.exit.messages, len(way.exit.latencies), sum(way.exit.buckets)) == (2, 1, 1)
    way.exit.since = math.inf
    pass_on(way.exit, b"old")
    assert (way.exit.messages, len(way.exit.latencies)) == (3, 1)


def test_nothing_leaks_over_many_messages(way: Way) -> None:
    way.output.sent = deque(maxlen=1)
    payload, gid, counts = bytes(100), bytes(bytearray(GID)), list[int]()
    for _ in range(2):
        for number in range(5000):
            way.hold.held = number % 5 == 0
            way.output.accepts = number % 7 > 0
            pass_on(way.exit, payload, gid if number % 11 else b"unknown")
        gc.collect()
        counts.append(sys.getallocatedblocks())
    assert way.exit.messages > 5000
    assert counts[1] - counts[0] < 500
    assert sys.getrefcount(gid) < 10
    assert sys.getrefcount(way.exit) < 10


def test_a_cycle_of_an_exit_and_its_output_is_collected() -> None:
    way = Way()
    way.hold.exit = way.exit
    output = weakref.ref(way.output)
    del way
    gc.collect()
    assert output() is None
