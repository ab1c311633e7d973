"""One worker's watch over the others on its network, on a clock of the test's own."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bridge.adapters.base import Sighting
from bridge.routing import lease, watch
from bridge.routing.election import Claim, Record
from bridge.routing.watch import Watch


class World:
    """A network with one other worker, "b", whose hub is ours; the hub's link to it may be lost."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.linked = 100.0, True
        self.told: list[Record] = []
        self.b_holds = False
        clock = SimpleNamespace(monotonic=lambda: self.now, time_ns=lambda: int(self.now * 1e9))
        for module in (watch, lease):
            monkeypatch.setattr(module, "time", clock)
        edge: Any = SimpleNamespace(
            side="fake", settled=lambda _: True, sightings=self._sightings, announce=lambda data: self._take(data)
        )
        members = lambda: {"b": frozenset("b")} if self.linked else {}  # noqa: E731
        graph = SimpleNamespace(members=members, origins=members, publishers=list)
        hub: Any = SimpleNamespace(zid="a", graph=graph, linked=lambda: True)
        self.watch = Watch(edge, hub, "A", lambda: None)

    def _take(self, data: bytes) -> None:
        record = Record.decode(data)
        assert record is not None
        self.told.append(record)

    def _sightings(self) -> list[Sighting]:
        acks = {"a": self.told[-1].seq} if self.told else {}
        crew = frozenset("ab") if self.linked else frozenset("b")
        role = Claim(5 if self.b_holds else 10**18, held=self.b_holds, first=1)
        record = Record("b", "B", len(self.told) + 1, acks, crew, "", role, {})
        return [Sighting("b", record.encode(), self.now)]

    def run(self, seconds: float) -> None:
        """Turn by turn."""
        for _ in range(round(seconds / 0.1)):
            self.now += 0.1
            self.watch._turn()


def test_who_stood_still_waits_for_its_hub_before_it_takes_another_for_a_strangers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World(monkeypatch)
    world.run(2.0)
    assert world.watch.outcome.active
    world.now += 10.0
    world.b_holds, world.linked = True, False
    world.run(2.0)
    assert not world.watch.outcome.active, "b may be on our hub: the link to it is not back yet"
    world.linked = True
    world.run(3.0)
    assert world.watch.outcome.standing_by == "B"


def test_after_a_short_standstill_the_hub_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(monkeypatch)
    world.run(2.0)
    assert world.watch.outcome.active
    world.now += 2.0
    world.watch._turn()
    assert not world.watch.outcome.active
    world.run(0.3)
    assert world.watch.outcome.active
