"""The queue of readers with new messages, with stand-ins for the functions of rcl."""

from __future__ import annotations

import ctypes
import threading
from collections import deque
from typing import Any

import pytest

from bridge.adapters.ros2 import rcl, taking

LARGE = 1000
BATCH = 16
GID = bytes(range(16))
_libc = ctypes.CDLL(None)
_libc.realloc.restype = ctypes.c_void_p
_libc.realloc.argtypes = [ctypes.c_void_p, ctypes.c_size_t]


class _Info(ctypes.Structure):
    _fields_ = [
        ("source_ns", ctypes.c_int64), ("received_ns", ctypes.c_int64), ("sequence", ctypes.c_uint64),
        ("reception", ctypes.c_uint64), ("implementation", ctypes.c_char_p), ("gid", ctypes.c_ubyte * 16),
        ("local", ctypes.c_bool),
    ]  # fmt: skip


class _Bytes(ctypes.Structure):
    _fields_ = [
        ("buffer", ctypes.c_void_p), ("length", ctypes.c_size_t), ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    ]  # fmt: skip


def _take_type(message: type[ctypes.Structure]) -> Any:
    pointers = (ctypes.c_void_p, ctypes.POINTER(message), ctypes.POINTER(_Info), ctypes.c_void_p)
    return ctypes.CFUNCTYPE(ctypes.c_int32, *pointers)


class Rcl:
    """Subscriptions by their addresses, with the messages that are taken; an int is an error code."""

    def __init__(self) -> None:
        self.messages: dict[int, deque[bytes | int]] = {}
        self.resets = self.exact = self.as_structure = 0
        functions = [
            _take_type(_Bytes)(self._take_serialized), _take_type(rcl.Wire)(self._take),
            ctypes.CFUNCTYPE(None)(self._reset), ctypes.CDLL("librcutils.so").rcutils_get_default_allocator,
        ]  # fmt: skip
        self._functions: list[Any] = functions
        serialized, take, reset, allocator = (ctypes.cast(f, ctypes.c_void_p).value or 0 for f in self._functions)
        self.queue = taking.Queue(serialized, take, reset, allocator, LARGE)
        self._report = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_size_t)(taking.ON_NEW_MESSAGES)

    def _next(self, subscription: int, info: Any) -> bytes | int:
        waiting = self.messages[subscription]
        info.contents.source_ns, info.contents.sequence, info.contents.gid[:] = 5, 7, GID
        return waiting.popleft() if waiting else rcl.RET_TAKE_FAILED

    def _take_serialized(self, subscription: int, target: Any, info: Any, _allocation: int | None) -> int:
        message = self._next(subscription, info)
        return message if isinstance(message, int) else self._fill(target.contents, "buffer", message)

    def _take(self, subscription: int, target: Any, info: Any, _allocation: int | None) -> int:
        message, wire = self._next(subscription, info), target.contents
        if isinstance(message, int):
            return message
        self.as_structure += 1
        if not wire.exact or wire.exact_length != len(message):
            return self._fill(wire, "start", message)
        ctypes.memmove(wire.exact, message, len(message))
        wire.length, wire.exact = len(message), None
        self.exact += 1
        return rcl.RET_OK

    @staticmethod
    def _fill(target: Any, name: str, message: bytes) -> int:
        if target.capacity < len(message):
            setattr(target, name, _libc.realloc(getattr(target, name), len(message)))
            target.capacity = len(message)
        ctypes.memmove(getattr(target, name), message, len(message))
        target.length = len(message)
        return rcl.RET_OK

    def _reset(self) -> None:
        self.resets += 1

    def add(self, name: str, *messages: bytes | int, count: int | None = None) -> int:
        """Add a reader with messages, and report ``count`` new ones; return its callback's data."""
        subscription = len(self.messages) + 1
        self.messages[subscription] = deque(messages)
        reader: Any = name
        data = self.queue.add(reader, subscription)
        self.report(data, len(messages) if count is None else count)
        return data

    def report(self, data: int, count: int) -> None:
        self._report(data, count)

    def wait(self) -> list[tuple[Any, bytes | None]]:
        """Return readers and payloads."""
        return [(reader, payload) for reader, payload, *_ in self.queue.wait()]


@pytest.fixture
def fake() -> Rcl:
    return Rcl()


def test_messages_of_several_readers_come_at_once_with_their_info(fake: Rcl) -> None:
    fake.add("a", b"1", b"2")
    fake.add("b", b"3")
    assert list(fake.queue.wait()) == [("a", b"1", GID, 5, 7), ("a", b"2", GID, 5, 7), ("b", b"3", GID, 5, 7)]


def test_a_burst_is_divided_and_lets_others_in_between(fake: Rcl) -> None:
    messages = [b"%d" % number for number in range(BATCH + 3)]
    fake.add("burst", *messages)
    fake.add("other", b"x")
    first, rest = fake.wait(), fake.wait()
    assert first == [("burst", message) for message in messages[:BATCH]]
    assert rest == [("other", b"x"), *(("burst", message) for message in messages[BATCH:])]


def test_fewer_messages_than_reported_reset_the_event(fake: Rcl) -> None:
    fake.add("a", b"1", count=9)
    assert fake.wait() == [("a", b"1")]
    assert fake.resets == 1


def test_an_unexpected_error_is_left_to_the_reader(fake: Rcl) -> None:
    fake.add("a", 1)
    (entry,) = fake.queue.wait()
    assert entry == ("a", None, b"", 1, 0)
    assert fake.resets == 1


def test_an_endpoint_that_takes_by_itself_receives_the_number(fake: Rcl) -> None:
    reader: Any = "service"
    fake.report(fake.queue.add(reader, 0), 3)
    assert list(fake.queue.wait()) == [("service", None, b"", 3, 0)]


def test_equal_large_messages_are_taken_into_their_payload(fake: Rcl) -> None:
    large = [bytes([number]) * LARGE for number in range(4)]
    messages = [*large, b"z" * (LARGE + 1), b"small", b"small too"]
    fake.add("large", *messages)
    fake.add("other", b"x")
    received: list[tuple[Any, bytes | None]] = []
    while len(received) < len(messages) + 1:
        received += fake.wait()
    assert [payload for reader, payload in received if reader == "large"] == messages
    assert ("other", b"x") in received
    assert (fake.exact, fake.as_structure) == (2, 5)  # a large message, and what follows it


@pytest.mark.parametrize("before", [1, 3], ids=["one large message", "equal large messages"])
def test_messages_after_one_that_fast_dds_drops_are_received(fake: Rcl, before: int) -> None:
    large = [bytes(LARGE)] * before
    fake.add("a", *large, rcl.RET_TAKE_FAILED, b"1", b"2", b"3")
    received: list[tuple[Any, bytes | None]] = []
    for _ in range(before + 3):
        fake.queue.wake()
        received += fake.wait()
    assert received == [("a", message) for message in (*large, b"1", b"2", b"3")]


def test_large_messages_are_taken_one_at_a_time(fake: Rcl) -> None:
    messages = [bytes(LARGE + number) for number in range(3)]
    fake.add("large", *messages)
    assert [fake.wait() for _ in messages] == [[("large", message)] for message in messages]


def test_a_removed_reader_is_no_longer_queued(fake: Rcl) -> None:
    first, middle, last = (fake.add(name, name.encode()) for name in ("a", "b", "c"))
    fake.queue.remove(middle)
    fake.queue.remove(last)
    fake.add("d", b"d")
    assert fake.wait() == [("a", b"a"), ("d", b"d")]
    fake.queue.remove(first)


def test_wake_ends_waiting(fake: Rcl) -> None:
    received: list[Any] = []
    thread = threading.Thread(target=lambda: received.append(fake.wait()))
    thread.start()
    fake.queue.wake()
    thread.join(20.0)
    assert received == [[]]


def test_small_messages_of_known_publishers_are_delivered_without_the_reader(fake: Rcl) -> None:
    delivered: list[tuple[Any, ...]] = []
    data = fake.add("a", b"1", b"2")
    fake.queue.deliver(data, lambda *message: delivered.append(message), {GID: "known"}, {"known": 6})
    fake.add("b", b"3")
    assert fake.wait() == [("b", b"3")]
    assert delivered == [(b"1", "known", 5), (b"2", "known", 5)]


def test_no_message_overtakes_one_that_a_reader_accepts(fake: Rcl) -> None:
    delivered: list[tuple[Any, ...]] = []
    unknown, known = fake.add("unknown", b"1"), fake.add("known", b"2")
    for data, sources in ((unknown, {}), (known, {GID: "known"})):
        fake.queue.deliver(data, lambda *message: delivered.append(message), sources, {"known": 6})
    assert fake.wait() == [("unknown", b"1"), ("known", b"2")]
    assert delivered == []


def test_a_wake_up_beside_messages_ends_the_wait(fake: Rcl) -> None:
    """Otherwise the loop would not end, or drop a reader, before the next wake-up."""
    delivered: list[tuple[Any, ...]] = []
    data = fake.add("a", b"1")
    fake.queue.deliver(data, lambda *message: delivered.append(message), {GID: "known"}, {"known": 6})
    fake.queue.wake()
    taken: list[Any] = []
    thread = threading.Thread(target=lambda: taken.append(fake.wait()), daemon=True)
    thread.start()
    thread.join(20)
    assert taken == [[]]
    assert delivered == [(b"1", "known", 5)]
