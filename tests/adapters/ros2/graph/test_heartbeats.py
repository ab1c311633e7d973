"""Heartbeats in the name of Midspan's writers: their bytes, and for how long they are repeated."""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from types import SimpleNamespace
from typing import cast

import pytest

from bridge.adapters.ros2.graph import heartbeats, spdp
from bridge.adapters.ros2.graph.heartbeats import Heartbeats
from bridge.concurrency import DelayedCalls
from bridge.hub.wire.qos import Qos
from bridge.routing.edge import Endpoint, Kind, MadeBy

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


class Clock:
    """Makes scheduled calls at once, each at its time of a simulated clock."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        self._due: list[tuple[float, Callable[[], None]]] = []
        monkeypatch.setattr(heartbeats, "time", SimpleNamespace(monotonic=lambda: self.now))

    def after(self, seconds: float, call: Callable[[], None], *, once: bool) -> None:
        if not (once and self._due):
            self._due.append((self.now + seconds, call))

    def run(self, late: float = 0.0) -> None:
        """Make all calls, also those that they schedule; the first one is ``late``."""
        self.now += late
        while self._due:
            at, call = self._due.pop()
            self.now = max(self.now, at)
            call()


def test_heartbeats_are_repeated_until_the_participant_has_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, sent = Clock(monkeypatch), list[tuple[float, Sequence[bytes]]]()
    beats = Heartbeats(lambda messages: sent.append((clock.now, messages)), cast("DelayedCalls", clock))
    end = beats.prepare(WRITER, 0, [READER])
    assert end - clock.now == pytest.approx(heartbeats._SETTLE_SECONDS + heartbeats.MATCH_SECONDS)
    clock.run()
    assert {tuple(messages) for _, messages in sent} == {tuple(spdp.heartbeats({WRITER: 0}))}
    pauses = [after - before for (before, _), (after, _) in pairwise(sent)]
    assert pauses == pytest.approx([heartbeats.PAUSE_SECONDS] * len(pauses))
    assert sent[-1][0] == pytest.approx(end, abs=1.1 * heartbeats.PAUSE_SECONDS)
    # the participant has settled: only the time of a match is left
    assert beats.prepare(WRITER, 5, [READER]) - clock.now == pytest.approx(heartbeats.MATCH_SECONDS)
    clock.run()
    assert sent[-1][1] == spdp.heartbeats({WRITER: 5})


def test_a_heartbeat_is_sent_even_if_its_thread_did_not_run_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread also has other calls, and a reader without a heartbeat skips the first message."""
    clock, sent = Clock(monkeypatch), list[Sequence[bytes]]()
    beats = Heartbeats(sent.append, cast("DelayedCalls", clock))
    beats.prepare(WRITER, 2, [READER])
    clock.run(late=60.0)
    assert sent == [spdp.heartbeats({WRITER: 2})]


def test_heartbeats_are_repeated_after_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, sent = Clock(monkeypatch), list[Sequence[bytes]]()

    def send(messages: Sequence[bytes]) -> None:
        sent.append(messages)
        if len(sent) == 1:
            raise OSError(errno.EMFILE, "Too many open files")

    Heartbeats(send, cast("DelayedCalls", clock)).prepare(WRITER, 2, [READER])
    with pytest.raises(OSError, match="Too many"):
        clock.run()
    clock.run()
    assert sent[-1] == spdp.heartbeats({WRITER: 2})
    assert len(sent) > 1


def test_readers_of_one_writer_are_prepared_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader of a participant that has settled does not end the heartbeats for one that has just been discovered."""
    clock, settled = Clock(monkeypatch), b"\1\x10" + READER[2:4] + bytes(12)
    beats = Heartbeats(lambda _: None, cast("DelayedCalls", clock))
    beats.prepare(WRITER[:-1] + b"\2", 0, [settled])
    clock.now += heartbeats._SETTLE_SECONDS
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
