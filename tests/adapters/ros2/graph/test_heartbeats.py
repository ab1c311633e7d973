"""Heartbeats in the name of Midspan's writers: their bytes, and for how long they are repeated."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator, Sequence

import pytest

from bridge.adapters.ros2.graph import heartbeats, spdp
from bridge.adapters.ros2.graph.heartbeats import Heartbeats
from bridge.concurrency import DelayedCalls
from bridge.hub.wire.qos import Qos
from bridge.routing.edge import Endpoint, Kind, MadeBy
from tests.support.wait import until

PREFIX = bytes.fromhex("010f010203040506070800ff")
WRITER = PREFIX + b"\0\0\x12\x03"
READER = bytes.fromhex("0110aabbccddeeff00112233") + b"\0\0\1\x04"


@pytest.fixture
def later() -> Iterator[DelayedCalls]:
    calls = DelayedCalls("test-heartbeats")
    yield calls
    calls.close()


def test_a_heartbeat_has_the_bytes_of_the_specification() -> None:
    """DDSI-RTPS 2.5, 9.4.5.7: any reader, the writer, first 1, last, count 0; little-endian and final."""
    (message,) = spdp.heartbeats({WRITER: 3})
    assert message[:20] == b"RTPS\2\3\1\x0f" + PREFIX
    assert message[20:24] == b"\x07\x03" + struct.pack("<H", 28)
    assert message[24:32] == bytes(4) + b"\0\0\x12\x03"
    assert struct.unpack("<iIiIi", message[32:]) == (0, 1, 0, 3, 0)
    (message,) = spdp.heartbeats({WRITER: (7 << 32) + 5})
    assert struct.unpack("<iIiIi", message[32:]) == (0, 1, 7, 5, 0)


def test_many_writers_share_messages_that_fit_into_a_frame() -> None:
    written = {PREFIX + number.to_bytes(3, "big") + b"\x03": number for number in range(100)}
    messages = spdp.heartbeats(written)
    assert len(messages) == 3
    assert all(len(message) <= 1400 for message in messages)
    assert sum(len(message) - 20 for message in messages) == 100 * 32
    assert spdp.heartbeats({}) == []


def test_heartbeats_are_repeated_until_the_participant_has_settled(
    later: DelayedCalls, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(heartbeats, "_SETTLE_SECONDS", 0.2)
    monkeypatch.setattr(heartbeats, "MATCH_SECONDS", 0.1)
    sent: list[Sequence[bytes]] = []
    beats = Heartbeats(sent.append, later)
    began = time.monotonic()
    assert beats.prepare(WRITER, 0, [READER]) - began == pytest.approx(0.3, abs=0.05)
    until(lambda: len(sent) >= 3, "heartbeats are sent")
    assert sent[0] == spdp.heartbeats({WRITER: 0})
    until(lambda: not beats._pending, "the heartbeats end")
    assert time.monotonic() - began >= 0.3
    now = time.monotonic()  # the participant has settled: only the time of a match is left
    assert beats.prepare(WRITER, 5, [READER]) - now == pytest.approx(0.1, abs=0.05)
    until(lambda: sent[-1] == spdp.heartbeats({WRITER: 5}), "the new count is sent")


def test_readers_of_one_writer_are_prepared_together(later: DelayedCalls, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader of a participant that has settled does not end the heartbeats for one that has just been discovered."""
    monkeypatch.setattr(heartbeats, "_SETTLE_SECONDS", 0.3)
    settled = b"\1\x10" + READER[2:4] + bytes(12)
    beats = Heartbeats(lambda _: None, later)
    beats.prepare(WRITER[:-1] + b"\2", 0, [settled])
    end = time.monotonic() + 0.3
    until(lambda: time.monotonic() > end, "the first participant has settled")
    late = beats.prepare(WRITER, 1, [READER])
    assert beats.prepare(WRITER, 4, [settled]) == late
    assert beats._pending[WRITER].last == 1


def test_subscriptions_on_cyclone_dds_are_known_by_topic(later: DelayedCalls) -> None:
    def endpoint(gid: bytes, kind: Kind = Kind.SUBSCRIPTION) -> Endpoint:
        return Endpoint(
            gid.hex(), kind, topic="/map", type="nav_msgs/msg/OccupancyGrid", qos=Qos(), made_by=MadeBy.NATIVE
        )

    beats = Heartbeats(lambda _: None, later)
    beats.follow([endpoint(READER), endpoint(WRITER), endpoint(READER[:-1] + b"\x03", Kind.PUBLISHER)])
    assert beats.readers("/map") == {READER}
    assert beats.readers("/scan") == frozenset()
    beats.follow([])
    assert beats.readers("/map") == frozenset()
