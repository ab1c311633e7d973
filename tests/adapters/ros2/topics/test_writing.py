"""Small messages are published by rcl in C, with a stand-in for its function."""

from __future__ import annotations

import ctypes
import gc
import mmap
import random
import sys
import threading
import weakref
from collections import deque
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.ros2 import rcl, rmw
from bridge.adapters.ros2.topics import publisher
from bridge.adapters.ros2.topics.writing import Writer
from bridge.hub.wire.qos import Qos
from tests.peers.native import exit_to, pass_on

PUBLISHER = 2**63 + 1234
ERROR = 1


class _Bytes(ctypes.Structure):
    _fields_ = [
        ("buffer", ctypes.c_void_p), ("length", ctypes.c_size_t), ("capacity", ctypes.c_size_t),
        ("allocator", ctypes.c_void_p * 5),
    ]  # fmt: skip


class Rcl:
    """Publishes to the list ``published``, or fails with ``code``."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.published: list[bytes] | deque[bytes] = []
        self.publishers: set[int] = set()
        self.code = 0
        pointers = (ctypes.c_void_p, ctypes.POINTER(_Bytes), ctypes.c_void_p)
        self._function = ctypes.CFUNCTYPE(ctypes.c_int32, *pointers)(self._publish)
        monkeypatch.setattr(rcl, "_PUBLISH", ctypes.cast(self._function, ctypes.c_void_p).value)

        # as ctypes calls it, for which the message is any structure
        self.call = ctypes.CFUNCTYPE(ctypes.c_int32, *3 * [ctypes.c_void_p])(rcl._PUBLISH)
        self.resets = 0
        self._reset = ctypes.CFUNCTYPE(None)(self._reset_error)
        monkeypatch.setattr(rcl, "_RESET_ERROR", ctypes.cast(self._reset, ctypes.c_void_p).value)

    def _reset_error(self) -> None:
        self.resets += 1

    def _publish(self, publisher: int, message: Any, allocation: int | None) -> int:
        content = message.contents
        self.publishers.add(publisher)
        assert (allocation, content.capacity) == (None, content.length)
        if not self.code:
            self.published.append(ctypes.string_at(content.buffer, content.length))
        return self.code


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> Rcl:
    return Rcl(monkeypatch)


def new_writer(locked: Callable[[], bool] = lambda: False, *, is_open: bool = True) -> Writer:
    """Return a writer that calls the stand-in."""
    writer = rcl.new_writer(PUBLISHER, locked)
    assert writer is not None
    assert not writer.open
    writer.open = is_open
    return writer


def test_an_open_writer_publishes_the_messages_of_an_exit(stand_in: Rcl) -> None:
    writer = new_writer()
    way = exit_to(writer)
    messages = [b"\0\1\0\0data", b"", bytes(range(256)) * 127]
    assert all(pass_on(way, message) for message in messages)
    assert (stand_in.published, stand_in.publishers) == (messages, {PUBLISHER})
    assert (writer.written, way.messages, way.bytes) == (3, 3, sum(map(len, messages)))


def test_a_new_writer_is_not_open(stand_in: Rcl) -> None:
    writer = new_writer(is_open=False)
    assert not pass_on(exit_to(writer), b"x")
    writer.open = True
    assert pass_on(exit_to(writer), b"x")
    writer.open = False
    assert not pass_on(exit_to(writer), b"x")
    assert (stand_in.published, writer.written) == ([b"x"], 1)


def test_a_lock_keeps_a_writer_from_publishing(stand_in: Rcl) -> None:
    lock = threading.Lock()
    writer = new_writer(lock.locked)
    with lock:
        assert not pass_on(exit_to(writer), b"x")
    assert stand_in.published == []
    assert pass_on(exit_to(writer), b"x")


def test_a_lock_that_cannot_be_checked_counts_as_held(stand_in: Rcl) -> None:
    def fail() -> bool:
        raise ZeroDivisionError

    assert not pass_on(exit_to(new_writer(fail)), b"x"), "the error is cleared"
    assert stand_in.published == []


@pytest.mark.parametrize("code", [ERROR, -1, 2**31 - 1])
def test_a_message_that_rcl_does_not_publish_is_left_to_python(stand_in: Rcl, code: int) -> None:
    writer = new_writer()
    way = exit_to(writer)
    stand_in.code = code
    assert not pass_on(way, b"x")
    assert (writer.written, way.messages, writer.open) == (0, 0, True)
    assert stand_in.resets == 1, "rcl would print a warning at the next error"
    stand_in.code = 0
    assert pass_on(way, b"y")
    assert (stand_in.published, stand_in.resets) == ([b"y"], 1)


def test_large_messages_are_left_to_python(stand_in: Rcl) -> None:
    """It releases the interpreter's lock while it publishes them."""
    way = exit_to(new_writer())
    assert pass_on(way, bytes(rcl.LARGE - 1))
    assert not pass_on(way, bytes(rcl.LARGE))
    assert (len(stand_in.published), way.messages) == (1, 1)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("size", [10, 3 * rcl.LARGE])
def test_python_publishes_bytes_and_memory_of_others(
    stand_in: Rcl, monkeypatch: pytest.MonkeyPatch, size: int, *, compiled: bool
) -> None:
    if not compiled:
        monkeypatch.setattr(rcl, "_publish", rcl._publish_by_ctypes)
        for name in ("_rcl", "_rcl_held"):
            monkeypatch.setattr(rcl, name, SimpleNamespace(rcl_publish_serialized_message=stand_in.call))
    with mmap.mmap(-1, 4 * rcl.LARGE) as memory:
        memory[:size] = payload = random.Random(1).randbytes(size)
        rcl.publish(PUBLISHER, payload)
        rcl.publish(PUBLISHER, memoryview(memory)[:size])
    assert stand_in.published == [payload, payload]


def test_a_writer_needs_an_address(stand_in: Rcl) -> None:
    for address in ("1", None, 1.5):
        with pytest.raises(TypeError):
            rcl.new_writer(address, lambda: False)


def test_nothing_leaks_over_many_messages(stand_in: Rcl) -> None:
    stand_in.published = deque(maxlen=1)
    way, counts = exit_to(new_writer()), []
    for _ in range(4):
        for number in range(5000):
            stand_in.code = number % 3 == 0
            pass_on(way, b"message")
        gc.collect()
        counts.append(sys.getallocatedblocks())
    # a leak grows each time; what other threads of this process allocate does not
    assert min(after - before for before, after in pairwise(counts)) < 500


def test_a_cycle_of_a_writer_and_its_lock_is_collected(stand_in: Rcl) -> None:
    class Lock:
        writer: Writer | None = None

        def __call__(self) -> bool:
            return False

    lock = Lock()
    lock.writer = new_writer(lock)
    locked = weakref.ref(lock)
    del lock
    gc.collect()
    assert locked() is None


# -- the publisher's writer --------------------------------------------------------------------------------------------


class DdsWriter:
    """A writer of the ROS 2 side without DDS, and an exit that publishes through it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.prepared: list[int] = []
        self.destroyed: list[object] = []
        self.by_python: list[bytes] = []
        monkeypatch.setattr(rcl, "publish", lambda _pointer, payload: self.by_python.append(payload))
        monkeypatch.setattr(rmw, "publisher_gid", lambda _pointer: b"gid")
        participant: Any = SimpleNamespace(
            make_writer=lambda *_: SimpleNamespace(pointer=PUBLISHER), destroy=self.destroyed.append
        )
        self.writer = publisher._Writer(participant, SimpleNamespace(type_name="t"), "/topic", Qos(), None)
        assert self.writer.native is not None
        self.native: Writer = self.writer.native
        self.exit = exit_to(self.native)

    def prepare(self, _gid: bytes, written: int, _readers: frozenset[bytes]) -> None:
        self.prepared.append(written)


@pytest.fixture
def dds(stand_in: Rcl, monkeypatch: pytest.MonkeyPatch) -> DdsWriter:
    return DdsWriter(monkeypatch)


def test_a_publishers_writer_is_open_at_once(dds: DdsWriter, stand_in: Rcl) -> None:
    assert pass_on(dds.exit, b"x")
    assert (stand_in.published, stand_in.publishers, dds.by_python) == ([b"x"], {PUBLISHER}, [])


def test_a_writer_that_holds_messages_publishes_them_before_those_of_c(dds: DdsWriter, stand_in: Rcl) -> None:
    dds.writer.hold(2)
    assert not pass_on(dds.exit, b"1")
    dds.writer.send(b"1")
    assert (stand_in.published, dds.by_python) == ([], [])
    dds.writer.release()
    assert dds.by_python == [b"1"]
    assert pass_on(dds.exit, b"2")
    assert stand_in.published == [b"2"]


def test_a_held_message_is_copied(dds: DdsWriter) -> None:
    """The memory is invalid after the call."""
    memory = bytearray(b"before")
    dds.writer.hold(2)
    dds.writer.send(memoryview(memory))
    memory[:] = b"after!"
    dds.writer.release()
    assert dds.by_python == [b"before"]


def test_held_messages_are_published_before_the_writer_is_open(dds: DdsWriter, monkeypatch: pytest.MonkeyPatch) -> None:
    during: list[bool] = []
    monkeypatch.setattr(rcl, "publish", lambda *_: during.append(pass_on(dds.exit, b"overtakes")))
    dds.writer.hold(2)
    dds.writer.send(b"1")
    dds.writer.send(b"2")
    dds.writer.release()
    dds.writer.send(b"3")
    assert during == [False, False, False]


def test_a_closed_writer_publishes_nothing(dds: DdsWriter, stand_in: Rcl) -> None:
    open_at_the_end: list[bool] = []
    dds.destroyed = open_at_the_end
    dds.writer._participant.destroy = lambda _: open_at_the_end.append(dds.native.open)
    dds.writer.hold(1)
    dds.writer.send(b"last")
    dds.writer.close()
    assert open_at_the_end == [False], "before it is destroyed"
    assert not pass_on(dds.exit, b"x")
    dds.writer.send(b"x")
    dds.writer.release()
    assert not pass_on(dds.exit, b"x"), "a late release does not open it"
    assert (stand_in.published, dds.by_python) == ([], [b"last"])


def test_messages_of_c_and_python_are_counted_together(dds: DdsWriter) -> None:
    pass_on(dds.exit, b"1")
    dds.writer.send(b"2")
    pass_on(dds.exit, b"3")
    dds.writer.prepare(dds, frozenset())
    assert dds.prepared == [3]
