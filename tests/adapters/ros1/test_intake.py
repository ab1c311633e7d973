"""The intake reads small ROS 1 messages in C, and leaves everything else to Python."""

from __future__ import annotations

import bisect
import itertools
import random
import select
import socket
import struct
from collections.abc import Iterator

import pytest

from bridge.adapters.ros1.intake import Stream
from tests.peers.ros1.intake import LIMIT, Desk, frame


@pytest.fixture
def desk() -> Iterator[Desk]:
    desk = Desk()
    yield desk
    desk.close()


def test_messages_are_delivered_with_their_source_and_without_a_time() -> None:
    desk, calls = Desk(), list[tuple]()
    publisher = desk.publisher()
    desk.intake.add(publisher.number, Stream(lambda *call: calls.append(call), "the source", LIMIT))
    publisher.send(b"x", b"")
    assert desk.intake.wait(0.0) == []
    assert calls == [(b"x", "the source", None), (b"", "the source", None)]
    desk.close()


def test_messages_in_one_chunk_are_delivered_in_order(desk: Desk) -> None:
    publisher = desk.publisher()
    expected = [str(number).encode() * number for number in range(50)]
    publisher.send(*expected)
    assert desk.intake.wait(0.0) == []
    assert publisher.received == expected
    assert (publisher.stream.messages, publisher.stream.bytes) == (50, sum(map(len, expected)) + 200)
    assert publisher.stream.direct
    assert not publisher.stream.reading


@pytest.mark.parametrize("cut", [1, 3, 4, 5, 12, 13])
def test_part_of_a_message_is_left_to_python(desk: Desk, cut: int) -> None:
    publisher, second = desk.publisher(), frame(b"secondone")
    publisher.sock.sendall(frame(b"first") + second[:cut])
    complete = cut == len(second)
    assert desk.intake.wait(0.0) == ([] if complete else [(publisher.number, select.EPOLLIN)])
    assert publisher.received == [b"first", b"secondone"][: 1 + complete]
    assert publisher.stream.direct is complete
    assert publisher.stream.reading is not complete
    assert publisher.stream.take() == (b"" if complete else second[:cut])
    assert not publisher.stream.reading


def test_a_stream_is_left_to_python_until_it_is_direct_again(desk: Desk) -> None:
    publisher = desk.publisher()
    publisher.sock.sendall(frame(b"first")[:3])
    desk.intake.wait(0.0)
    rest = publisher.stream.take()
    publisher.sock.sendall(frame(b"first")[3:])
    assert desk.intake.wait(None) == [(publisher.number, select.EPOLLIN)]
    assert publisher.received == []
    assert rest + publisher.take() == frame(b"first")
    publisher.stream.direct = True
    publisher.send(b"second")
    assert desk.intake.wait(0.0) == []
    assert publisher.received == [b"second"]


def test_a_rest_is_left_to_python_although_the_stream_is_direct(desk: Desk) -> None:
    publisher = desk.publisher()
    publisher.sock.sendall(b"\1")
    desk.intake.wait(0.0)
    publisher.stream.direct = True
    publisher.sock.sendall(b"\0")
    assert desk.intake.wait(0.0) == [(publisher.number, select.EPOLLIN)]
    assert publisher.stream.take() == b"\1"


@pytest.mark.parametrize("size", [LIMIT, LIMIT + 1, 2**31, 2**32 - 1])
def test_a_large_message_is_left_to_python(desk: Desk, size: int) -> None:
    publisher, large = desk.publisher(), struct.pack("<I", size) + bytes(min(size, 5000))
    publisher.sock.sendall(frame(b"small") + large)
    ready = desk.intake.wait(0.0)
    if size <= LIMIT:
        assert (ready, publisher.received) == ([], [b"small", bytes(size)])
    else:
        assert (ready, publisher.received) == ([(publisher.number, select.EPOLLIN)], [b"small"])
        assert publisher.stream.take() == large


@pytest.mark.parametrize("seed", range(10))
def test_messages_in_any_pieces_arrive_complete_and_in_order(desk: Desk, seed: int) -> None:
    draw, publisher = random.Random(seed), desk.publisher()
    expected = [draw.randbytes(draw.choice((0, 1, 2, 30, LIMIT, LIMIT + 1, 3000))) for _ in range(200)]
    data, at, rest, by_python = b"".join(map(frame, expected)), 0, b"", 0
    ends = list(itertools.accumulate(len(frame(payload)) for payload in expected))
    while at < len(data):
        # half of the pieces end with a message
        end = ends[bisect.bisect_right(ends, at)] if draw.random() < 0.5 else at + draw.choice((1, 4, 50, 1004, 5000))
        publisher.sock.sendall(data[at:end])
        at = end
        for number, events in desk.intake.wait(0.0):
            assert (number, events) == (publisher.number, select.EPOLLIN)
            rest += publisher.take()
            while len(rest) >= 4 and len(rest) - 4 >= (size := struct.unpack_from("<I", rest)[0]):
                publisher.received.append(rest[4 : 4 + size])
                rest = rest[4 + size :]
                by_python += 1
            publisher.stream.direct = not rest
    assert publisher.received == expected
    assert publisher.stream.messages == len(expected) - by_python > 0
    assert publisher.stream.bytes <= len(data)


def test_an_error_of_the_receiver_is_raised_by_take(desk: Desk) -> None:
    error = KeyError("x")

    def deliver(payload: bytes) -> None:
        publisher.received.append(payload)
        if payload == b"bad":
            raise error

    publisher = desk.publisher(deliver)
    publisher.send(b"good", b"bad", b"later")
    assert desk.intake.wait(0.0) == [(publisher.number, select.EPOLLIN)], "the socket is empty, but Python must act"
    assert publisher.received == [b"good", b"bad"]
    assert not publisher.stream.direct
    with pytest.raises(KeyError) as raised:
        publisher.stream.take()
    assert raised.value is error
    assert raised.traceback[-1].name == "deliver"
    assert publisher.stream.take() == b""


def test_an_error_does_not_affect_other_streams(desk: Desk) -> None:
    def fail(_: bytes) -> None:
        raise ValueError

    failing, other = desk.publisher(fail), desk.publisher()
    failing.send(b"x")
    other.send(b"x")
    assert desk.intake.wait(0.0) == [(failing.number, select.EPOLLIN)]
    assert other.received == [b"x"]


def test_the_end_of_a_connection_is_left_to_python(desk: Desk) -> None:
    publisher = desk.publisher()
    publisher.send(b"last")
    publisher.sock.shutdown(socket.SHUT_WR)
    assert desk.intake.wait(None) == [(publisher.number, select.EPOLLIN)]
    assert publisher.received == [b"last"]
    assert publisher.take() == b""


def test_events_other_than_data_are_left_to_python(desk: Desk) -> None:
    publisher = desk.publisher()
    publisher.send(b"last")
    publisher.sock.close()
    assert desk.intake.wait(None) == [(publisher.number, select.EPOLLIN | select.EPOLLHUP)]
    assert publisher.received == []
    assert publisher.take() == frame(b"last"), "nothing was read"
