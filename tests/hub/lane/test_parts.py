"""The parts of a subscription that switches between the lane and zenoh."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import zenoh

from bridge.hub.endpoints import lane_state, subscription
from bridge.hub.endpoints.lane_state import CAUGHT_SECONDS, QUIET_SECONDS, Lanes, LeavingStep, ZenohSubscriber
from bridge.hub.endpoints.lane_subscription import EARLY_SECONDS, LEAVING_SECONDS, Sequencer
from bridge.hub.endpoints.subscription import HubSample, Losses, PublisherStates
from bridge.hub.lane import connections, folder
from bridge.hub.lane import lane as lane_module
from bridge.hub.lane.inlet import Inlet
from tests.support.wait import until

GID = b"g" * 16


def _message(number: int) -> HubSample:
    return HubSample(zenoh.ZBytes(b"x"), number, number, GID, "z")


class Merged:
    """A sequencer for one publisher, which sends over both transports unless the test changes that."""

    def __init__(self, *, paired: bool = True) -> None:
        graph: Any = SimpleNamespace(zid_of=lambda _gid: "")
        self.states, self.losses = PublisherStates(graph), Losses()
        self.both = self.leaves = True
        self.sequencer = Sequencer(self.states, self.losses, lambda _gid: self.both, lambda _gid: self.leaves)
        self.source = self.states.add(GID, "z")
        self.source.paired = paired

    def accept(self, *numbers: int, first: int = 0) -> list[int]:
        return [
            ready.sequence
            for number in numbers
            for ready in self.sequencer.accept(self.source, _message(number), first)
        ]

    def release(self, seconds: float) -> list[int]:
        return [ready.sequence for ready in self.sequencer.release(time.monotonic() + seconds)]


@pytest.mark.parametrize("paired", [True, False])
def test_messages_in_order_pass_and_duplicates_do_not(paired: bool) -> None:
    merged = Merged(paired=paired)
    assert merged.accept(1, 2, 2, 1, 3) == [1, 2, 3]
    assert (merged.sequencer.due(), merged.losses.count) == (None, 0)


def test_early_message_is_held_until_the_earlier_one_arrives() -> None:
    merged = Merged()
    assert merged.accept(1, 3, 4) == [1]
    assert merged.states.held_bytes
    assert merged.accept(2) == [2, 3, 4]
    assert (merged.states.held_bytes, merged.sequencer.due(), merged.losses.count) == (0, None, 0)


def test_message_received_over_both_transports_does_not_wait_for_earlier_ones() -> None:
    merged = Merged()
    assert merged.accept(1, 4, 5) == [1]
    assert merged.accept(4) == [4, 5]
    assert merged.losses.count == 2


def test_first_message_after_the_mark_waits_for_those_before_the_mark() -> None:
    merged = Merged()
    assert merged.accept(6, first=5) == []
    assert merged.accept(5, first=5) == []
    assert merged.accept(4, first=5) == []
    assert merged.release(LEAVING_SECONDS) == [4, 5, 6]


@pytest.mark.parametrize(("both", "paired"), [(False, True), (True, False)])
def test_gap_on_one_transport_is_a_loss_at_once(both: bool, paired: bool) -> None:
    merged = Merged(paired=paired)
    merged.both = both
    assert merged.accept(1, 4) == [1, 4]
    assert merged.losses.count == 2


@pytest.mark.parametrize(("leaves", "seconds"), [(False, EARLY_SECONDS), (True, LEAVING_SECONDS)])
def test_held_messages_are_released_after_their_maximum_time(leaves: bool, seconds: float) -> None:
    merged = Merged()
    merged.leaves = leaves
    before = time.monotonic()
    assert merged.accept(1, 4, 3) == [1]
    due = merged.sequencer.due()
    assert due is not None
    assert before + seconds <= due <= time.monotonic() + seconds
    assert merged.sequencer.release(due - 0.01) == []
    assert merged.release(seconds) == [3, 4]
    assert (merged.losses.count, merged.release(100.0)) == (1, [])


def test_messages_beyond_the_limit_are_delivered_early(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subscription, "MAX_HELD_BYTES", 2 * (1 + subscription.OVERHEAD))
    merged = Merged()
    assert merged.accept(1, 3, 4) == [1]
    assert merged.accept(6) == [3, 4, 6]
    assert (merged.states.held_bytes, merged.losses.count) == (0, 2)


def test_held_messages_of_a_dropped_publisher_are_forgotten() -> None:
    merged = Merged()
    assert merged.accept(1, 3) == [1]
    merged.states.pop_all_held(merged.states.pop(GID))
    assert merged.release(100.0) == []
    assert merged.sequencer.due() is None


class FakeInlet:
    """A stand-in for the connection to a session."""

    def __init__(self, zid: str) -> None:
        self.zid = zid


def inlet(zid: str = "z") -> Inlet:
    return cast("Inlet", FakeInlet(zid))


@pytest.mark.parametrize("message", [True, False])
def test_a_subscriber_leaves_a_lane_step_by_step(message: bool) -> None:
    lanes, lane = Lanes(), inlet()
    lanes.inlets[lane] = 0.0
    assert [lanes.leave(lane), lanes.leave(lane)] == [LeavingStep.DECLARED] * 2
    assert not lanes.start_fence(lane, 100.0), "the session may not know the subscriber yet"
    lanes.received.add("z")
    lanes.on_subscriber_known(lane, 10.0)
    assert lanes.leave(lane) is LeavingStep.KNOWN
    assert not lanes.start_fence(lane, 10.0), "the message over zenoh arrived earlier"
    lanes.on_fence(lane)
    assert lanes.leave(lane) is LeavingStep.KNOWN, "the fence belongs to an earlier attempt"
    if message:
        lanes.received.add("z")
    assert lanes.start_fence(lane, 10.1 if message else 10.1 + QUIET_SECONDS)
    assert lanes.leave(lane) is LeavingStep.FENCED
    assert not lanes.start_fence(lane, 100.0), "only one fence is sent"
    lanes.on_fence(lane)
    assert lanes.leave(lane) is LeavingStep.ENDED
    lanes.drop(lane)
    assert (lanes.inlets, lanes.leaving) == ({}, {})


def test_lane_that_ended_meanwhile_is_left() -> None:
    lanes, lane = Lanes(), inlet()
    lanes.on_subscriber_known(lane, 1.0)
    lanes.on_fence(lane)
    assert (lanes.start_fence(lane, 1.0), lanes.leave(lane), lanes.leaving) == (False, LeavingStep.ENDED, {})


def test_publisher_has_caught_up_at_its_mark_or_once_its_session_replies() -> None:
    lanes, lane, other = Lanes(), inlet(), inlet("y")
    now = time.monotonic()
    replied: dict[str, float] = {}

    def caught_up(last: int | None, at: float = now) -> bool:
        return lanes.has_caught_up(GID, last, at, lambda zid, since: replied.get(zid, 0.0) >= since)

    assert not caught_up(9, now + 100.0), "no mark has arrived yet"
    lanes.mark(lane, GID, 5)
    lanes.mark(lane, GID, 7)  # a repeated mark
    assert [caught_up(last) for last in (None, 4, 5, 0)] == [False, False, True, True]
    lanes.mark(other, GID, 5)
    replied["y"] = now - 1.0
    assert not caught_up(4), "the reply was to an earlier query"
    replied["y"] = time.monotonic()
    assert caught_up(4)
    lanes.mark(lane, GID, 5)
    assert not caught_up(4)
    assert caught_up(4, time.monotonic() + CAUGHT_SECONDS), "the session has not responded in time"


def test_marks_of_departed_publishers_and_ended_lanes_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lane_state, "_SPARED_MARKS", 1)
    lanes, lane, other = Lanes(), inlet(), inlet("y")
    for gid in (b"a", b"b", b"c", b"d"):
        lanes.mark(lane, gid, 1)
    lanes.prune([b"a", b"b"])
    assert set(lanes.joined) == {b"a", b"b", b"c", b"d"}, "few marks are spared"
    lanes.prune([b"a"])
    assert set(lanes.joined) == {b"a"}
    lanes.mark(other, b"e", 1)
    lanes.inlets = {lane: 0.0, other: 0.0}
    lanes.leave(lane)
    assert (lanes.is_leaving(b"a"), lanes.is_leaving(b"e"), lanes.is_leaving(b"?")) == (True, False, False)
    lanes.drop(lane)
    assert set(lanes.joined) == {b"e"}


class Declared:
    """Records the number of subscribers that a session has declared."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now: list[zenoh.Locality] = []
        self.most = self.least = 1
        monkeypatch.setattr(lane_state, "subscribe", self._subscribe)
        monkeypatch.setattr(lane_state, "undeclare", self._undeclare)

    def _subscribe(self, _session: object, _key: str, _callback: object, reach: zenoh.Locality) -> zenoh.Locality:
        self.now.append(reach)
        self.most = max(self.most, len(self.now))
        return reach

    def _undeclare(self, reach: zenoh.Locality) -> None:
        self.now.remove(reach)
        self.least = min(self.least, len(self.now))


@pytest.mark.parametrize("shared", [True, False])
def test_subscriber_switches_without_a_gap_in_its_session(monkeypatch: pytest.MonkeyPatch, shared: bool) -> None:
    declared = Declared(monkeypatch)
    reach = zenoh.Locality.ANY if shared else zenoh.Locality.REMOTE
    context: Any = SimpleNamespace(session=None, reach=reach)
    subscriber = ZenohSubscriber(context, "k", lambda _sample: None, threading.Lock())
    since = subscriber.declared
    subscriber.listen(everywhere=True)
    assert declared.now == [reach]
    subscriber.listen(everywhere=False)
    assert declared.now == ([zenoh.Locality.SESSION_LOCAL] if shared else [])
    assert not subscriber.everywhere
    subscriber.listen(everywhere=True)
    assert (declared.now, subscriber.everywhere) == ([reach], True)
    assert subscriber.declared > since
    if shared:
        assert (declared.least, declared.most) == (1, 2), "messages of the session's other nodes only arrive over zenoh"
    subscriber.close()
    subscriber.listen(everywhere=False)
    assert declared.now == []


class Chooser:
    """Stands in for a subscription: connects whenever it may choose."""

    def __init__(self, connect: Callable[[], object]) -> None:
        self._connect = connect

    def settle(self) -> bool:
        self._connect()
        return False

    def on_disconnected(self, inlet: Inlet) -> None:
        """Do nothing."""


def test_each_session_that_refused_a_connection_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next attempt for one session may come too early for another, which refused later."""
    monkeypatch.setattr(connections, "AGAIN_SECONDS", 0.5)
    monkeypatch.setattr(lane_module, "AGAIN_SECONDS", 0.5)
    attempts, wanted = Counter[str](), ["first"]

    def refuse(_folder: Path, zid: str) -> None:
        attempts[zid] += 1
        raise ConnectionRefusedError

    monkeypatch.setattr(folder, "connect", refuse)
    session: Any = SimpleNamespace(declare_queryable=lambda *_, **__: SimpleNamespace(undeclare=lambda: None))
    lanes = lane_module.Lane(tmp_path, "z", session, 0, lambda: None)
    try:
        lanes.add(Chooser(lambda: [lanes.connections.inlet(zid) for zid in wanted]))
        until(lambda: attempts["first"], "the first session refuses")
        refused = time.monotonic()
        until(lambda: time.monotonic() > refused + 0.25, "some time passes")
        wanted[:] = ["second"]
        lanes.graph_changed()
        until(lambda: attempts["second"] > 1, "the second session is tried again")
    finally:
        lanes.close()
