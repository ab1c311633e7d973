"""The intake waits for connections, some of which are removed meanwhile, and sends the joined messages before."""

from __future__ import annotations

import contextlib
import fcntl
import gc
import itertools
import os
import select
import socket
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from bridge.adapters.ros1.intake import Intake, Stream
from tests.peers.ros1.intake import LIMIT, Desk, frame


@pytest.fixture
def desk() -> Iterator[Desk]:
    desk = Desk()
    yield desk
    desk.close()


def test_other_descriptors_are_returned_with_their_events(desk: Desk) -> None:
    publisher = desk.publisher()
    readable, writable = socket.socketpair()
    with readable, writable:
        desk.epoll.register(readable, select.EPOLLIN)
        desk.epoll.register(writable, select.EPOLLOUT)
        assert desk.intake.wait(None) == [(writable.fileno(), select.EPOLLOUT)]
        writable.send(b"x")
        publisher.send(b"message")
        ready = desk.intake.wait(None)
        assert sorted(ready) == sorted([(readable.fileno(), select.EPOLLIN), (writable.fileno(), select.EPOLLOUT)])
        assert publisher.received == [b"message"], "streams are read in the same pass"
        assert readable.recv(9) == b"x", "the intake reads only streams"


@pytest.mark.parametrize("seconds", [0.0, 0.001, 0.05])
def test_a_wait_ends_after_its_time(desk: Desk, seconds: float) -> None:
    desk.publisher()
    begin = time.monotonic()
    assert desk.intake.wait(seconds) == []
    assert seconds <= time.monotonic() - begin < seconds + 10.0


def test_a_wait_ends_after_its_time_although_messages_keep_arriving(desk: Desk) -> None:
    publisher = desk.publisher(lambda payload: publisher.send(payload))
    publisher.send(b"again")
    begin = time.monotonic()
    assert desk.intake.wait(1.0) == []
    assert 1.0 <= time.monotonic() - begin < 11.0
    assert publisher.stream.messages > 10


def test_a_wait_for_an_invalid_time_is_an_error(desk: Desk) -> None:
    with pytest.raises(TypeError):
        desk.intake.wait("soon")  # type: ignore[arg-type]


def test_a_failed_wait_is_an_error(desk: Desk) -> None:
    desk.epoll.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        desk.intake.wait(0.0)


def test_joined_messages_are_sent_before_each_wait_after_a_message(desk: Desk) -> None:
    publisher = desk.publisher()
    desk.intake.wait(0.0)
    assert desk.flushed == 0, "no message was delivered"
    publisher.send(b"x")
    desk.intake.wait(0.0)
    assert desk.flushed == 0, "the caller flushes before its next wait"
    desk.intake.wait(0.0)
    desk.intake.wait(0.0)
    assert desk.flushed == 1


def test_joined_messages_are_sent_before_the_intake_waits_again() -> None:
    order: list[str] = []
    epoll, (theirs, ours) = select.epoll(), socket.socketpair()
    wake, woken = socket.socketpair()

    def flush() -> None:
        order.append("flush")
        wake.send(b"x")  # ends the wait that follows

    with epoll, theirs, ours, wake, woken:
        intake = Intake(epoll.fileno(), flush)
        intake.add(ours.fileno(), Stream(lambda *_: order.append("message"), "", LIMIT))
        epoll.register(ours, select.EPOLLIN)
        epoll.register(woken, select.EPOLLIN)
        theirs.sendall(frame(b"x") + frame(b"y"))
        assert intake.wait(None) == [(woken.fileno(), select.EPOLLIN)]
    assert order == ["message", "message", "flush"]


def test_an_error_of_the_flush_ends_the_wait_and_nothing_is_lost(desk: Desk) -> None:
    errors = [RuntimeError("flush")]

    def flush() -> None:
        raise errors.pop()

    publisher, intake = desk.publisher(), Intake(desk.epoll.fileno(), flush)
    intake.add(publisher.number, publisher.stream)
    publisher.send(b"1")
    intake.wait(0.0)
    publisher.send(b"2")
    with pytest.raises(RuntimeError, match="flush"):
        intake.wait(0.0)
    intake.wait(0.0)
    assert publisher.received == [b"1", b"2"]


def test_a_stream_that_is_not_direct_is_left_to_python(desk: Desk) -> None:
    publisher = desk.publisher()
    publisher.stream.direct = False
    publisher.send(b"x")
    assert desk.intake.wait(None) == [(publisher.number, select.EPOLLIN)]
    assert publisher.take() == frame(b"x")


def test_a_stream_that_stops_being_direct_leaves_the_rest_to_python(desk: Desk) -> None:
    def deliver(payload: bytes) -> None:
        publisher.received.append(payload)
        assert publisher.stream.reading, "more messages may follow"
        publisher.stream.direct = False

    publisher = desk.publisher(deliver)
    publisher.send(b"1", b"2", b"3")
    assert desk.intake.wait(None) == [(publisher.number, select.EPOLLIN)]
    assert publisher.received == [b"1"]
    assert publisher.stream.take() == frame(b"2") + frame(b"3")


def test_a_stream_that_is_removed_while_the_intake_waits_is_left_to_python(desk: Desk) -> None:
    publisher, results = desk.publisher(), list[Any]()
    thread = threading.Thread(target=lambda: results.append(desk.intake.wait(None)), daemon=True)
    thread.start()
    desk.intake.remove(publisher.number)
    publisher.send(b"x")
    thread.join(40)
    assert results == [[(publisher.number, select.EPOLLIN)]]
    assert publisher.received == []


def test_a_stream_that_is_added_while_the_intake_waits_is_read(desk: Desk) -> None:
    first, received = desk.publisher(), threading.Event()
    thread = threading.Thread(target=lambda: desk.intake.wait(None), daemon=True)
    thread.start()
    second = desk.publisher(lambda _payload: received.set())
    second.send(b"x")
    assert received.wait(40)
    first.sock.close()
    thread.join(40)
    assert not thread.is_alive()


@pytest.mark.parametrize("closes", [False, True])
def test_a_callback_may_remove_all_streams_of_its_batch(desk: Desk, *, closes: bool) -> None:
    def deliver(_: bytes) -> None:
        for publisher in publishers:
            desk.intake.remove(publisher.number)
            if closes:
                publisher.ours.close()

    publishers = [desk.publisher(deliver) for _ in range(3)]
    for publisher in publishers:
        publisher.send(b"x")
    ready = desk.intake.wait(0.0)
    assert sum(publisher.stream.messages for publisher in publishers) == 1
    assert sorted(ready) == [(p.number, select.EPOLLIN) for p in publishers if not p.stream.messages]


def test_a_stream_that_removes_itself_delivers_the_rest_of_its_chunk(desk: Desk) -> None:
    def deliver(payload: bytes) -> None:
        publisher.received.append(payload)
        desk.intake.remove(publisher.number)

    publisher = desk.publisher(deliver)
    publisher.send(b"1", b"2")
    assert desk.intake.wait(0.0) == []
    assert publisher.received == [b"1", b"2"]


def test_a_stream_may_lose_its_last_reference_while_it_delivers(desk: Desk) -> None:
    def deliver(payload: bytes, _source: str, _time: None) -> None:
        received.append(payload)
        desk.intake.remove(publisher.number)

    publisher, received = desk.publisher(), list[bytes]()
    desk.intake.add(publisher.number, Stream(deliver, "", LIMIT))
    publisher.send(b"1", b"2")
    assert desk.intake.wait(0.0) == []
    assert received == [b"1", b"2"]


def test_a_socket_that_is_empty_meanwhile_is_no_end(desk: Desk) -> None:
    def deliver(_: bytes) -> None:
        for publisher in publishers:
            with contextlib.suppress(BlockingIOError):
                publisher.ours.recv(100, socket.MSG_DONTWAIT)

    publishers = [desk.publisher(deliver), desk.publisher(deliver)]
    for publisher in publishers:
        publisher.send(b"x")
    assert desk.intake.wait(0.0) == []
    assert sum(publisher.stream.messages for publisher in publishers) == 1
    assert all(publisher.stream.direct for publisher in publishers)


def test_another_stream_replaces_that_of_a_descriptor(desk: Desk) -> None:
    publisher, received = desk.publisher(), list[bytes]()
    before = sys.getrefcount(publisher.stream)
    desk.intake.add(publisher.number, Stream(lambda payload, *_: received.append(payload), "", LIMIT))
    after = sys.getrefcount(publisher.stream)
    assert after == before - 1, "the first stream is released"
    publisher.send(b"x")
    desk.intake.wait(0.0)
    assert (publisher.received, received) == ([], [b"x"])


def test_descriptors_may_be_large(desk: Desk) -> None:
    other, publisher = desk.publisher(), desk.publisher()
    number = fcntl.fcntl(publisher.ours, fcntl.F_DUPFD, 900)
    desk.epoll.unregister(publisher.number)
    desk.epoll.register(number, select.EPOLLIN)
    publisher.send(b"x")
    assert desk.intake.wait(0.0) == [(number, select.EPOLLIN)]
    desk.intake.add(number, publisher.stream)
    assert desk.intake.wait(0.0) == []
    assert publisher.received == [b"x"]
    other.send(b"x")
    assert desk.intake.wait(0.0) == []
    assert other.received == [b"x"], "the streams of other descriptors remain"
    desk.epoll.unregister(number)
    os.close(number)


def test_a_closed_connection_is_refused_and_an_unknown_one_ignored(desk: Desk) -> None:
    with pytest.raises(ValueError, match="closed"):
        desk.intake.add(-1, desk.publisher().stream)
    for number in (-1, 0, 100_000):
        desk.intake.remove(number)
    with pytest.raises(TypeError):
        desk.intake.add(0, object())  # type: ignore[arg-type]


def test_messages_do_not_leak(desk: Desk) -> None:
    publisher = desk.publisher(lambda _payload: None)

    def send(count: int) -> int:
        for _ in range(count // 50):
            publisher.send(*[b"m" * 100] * 50)
            desk.intake.wait(0.0)
        return sys.getallocatedblocks()

    send(1000)
    blocks = [send(count) for count in (1000, *[10_000] * 4)]
    # each part would leak as much; other threads of the process allocate now and then
    assert min(after - before for before, after in itertools.pairwise(blocks)) < 100
    assert publisher.stream.messages == 42_000


def owner_of(make: Callable[[Any], object]) -> weakref.ref:
    class Owner:
        def __init__(self) -> None:
            self.part = make(self)

        def deliver(self, _payload: bytes, _source: str, _time: None) -> None: ...

    return weakref.ref(Owner())


def test_streams_are_garbage_together_with_their_owner(desk: Desk) -> None:
    def make(owner: Any) -> Intake:
        intake = Intake(desk.epoll.fileno(), desk.flush)
        intake.add(0, Stream(owner.deliver, "", LIMIT))
        return intake

    owner = owner_of(make)
    gc.collect()
    assert owner() is None
