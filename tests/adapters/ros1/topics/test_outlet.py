"""Connections to subscribers: slow subscribers lose only their own messages, and do not delay others."""

import contextlib
import socket
import struct
import threading

import pytest

from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.topics import outlet
from bridge.adapters.ros1.topics.outlet import SubscriberConnection
from tests.support.no_threads import no_threads
from tests.support.wait import until


class Pair:
    """A connection, and its subscriber's end."""

    def __init__(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            self.subscriber = socket.create_connection(listener.getsockname())
            ours, _ = listener.accept()
        self.outlet = SubscriberConnection(ours, "test-out")

    def read(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            part = self.subscriber.recv(count - len(data))
            assert part, "the connection was closed"
            data += part
        return data

    def message(self) -> bytes:
        (length,) = struct.unpack("<I", self.read(4))
        return self.read(length)

    def close(self) -> None:
        self.outlet.close()
        self.subscriber.close()
        for thread in self.threads():
            thread.join(40)

    def threads(self) -> list[threading.Thread]:
        """Return the threads of the connection."""
        return [thread for thread in threading.enumerate() if thread.name == "test-out"]


@pytest.fixture
def pair():
    pair = Pair()
    yield pair
    pair.close()


def test_a_fast_subscriber_needs_no_thread(pair):
    for n in range(100):
        assert pair.outlet.send(b"%d" % n, "a", 1)
        assert pair.message() == b"%d" % n
    assert pair.threads() == []
    assert pair.outlet.dropped == 0


def test_a_slow_subscriber_gets_its_messages_once_a_thread_can_start(pair):
    large = bytes(16_000_000)  # more than the buffers of both systems hold
    with no_threads("test-out"):
        assert pair.outlet.send(large, "a", 10)
        assert pair.outlet.send(b"second", "a", 10)
    assert pair.outlet.send(b"third", "a", 10)
    assert [pair.message() for _ in range(3)] == [large, b"second", b"third"]


@pytest.fixture
def loop(pair):
    """A loop that watches the connection."""
    loop = ConnectionLoop("test-watch")
    pair.outlet._ended = lambda outlet: (loop.remove(outlet), outlet.close())
    loop.add(pair.outlet)
    yield loop
    loop.stop()


def test_data_of_a_subscriber_is_discarded_and_its_end_noticed_behind_it(pair, loop):
    pair.subscriber.sendall(b"unexpected")
    until(lambda: pair.outlet._unexpected == 10, "the loop has read the data")
    assert pair.outlet.send(b"on", "a", 1)
    assert pair.message() == b"on"
    pair.subscriber.close()
    until(lambda: pair.outlet.done, "the end of the connection is noticed")


def test_a_subscriber_that_sends_without_end_is_disconnected(pair, loop):
    """Such a subscriber's data would keep the loop busy."""
    with contextlib.suppress(ConnectionError):
        pair.subscriber.sendall(bytes(10_000_000))
    until(lambda: pair.outlet.done, "the subscriber is disconnected")


def test_large_messages_arrive_complete(pair):
    sent = [bytes([n]) * 3_000_000 for n in range(6)]
    received = []
    reading = threading.Thread(target=lambda: received.extend(pair.message() for _ in sent))
    reading.start()
    for message in sent:
        assert pair.outlet.send(message, "a", 10)
    reading.join(20)
    assert received == sent


def test_a_stalled_subscriber_loses_its_oldest_messages(pair):
    big = 1_000_000
    for n in range(50):
        assert pair.outlet.send(bytes([n]) * big, "a", 3), "the sender is never blocked"
    pair.outlet.send(b"other", "b", 3)
    total = 51 - pair.outlet.dropped
    assert 0 < pair.outlet.dropped < 50
    numbers, others = [], []
    for _ in range(total):
        message = pair.message()
        if message == b"other":
            others.append(message)
        else:
            assert len(set(message)) == 1
            assert len(message) == big
            numbers.append(message[0])
    assert numbers == sorted(numbers)
    assert numbers[-3:] == [47, 48, 49], "the newest messages stay"
    assert others == [b"other"], "a source's messages displace only its own"


def test_a_broken_connection_is_reported(pair):
    pair.subscriber.close()
    until(lambda: not pair.outlet.send(b"x" * 1000, "a", 1), "the broken connection is noticed")


def test_closing_ends_the_thread_of_a_stalled_subscriber(pair):
    for _ in range(20):
        pair.outlet.send(b"x" * 1_000_000, "a", 2)
    (thread,) = pair.threads()
    pair.outlet.close()
    thread.join(40)
    assert not thread.is_alive()
    assert not pair.outlet.send(b"x", "a", 2)


def test_queued_bytes_are_limited(pair, monkeypatch):
    monkeypatch.setattr("bridge.adapters.ros1.topics.outlet.MAX_WAITING", 10_000_000)
    big = 4_000_000
    for n in range(20):
        assert pair.outlet.send(bytes([n]) * big, "a", 1000)
    pair.outlet.send(b"other", "b", 1000)
    assert pair.outlet.waiting <= 3
    received = [pair.message()[:1]]
    while received[-1] != b"o":
        received.append(pair.message()[:1])
    assert received[-2] == bytes([19])
    assert len(received) + pair.outlet.dropped == 21


def test_queued_messages_of_many_sources_are_limited(pair, monkeypatch):
    monkeypatch.setattr(outlet, "MAX_MESSAGES", 10)
    for n in range(200):
        pair.outlet.send(bytes([n]) * 1_000_000, f"goal {n}", 1)
    assert pair.outlet.waiting == 10
    assert pair.outlet.dropped >= 100
    received = [pair.message()[0] for _ in range(200 - pair.outlet.dropped)]
    assert received[-10:] == list(range(190, 200))


def test_a_socket_whose_options_cannot_be_set_stays_the_callers():
    """On macOS, options cannot be set once the peer has reset the connection."""
    near, far = socket.socketpair()  # sockets that do not have TCP's options
    with near, far:
        with pytest.raises(OSError, match="supported"):
            SubscriberConnection(near, "test-out")
        assert near.fileno() >= 0
