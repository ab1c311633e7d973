"""One worker's watch over the other workers on its network, with the test's own clock."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bridge.routing import peer_watch
from bridge.routing.edge import Sighting
from bridge.routing.election import Claim, Record
from bridge.routing.peer_watch import HubViews, PeerWatch


class World:
    """A network with one other worker, "b", which is on the same hub; the hub's link to it may be lost."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.slept, self.linked = 100.0, 0.0, True
        self.told: list[Record] = []
        self.b_holds, self.b_lives, self.b_since = False, True, 5
        self.b_received: float | None = None  # when the last record was received; None for now
        clock = SimpleNamespace(monotonic=lambda: self.now, time_ns=lambda: int(self.now * 1e9))
        monkeypatch.setattr(peer_watch, "time", clock)
        monkeypatch.setattr(peer_watch, "steady", lambda: self.now + self.slept)
        self.settled, self.asked = True, set[float]()
        edge: Any = SimpleNamespace(
            side="fake",
            settled=self._settled,
            sightings=self._sightings,
            announce=lambda data: self._on_record(data),
        )
        members = lambda: {"b": frozenset("b")} if self.linked else {}  # noqa: E731
        graph = SimpleNamespace(members=members, origins=members, publishers=list)
        hub: Any = SimpleNamespace(zid="a", graph=graph, linked=lambda: True)
        self.watch = PeerWatch(edge, hub, "A", lambda: None)

    def _settled(self, since: float) -> bool:
        self.asked.add(since)
        return self.settled

    def _on_record(self, data: bytes) -> None:
        record = Record.decode(data)
        assert record is not None
        self.told.append(record)

    def _sightings(self) -> list[Sighting]:
        if not self.b_lives:
            return []
        acks = {"a": self.told[-1].seq} if self.told else {}
        sessions = frozenset("ab") if self.linked else frozenset("b")
        role = Claim(self.b_since if self.b_holds else 10**18, held=self.b_holds, first=1)
        record = Record("b", "B", len(self.told) + 1, acks, sessions, "", role, {})
        return [Sighting("b", record.encode(), self.now if self.b_received is None else self.b_received)]

    def run(self, seconds: float) -> None:
        """Run the watch for a time, in steps of 0.1 s."""
        for _ in range(round(seconds / 0.1)):
            self.now += 0.1
            self.watch.run_round()


def test_suspended_worker_waits_for_its_hub_before_it_judges_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World(monkeypatch)
    world.run(2.0)
    assert world.watch.outcome.active
    world.now += 10.0
    world.b_holds, world.linked = True, False
    world.run(2.0)
    assert not world.watch.outcome.active, "b may be on our hub, although the link to it is not restored yet"
    world.linked = True
    world.run(3.0)
    assert world.watch.outcome.standing_by == "B"


def test_worker_whose_machine_slept_does_not_take_the_network_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """The monotonic clock stands meanwhile, so the lease has not expired, and this worker's claim is the older one."""
    world = World(monkeypatch)
    world.run(2.0)
    assert world.watch.outcome.active
    world.slept += 60.0
    world.b_holds, world.b_since = True, 10**18
    world.run(0.1)
    assert not world.watch.outcome.active
    world.run(5.0)
    assert world.watch.outcome.standing_by == "B"
    assert world.watch.lease.over
    world.b_lives = False
    world.run(5.0)
    assert world.watch.outcome.active, "it may take over as usual"


@pytest.mark.parametrize("hang", [1.5, 30.0])
def test_suspended_standby_worker_does_not_count_its_suspension_as_the_silence_of_another(
    monkeypatch: pytest.MonkeyPatch, hang: float
) -> None:
    """Its first round may begin before another thread reads the other worker's records."""
    world = World(monkeypatch)
    world.b_holds = True
    world.run(4.0)
    assert world.watch.outcome.standing_by == "B"
    world.b_received = world.now
    world.now += hang
    world.watch.run_round()
    assert not world.watch.outcome.active
    world.b_received = None
    world.run(2.0)
    assert world.watch.outcome.standing_by == "B"
    world.b_received = world.now
    world.run(2.0)
    assert world.watch.outcome.active, "the other worker is silent while this one runs"


def test_hub_is_known_after_a_short_suspension(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(monkeypatch)
    world.run(2.0)
    assert world.watch.outcome.active
    world.now += 2.0
    world.watch.run_round()
    assert not world.watch.outcome.active
    world.run(0.3)
    assert world.watch.outcome.active


def test_lone_worker_keeps_its_routes_until_others_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(monkeypatch)
    world.b_lives = False
    world.run(2.0)
    before = world.watch.outcome
    assert before.active
    world.now += 2.0
    world.settled = False
    world.asked.clear()
    world.run(0.5)
    assert len(world.asked) == 1, "the watch was suspended once"
    assert world.watch.lease.over, "nothing is bridged until the other workers are known"
    assert world.watch.outcome == replace(before, waiting=world.watch.outcome.waiting)
    assert world.watch.outcome.waiting
    world.settled = True
    world.run(0.5)
    assert not world.watch.lease.over
    assert world.watch.outcome == before


def test_lone_worker_releases_its_routes_to_a_newcomer(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(monkeypatch)
    world.b_lives = False
    world.run(2.0)
    before = world.watch.outcome
    world.now += 4.0
    world.settled, world.b_lives, world.b_holds = False, True, True
    world.run(0.5)
    assert not world.watch.outcome.active
    world.settled, world.b_lives = True, False
    world.run(2.0)
    assert world.watch.outcome.active
    assert world.watch.outcome.term > before.term, "a new term makes the worker create its routes again"


class LinkedHub:
    """A hub with three workers: one lists members of its network, two list none, and one of these two publishes."""

    zid = "a"

    def __init__(self) -> None:
        self.graph = self
        self.is_linked = False

    def linked(self) -> bool:
        return self.is_linked

    def members(self) -> dict[str, frozenset[str]]:
        return {"b": frozenset({"b", "c"})}

    def origins(self) -> list[str]:
        return ["b", "foreign", "silent"]

    def publishers(self) -> list[Any]:
        return [SimpleNamespace(zid="foreign")]


def test_hub_counts_as_known_a_second_after_the_first_link_or_three_without_one() -> None:
    hub = LinkedHub()
    views = HubViews(cast("Any", hub))
    views.restart(100.0)
    assert [views.now(now).settled for now in (100.1, 103.0, 103.1)] == [False, False, True]
    hub.is_linked = True
    assert [views.now(now).settled for now in (104.0, 105.0, 105.1)] == [False, False, True]
    views.restart(200.0, 2.5)
    assert [views.now(now).settled for now in (200.0, 202.5, 202.6)] == [False, False, True]


def test_worker_that_lists_no_members_is_a_network_by_itself_if_it_publishes() -> None:
    view = HubViews(cast("Any", LinkedHub())).now(100.0)
    assert view.sessions == {"a", "b", "foreign", "silent"}
    assert set(view.networks) == {frozenset({"b", "c"}), frozenset({"foreign"})}
