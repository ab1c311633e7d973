"""One thread reads many connections."""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from bridge.adapters.ros1.connection_loop import ConnectionLoop, PolledConnection, receive_now
from bridge.adapters.ros1.topics.connection import PublisherConnection
from bridge.adapters.ros1_peers import DeadlineSocket
from tests.peers.hub.lane import JoinedLane
from tests.support.wait import until


def frame(payload: bytes) -> bytes:
    return struct.pack("<I", len(payload)) + payload


class Listener(PolledConnection):
    """A connection that counts its calls, and pauses after each, like a busy service. It reads only if it listens."""

    def __init__(self, sock: socket.socket, loop: ConnectionLoop) -> None:
        super().__init__(sock)
        self.listens = False
        self.loop, self.calls, self.ended = loop, 0, threading.Event()

    def on_ready(self) -> Callable[[], None] | None:
        self.calls += 1
        if self.listens and not receive_now(self._sock, 100):
            return self.abandon
        self.loop.pause(self)
        return None

    def abandon(self) -> None:
        self._sock.close()
        self.ended.set()


class Crowd:
    """Publishers, and the readers at the other ends, which share one loop."""

    def __init__(self) -> None:
        self.loop = ConnectionLoop()
        self.received: list[tuple[int, bytes]] = []
        self.threads: set[str] = set()
        self.ended: list[tuple[int, str]] = []
        self.publishers: list[socket.socket] = []
        self.readers: list[PublisherConnection] = []

    def thread(self) -> threading.Thread:
        return next(t for t in threading.enumerate() if t.name == "midspan-ros1-intake")

    def add(self, deliver: Callable[[bytes], None] | None = None, *, start: bool = True) -> socket.socket:
        number, (ours, theirs) = len(self.readers), pair()

        def on_message(payload: bytes) -> None:
            self.threads.add(threading.current_thread().name)
            self.received.append((number, payload))

        reader = PublisherConnection(
            DeadlineSocket(fileno=ours.detach()),
            f"/t{number}",
            "http://x/",
            lambda payload, _source, _time: (deliver or on_message)(payload),
            "the publisher",
            lambda trouble: self.ended.append((number, trouble)),
            lambda *_: None,
            loop=self.loop,
        )
        self.publishers.append(theirs)
        self.readers.append(reader)
        if start:
            reader.start()
        return theirs


def pair() -> tuple[socket.socket, socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        client = socket.create_connection(listener.getsockname())
        return client, listener.accept()[0]


SELECTORS = ("EpollSelector", "KqueueSelector", "PollSelector", "SelectSelector")


@pytest.fixture(params=[name for name in SELECTORS if hasattr(selectors, name)])
def crowd(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Crowd]:
    monkeypatch.setattr(selectors, "DefaultSelector", getattr(selectors, request.param))
    crowd = Crowd()
    yield crowd
    for reader in crowd.readers:
        reader.close()
    crowd.loop.stop()
    for publisher in crowd.publishers:
        publisher.close()
    until(lambda: all(reader.fileno() == -1 for reader in crowd.readers), "all sockets are closed", 20)


def test_one_thread_reads_all_connections(crowd: Crowd) -> None:
    for _ in range(50):
        crowd.add()
    for turn in range(20):
        for number, publisher in enumerate(crowd.publishers):
            publisher.sendall(frame(bytes([number, turn])))
    until(lambda: len(crowd.received) == 1000, "all messages have arrived", 20)
    assert crowd.threads == {"midspan-ros1-intake"}
    for number in range(50):
        assert [p for n, p in crowd.received if n == number] == [bytes([number, turn]) for turn in range(20)]


def test_messages_are_joined_until_the_loop_waits_again(crowd: Crowd) -> None:
    sent: list[bool] = []

    def deliver(_: bytes) -> None:
        lane.put()
        sent.append(lane.sent())

    with contextlib.closing(JoinedLane()) as lane:
        crowd.add(deliver).sendall(frame(b"x"))
        until(lane.sent, "the joined message is sent", 20)
        assert sent == [False]
    with contextlib.closing(JoinedLane()) as lane:
        lane.put()
        assert lane.sent(), "this thread does not join messages"


def test_joined_messages_do_not_wait_for_a_service_call(crowd: Crowd) -> None:
    sent: list[bool] = []
    ended = threading.Event()

    class Call(PolledConnection):
        def on_ready(self) -> Callable[[], None] | None:
            sent.append(lane.sent())
            return self.abandon

        def abandon(self) -> None:
            self._sock.close()
            ended.set()

    ours, theirs = pair()
    crowd.publishers.append(theirs)
    theirs.sendall(b"x")

    def deliver(_: bytes) -> None:
        lane.put()
        crowd.loop._on_ready(call)  # in the same pass of the loop

    call = Call(ours)
    with contextlib.closing(JoinedLane()) as lane:
        crowd.add(deliver).sendall(frame(b"x"))
        assert ended.wait(20.0)
        assert sent == [True]


def test_a_connection_with_a_large_message_gets_a_separate_thread(crowd: Crowd) -> None:
    """An incomplete large message does not delay other connections."""
    large, small = crowd.add(), crowd.add()
    large.sendall(frame(b"before") + frame(b"x" * 100_000)[:70_000])
    until(lambda: crowd.received == [(0, b"before")], "the small message arrives", 20)
    small.sendall(frame(b"beside"))
    until(lambda: crowd.received[1:] == [(1, b"beside")], "the other connection's message arrives", 20)
    large.sendall(frame(b"x" * 100_000)[70_000:] + frame(b"after"))
    until(lambda: [p for _, p in crowd.received[2:]] == [b"x" * 100_000, b"after"], "the remaining messages arrive", 20)
    assert crowd.threads == {"midspan-ros1-intake", "midspan-ros1-in/t0"}


def test_a_connection_that_ends_or_fails_does_not_affect_others(crowd: Crowd) -> None:
    def fails(_: bytes) -> None:
        msg = "on purpose"
        raise RuntimeError(msg)

    ending, failing, staying = crowd.add(), crowd.add(fails), crowd.add()
    ending.close()
    failing.sendall(frame(b"x"))
    until(lambda: len(crowd.ended) == 2, "both ends are reported", 20)
    assert dict(crowd.ended) == {0: "the publisher closed the connection", 1: "RuntimeError: on purpose"}
    staying.sendall(frame(b"on"))
    until(lambda: crowd.received == [(2, b"on")], "the third connection's message arrives", 20)


def test_without_a_thread_for_a_large_message_the_connection_ends(
    crowd: Crowd, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`Ros1Subscription` reopens the connection later."""

    def none_left(_: threading.Thread) -> None:
        msg = "can't start new thread"
        raise RuntimeError(msg)

    publisher = crowd.add()
    monkeypatch.setattr(threading.Thread, "start", none_left)
    publisher.sendall(frame(b"x" * 100_000))
    until(lambda: crowd.ended == [(0, "can't start new thread")], "the end of the connection is reported", 20)


def test_the_loop_stops_while_messages_arrive(crowd: Crowd, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop's thread stops after it has read a message, before it is woken."""
    publisher, wake = crowd.add(), crowd.loop.wake
    thread = crowd.thread()

    def slow() -> None:
        publisher.sendall(frame(b"x"))
        thread.join(0.2)
        wake()

    monkeypatch.setattr(crowd.loop, "wake", slow)
    crowd.loop.stop()
    until(lambda: not thread.is_alive(), "the thread ends")


def test_a_connection_that_is_closed_at_its_start_does_not_affect_others(
    crowd: Crowd, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread in `close` is suspended after it has checked whether the loop reads the socket."""
    closing, dropping = threading.Event(), threading.Event()

    class Slow(socket.socket):
        def close(self) -> None:
            closing.set()
            dropping.wait(0.3)
            super().close()

    staying, number = crowd.add(), len(crowd.readers)
    crowd.add(start=False)
    reader, remove = crowd.readers[number], crowd.loop.remove
    reader._sock = Slow(fileno=reader._sock.detach())
    closer = threading.Thread(target=reader.close)

    def late(*given: Any) -> None:
        dropping.set()
        closer.join()
        remove(*given)

    monkeypatch.setattr(crowd.loop, "remove", late)
    closer.start()
    assert closing.wait(20)
    reader.start()
    closer.join()
    staying.sendall(frame(b"on"))
    until(lambda: crowd.received == [(0, b"on")], "the other connection's message arrives", 20)


def test_data_after_the_end_is_not_read(crowd: Crowd) -> None:
    crowd.add()
    crowd.loop.stop()
    crowd.loop.stop()
    late = crowd.add()
    until(lambda: [reader.done for reader in crowd.readers] == [True, True], "the loop has abandoned both connections")
    assert late.recv(1) == b"", "the late connection is closed"
    assert not crowd.ended


def test_a_paused_connection_is_not_called_until_it_is_read_again(crowd: Crowd) -> None:
    """The connection's waiting data would otherwise keep the thread busy."""
    ours, theirs = pair()
    source = Listener(ours, crowd.loop)
    assert crowd.loop.add(source)
    with theirs:
        theirs.sendall(b"early")
        until(lambda: source.calls == 1, "the source is called")
        staying = crowd.add()
        staying.sendall(frame(b"on"))
        until(lambda: crowd.received == [(0, b"on")], "another connection is read")
        assert source.calls == 1
        crowd.loop.listen(source, data=True)
        crowd.loop.pause(source)  # a pause that comes too late has no effect
        until(lambda: source.calls == 2, "the source is called again")
    assert source.ended.wait(20)


def test_a_connection_that_raises_is_closed(crowd: Crowd, caplog: pytest.LogCaptureFixture) -> None:
    class Broken(Listener):
        def on_ready(self) -> None:
            raise ZeroDivisionError

    ours, theirs = pair()
    source = Broken(ours, crowd.loop)
    assert crowd.loop.add(source)
    with theirs:
        theirs.sendall(b"x")
        assert source.ended.wait(20)
    staying = crowd.add()
    staying.sendall(frame(b"on"))
    until(lambda: crowd.received == [(0, b"on")], "the loop continues")
    assert caplog.text.count("reading a ROS 1 connection failed") == 1


def test_threads_that_open_and_close_connections_do_not_disturb_others(crowd: Crowd) -> None:
    """`select` fails for a descriptor that is closed while it waits."""
    staying = crowd.add()

    def churn() -> None:
        for _ in range(100):
            ours, theirs = pair()
            source = Listener(ours, crowd.loop)
            assert crowd.loop.add(source)
            crowd.loop.remove(source)
            source.abandon()
            theirs.close()

    threads = [threading.Thread(target=churn) for _ in range(4)]
    for thread in threads:
        thread.start()
    for n in range(100):
        staying.sendall(frame(bytes([n])))
        until(lambda n=n: crowd.received[-1:] == [(0, bytes([n]))], "the message is read", every=0.001)  # type: ignore[misc]
    for thread in threads:
        thread.join()
    assert len(crowd.received) == 100


def test_a_source_may_use_the_loop_while_it_is_added(crowd: Crowd, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread calls the source as soon as its socket is watched."""

    class Eager(Listener):
        def on_ready(self) -> None:
            self.calls += 1
            if self.calls == 1:
                assert receive_now(self._sock, 100) == b"x"
                self.loop.call_ready(self)

    ours, theirs = pair()
    source, watch = Eager(ours, crowd.loop), crowd.loop.watch

    def slow(file: socket.socket | int, readable: Any = None, writable: Any = None) -> None:
        watch(file, readable, writable)
        if readable is not None and not crowd.loop.is_own_thread:
            until(lambda: source.calls, "the loop calls the source")
            passed = threading.Event()
            crowd.loop.call_soon(passed.set)
            passed.wait(0.3)

    crowd.add()
    monkeypatch.setattr(crowd.loop, "watch", slow)
    with theirs:
        theirs.sendall(b"x")
        assert crowd.loop.add(source)
        monkeypatch.undo()
        until(lambda: source.calls >= 2, "the source is called again")
        crowd.loop.remove(source)
        source.abandon()
