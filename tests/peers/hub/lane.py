"""Helpers for tests of the lane."""

from __future__ import annotations

import contextlib
import socket
from collections import Counter
from itertools import pairwise
from typing import NamedTuple

from bridge.hub.endpoints.lane_subscription import LaneSubscription
from bridge.hub.lane.links import Link
from bridge.hub.lane.wire import DATA, ROOM, SAMPLE
from bridge.hub.wire.keys import ATTACHMENT_SIZE, unpack_attachment
from tests.peers.hub.endpoints import Subscriber
from tests.support.wait import until


def subscription(heard: Subscriber) -> LaneSubscription:
    """Return a subscriber's subscription, which can use the lane."""
    assert isinstance(heard.subscription, LaneSubscription)
    return heard.subscription


def goes_by(heard: Subscriber, way: str, why: str = "") -> None:
    """Wait until all messages use the transport ``way``, for a reason that contains ``why``."""
    chosen = subscription(heard)

    def so() -> bool:
        return chosen.way == way and chosen.settled and why in chosen.why

    try:
        until(so, f"{chosen.topic} uses {way} {why}")
    except AssertionError as err:
        err.add_note(f"it uses {chosen.way} ({chosen.why}), settled: {chosen.settled}")
        raise


def whole(texts: list[str]) -> None:
    """Check that the numbers are complete and in order, without duplicates."""
    numbers = [int(text) for text in texts]
    missing = sorted(set(range(numbers[0], numbers[-1] + 1)) - set(numbers))
    twice = sorted(number for number, count in Counter(numbers).items() if count > 1)
    back = [after for before, after in pairwise(numbers) if after < before]
    assert (missing, twice, back) == ([], [], []), f"of {len(numbers)} missing {missing}, twice {twice}, behind {back}"


class JoinedLane:
    """A lane with one reader, for messages that a thread joins."""

    def __init__(self) -> None:
        self._near, self._far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._far.setblocking(False)
        self._link = Link(self._near.fileno(), lambda: None)

    def put(self) -> None:
        """Send a message, or join it if the thread joins messages."""
        self._link.join(1, bytes(ATTACHMENT_SIZE), b"x")

    def sent(self) -> bool:
        """Return whether the reader has a message, which stays there."""
        try:
            return bool(self._far.recv(ROOM, socket.MSG_PEEK))
        except BlockingIOError:
            return False

    def close(self) -> None:
        self._link.close()
        self._near.close()
        self._far.close()


class LaneMessage(NamedTuple):
    """A message in a record of a lane."""

    key: int
    number: int
    time_ns: int
    gid: bytes
    payload: bytes


def lane_messages(record: bytes) -> list[LaneMessage]:
    """Return the messages of a ``DATA`` record, which must be whole."""
    messages, at = [], 0
    while at < len(record):
        kind, key, size, number, time_ns, gid = SAMPLE.unpack_from(record, at)
        assert kind == DATA
        begin = at + SAMPLE.size
        assert unpack_attachment(record[begin - ATTACHMENT_SIZE : begin]) == (number, time_ns, gid)
        at = begin + size
        assert at <= len(record), "the record ends within a message"
        messages.append(LaneMessage(key, number, time_ns, gid, record[begin:at]))
    return messages


class RecordedLane:
    """A link and its reader's socket; ``unsent`` has the records that the link could not send."""

    def __init__(self, buffer: int = 100_000) -> None:
        self.near, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, buffer)
        self.near.setblocking(False)
        self.far.setblocking(False)
        self.unsent: list[bytes] = []
        self.link = Link(self.near.fileno(), self._unsent)

    def _unsent(self) -> None:
        record = self.link.flush()
        if record is not None:
            self.unsent.append(record)

    def received(self) -> list[bytes]:
        """Return the records that have arrived."""
        records = []
        with contextlib.suppress(BlockingIOError):
            while record := self.far.recv(ROOM):
                records.append(record)
        return records

    def records(self) -> list[list[LaneMessage]]:
        """Return the messages that have arrived, grouped by record."""
        return [lane_messages(record) for record in self.received()]

    def messages(self) -> list[LaneMessage]:
        """Return the messages that have arrived."""
        return [message for record in self.records() for message in record]

    def close(self) -> None:
        self.link.close()
        self.near.close()
        self.far.close()
