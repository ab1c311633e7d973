"""The doorway: which messages it sends in C, which it leaves to the route, and how it counts them."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.hub.lane.joining import MAX_JOINED_BYTES
from bridge.hub.lane.links import Epoch, Sender
from bridge.routing.counters import CARRY_BOUNDS, Counters
from bridge.routing.doorway import Deadline, Doorway
from tests.peers.hub.lane import RecordedLane

GID = b"g" * 16


class Entry(RecordedLane):
    """A doorway for source ``a``, and what its fallback has received."""

    def __init__(self, program: Any = None, limit: int = 1000) -> None:
        super().__init__()
        self.epoch, self.lease, self.held = Epoch(), Deadline(), deque[Any]()
        self.sender = Sender(GID, self.epoch)
        self.sender.send_to(((self.link, 1),))
        self.sender.rest(0, 0)
        self.sender.direct, self.lease.until = True, math.inf
        self.left: list[tuple[Any, str, int | None]] = []
        self.hold = SimpleNamespace(held=False)
        self.doorway = Doorway(self.deliver, self.lease, self.hold, self.held, program, limit, CARRY_BOUNDS)
        self.doorway.admit("a", self.sender)

    def deliver(self, payload: Any, source: str, time_ns: int | None) -> None:
        self.left.append((payload, source, time_ns))

    def sent(self) -> list[bytes]:
        """Return the payloads that were sent since the last call."""
        return [message.payload for message in self.messages()]


@pytest.fixture
def entry() -> Iterator[Entry]:
    entry = Entry()
    yield entry
    entry.close()


def test_a_plain_message_is_sent(entry: Entry) -> None:
    entry.doorway(b"payload", "a", 5)
    ((key, number, time_ns, gid, payload),) = entry.messages()
    assert (key, number, time_ns, gid, payload) == (1, 1, 5, GID, b"payload")
    assert entry.left == []


def test_a_source_is_found_by_its_value(entry: Entry) -> None:
    entry.doorway.admit("the source", entry.sender)
    entry.doorway(b"x", str(b"the source", "ascii"), None)
    assert entry.sent() == [b"x"]


OBSTACLES: dict[str, tuple[Callable[[Entry], object], Callable[[Entry], object]]] = {
    "source dismissed": (lambda e: e.doorway.dismiss("a"), lambda e: e.doorway.admit("a", e.sender)),
    "lease expired": (
        lambda e: setattr(e.lease, "until", time.monotonic() - 0.001),
        lambda e: setattr(e.lease, "until", time.monotonic() + 100),
    ),
    "lease never given": (lambda e: setattr(e.lease, "until", 0.0), lambda e: setattr(e.lease, "until", math.inf)),
    "message held": (lambda e: e.held.append("x"), lambda e: e.held.clear()),
    "releasing": (lambda e: setattr(e.doorway, "releasing", True), lambda e: setattr(e.doorway, "releasing", False)),
    "not open": (lambda e: setattr(e.doorway, "open", False), lambda e: setattr(e.doorway, "open", True)),
    "not direct": (lambda e: setattr(e.sender, "direct", False), lambda e: setattr(e.sender, "direct", True)),
    "busy": (lambda e: setattr(e.sender, "busy", True), lambda e: setattr(e.sender, "busy", False)),
    "new epoch": (lambda e: e.epoch.renew(), lambda e: e.sender.rest(e.epoch.value, 0)),
    "match": (lambda e: e.sender.match(), lambda e: e.sender.rest(0, e.sender.matches)),
    "link not ready": (lambda e: setattr(e.link, "ready", False), lambda e: setattr(e.link, "ready", True)),
}


@pytest.mark.parametrize("name", OBSTACLES)
def test_a_message_is_left_to_the_route_while_something_prevents_it(entry: Entry, name: str) -> None:
    begin, end = OBSTACLES[name]
    begin(entry)
    entry.doorway(b"left", "a", 3)
    assert (entry.left, entry.sent()) == ([(b"left", "a", 3)], [])
    assert (entry.sender.sequence, entry.doorway.messages) == (0, 0), "nothing is counted or numbered"
    end(entry)
    entry.doorway(b"sent", "a", 4)
    assert (len(entry.left), entry.sent()) == (1, [b"sent"])


def test_a_message_of_an_unknown_source_is_left_to_the_route(entry: Entry) -> None:
    entry.doorway(b"x", "b", None)
    assert (entry.left, entry.sent()) == ([(b"x", "b", None)], [])
    entry.doorway.dismiss("b")


def test_one_link_that_is_not_ready_prevents_all(entry: Entry) -> None:
    other = RecordedLane()
    entry.sender.send_to(((entry.link, 1), (other.link, 1)))
    other.link.ready = False
    entry.doorway(b"x", "a", None)
    assert (len(entry.left), entry.sent()) == (1, [])
    other.close()


def test_a_publisher_without_readers_only_numbers_its_messages(entry: Entry) -> None:
    entry.sender.send_to(())
    entry.doorway(b"x", "a", None)
    assert (entry.sender.sequence, entry.sender.by_lane, entry.doorway.messages) == (1, 0, 1)
    assert (entry.left, entry.sent()) == ([], [])


@pytest.mark.parametrize("limit", [0, 10, MAX_JOINED_BYTES, 2 * MAX_JOINED_BYTES])
def test_a_large_message_is_left_to_the_route(limit: int) -> None:
    entry, most = Entry(limit=limit), min(limit, MAX_JOINED_BYTES)
    entry.doorway(bytes(most), "a", None)
    entry.doorway(bytes(most + 1), "a", None)
    assert ([len(payload) for payload in entry.sent()], len(entry.left)) == ([most], 1)
    entry.close()


class Text(bytes):
    """A subclass of bytes."""


@pytest.mark.parametrize("payload", [bytearray(b"x"), memoryview(b"x"), Text(b"x"), "x", None])
def test_only_bytes_are_sent(entry: Entry, payload: Any) -> None:
    entry.doorway(payload, "a", None)
    assert (entry.left, entry.sent()) == ([(payload, "a", None)], [])
    assert entry.left[0][0] is payload


def test_a_message_without_a_time_has_the_systems(entry: Entry) -> None:
    before = time.time_ns()
    entry.doorway(b"x", "a", None)
    ((_, _, time_ns, _, _),) = entry.messages()
    assert before <= time_ns <= time.time_ns()


@pytest.mark.parametrize("time_ns", [0, 1, -1, 2**63 - 1, -(2**63)])
def test_a_time_is_sent_unchanged(entry: Entry, time_ns: int) -> None:
    entry.doorway(b"x", "a", time_ns)
    assert [message.time_ns for message in entry.messages()] == [time_ns]


def test_a_time_that_is_too_large_is_an_error_and_nothing_is_sent(entry: Entry) -> None:
    with pytest.raises(OverflowError):
        entry.doorway(b"x", "a", 2**63)
    assert (entry.left, entry.sent(), entry.sender.sequence) == ([], [], 0)


def test_a_time_that_is_no_integer_is_left_to_the_route(entry: Entry) -> None:
    entry.doorway(b"x", "a", 1.5)  # type: ignore[arg-type]
    assert (entry.left, entry.sent(), entry.sender.sequence) == ([(b"x", "a", 1.5)], [], 0)


def test_an_error_of_the_route_reaches_the_caller(entry: Entry) -> None:
    entry.doorway.dismiss("a")
    entry.left = None  # type: ignore[assignment]  # `deliver` fails
    with pytest.raises(AttributeError):
        entry.doorway(b"x", "a", None)


@pytest.mark.parametrize("arguments", [(), (b"x", "a"), (b"x", "a", None, None)])
def test_a_message_has_three_arguments(entry: Entry, arguments: tuple) -> None:
    with pytest.raises(TypeError):
        entry.doorway(*arguments)


def test_a_route_has_one_doorway_with_a_maximum_number_of_bounds(entry: Entry) -> None:
    with pytest.raises(ValueError, match="one doorway"):
        entry.doorway.__init__(entry.deliver, entry.lease, None, entry.held, None, 10, ())  # type: ignore[misc]
    with pytest.raises(ValueError, match="15 bounds"):
        Doorway(entry.deliver, entry.lease, None, entry.held, None, 10, (1.0,) * 16)
    assert len(CARRY_BOUNDS) <= 15


def test_nothing_is_sent_while_velocities_are_held(entry: Entry) -> None:
    entry.hold.held = True
    entry.doorway(b"held", "a", None)
    assert entry.left == [(b"held", "a", None)]
    entry.hold.held = False
    entry.doorway(b"sent", "a", None)
    assert entry.sent() == [b"sent"]


def test_messages_are_counted(entry: Entry) -> None:
    before = time.monotonic()
    for payload in (b"", b"four", bytes(1000)):
        entry.doorway(payload, "a", None)
    entry.doorway(b"left", "b", None)
    doorway = entry.doorway
    assert (doorway.messages, doorway.bytes) == (3, 1004)
    assert before <= doorway.last <= time.monotonic()
    assert 0 < doorway.carrying <= time.monotonic() - before
    assert len(doorway.carried) == len(CARRY_BOUNDS) + 1
    assert sum(doorway.carried) == 3


def test_durations_are_counted_in_the_bucket_of_their_bound(entry: Entry) -> None:
    for bounds, bucket in (((1e-12, 100.0, 200.0), 1), ((100.0, 200.0), 0), ((1e-13, 1e-12), 2), ((), 0)):
        doorway = Doorway(entry.deliver, entry.lease, None, entry.held, None, 10, bounds)
        doorway.admit("a", entry.sender)
        doorway(b"x", "a", None)
        assert doorway.carried == [int(at == bucket) for at in range(len(bounds) + 1)]


def test_a_routes_counters_include_the_doorways(entry: Entry) -> None:
    counters = Counters()
    counters.carried(10, time.monotonic() - 0.3)
    alone = counters.as_dict()
    counters.doorway = entry.doorway
    assert {**counters.as_dict(), "age": None} == {**alone, "age": None}
    entry.doorway(bytes(5), "a", None)
    both = counters.as_dict()
    assert (both["messages"], both["bytes"], counters.messages) == (2, 15, 2)
    assert sum(both["carry"]["buckets"]) == 2
    assert both["carry"]["buckets"][-2] == alone["carry"]["buckets"][-2] == 1
    assert both["carry"]["seconds"] == pytest.approx(alone["carry"]["seconds"] + entry.doorway.carrying)
    assert both["age"] <= time.monotonic() - entry.doorway.last + 0.001


def test_a_route_whose_messages_all_use_the_doorway_has_an_age_and_a_rate(entry: Entry) -> None:
    counters = Counters()
    counters.doorway = entry.doorway
    assert counters.as_dict()["age"] is None
    counters._mark = (time.monotonic() - 200.0, 0)  # long ago, so that the time for the messages does not matter
    for _ in range(10):
        entry.doorway(b"x", "a", None)
    assert counters.tick() == pytest.approx(0.05, rel=0.1)
    assert counters.as_dict()["age"] is not None


def test_messages_do_not_leak(entry: Entry) -> None:
    payload, source, time_ns = b"p" * 100, str(b"the source", "ascii"), 2**62
    entry.doorway.admit(source, entry.sender)

    def send(count: int) -> list[int]:
        for number in range(count):
            entry.doorway(payload, source, time_ns)
            entry.doorway(payload, "unknown", time_ns)
            if number % 50 == 0:
                entry.sent()
                entry.left.clear()
        entry.sent()
        entry.left.clear()
        return [sys.getrefcount(thing) for thing in (payload, source, time_ns, entry.sender, entry.link, None)]

    send(100)
    before, blocks = send(100), sys.getallocatedblocks()
    after = send(10_000)
    assert after[:-1] == before[:-1]
    assert abs(after[-1] - before[-1]) < 1000, "other threads use it too"
    assert sys.getallocatedblocks() - blocks < 1000


def test_a_dismissed_source_and_a_doorway_release_what_they_refer_to(entry: Entry) -> None:
    def counts() -> list[int]:
        return [sys.getrefcount(entry.sender), sys.getrefcount(entry.lease), sys.getrefcount(entry.held)]

    before = counts()
    doorway = Doorway(entry.deliver, entry.lease, None, entry.held, None, 10, ())
    for _ in range(3):
        doorway.admit("a", entry.sender)
    admitted = counts()
    doorway.dismiss("a")
    dismissed = counts()
    del doorway
    assert admitted == [count + 1 for count in before]
    assert dismissed == [before[0], before[1] + 1, before[2] + 1]
    assert counts() == before
