"""Which of several Midspan workers on a network carries what: the policy, with a clock that the test advances."""

from __future__ import annotations

import itertools
import json
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from zlib import crc32

import pytest

from bridge.routing.edge import Sighting
from bridge.routing.election import (
    CUT,
    PERIOD,
    SILENCE,
    UNKNOWN,
    Claim,
    Election,
    HubView,
    Record,
    join,
)

NS = 1_000_000_000


@dataclass
class Worker:
    """One worker's election, and the records that reach it."""

    name: str
    network: str
    hub: str
    election: Election
    started: float
    delay: float = 0.05
    alive: bool = True
    record: bytes = b""
    skew: int = 0
    held: list[tuple[float, frozenset[str]]] = field(default_factory=list)

    @property
    def active(self) -> bool:
        return self.alive and self.election.outcome.active


class World:
    """Networks, hubs and workers in memory; time runs in steps."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.workers: list[Worker] = []
        self.gone: set[str] = set()
        self.joined: set[frozenset[str]] = set()
        self._on_the_way: list[tuple[float, str, str, bytes]] = []
        self._heard: dict[tuple[str, str], Sighting] = {}
        self.settle = 0.5

    def add(self, name: str, network: str, hub: str, *, known_gone: bool = False, **more: float) -> Worker:
        election = Election(name, name.partition("/")[0], name, lambda r: known_gone and r.process in self.gone)
        worker = Worker(name, network, hub, election, self.now, **more)  # type: ignore[arg-type]
        self.workers.append(worker)
        return worker

    def neighbors(self, worker: Worker) -> list[Worker]:
        return [w for w in self.workers if w.network == worker.network and w is not worker]

    def same_hub(self, a: Worker, b: Worker) -> bool:
        return a.hub == b.hub or frozenset({a.hub, b.hub}) in self.joined

    def kill(self, worker: Worker) -> None:
        worker.alive = False
        self.gone.add(worker.name)

    def _hub(self, worker: Worker) -> HubView:
        sessions = [w for w in self.workers if w.alive and self.same_hub(w, worker)]
        members = {w.name: w.election.outcome.members for w in sessions if w.active}
        return HubView(frozenset(w.name for w in sessions), join(members), settled=self.now > worker.started + 1.0)

    def run_round(self, worker: Worker) -> None:
        sightings = [s for (to, _), s in self._heard.items() if to == worker.name]
        record, _ = worker.election.run_round(
            self.now,
            int(self.now * NS) + worker.skew,
            sightings,
            self._hub(worker),
            settled=self.now > worker.started + self.settle,
        )
        worker.election.sent(record)
        worker.record = record.encode()
        for other in self.neighbors(worker):
            self._on_the_way.append((self.now + other.delay, other.name, worker.name, worker.record))

    def step(self) -> None:
        self.now += 0.05
        arrived = [m for m in self._on_the_way if m[0] <= self.now]
        self._on_the_way = [m for m in self._on_the_way if m[0] > self.now]
        for _, to, sender, record in arrived:
            self._heard[to, sender] = Sighting(sender, record, self.now)
        for worker in self.workers:
            if worker.alive and round(self.now / 0.05) % 4 == crc32(worker.name.encode()) % 4:
                self.run_round(worker)
        self.check()

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.05)):
            self.step()

    def until(self, condition: object, limit: float) -> float:
        start = self.now
        while not condition():  # type: ignore[operator]
            assert self.now - start < limit, f"not within {limit} s"
            self.step()
        return self.now - start

    def active(self) -> list[Worker]:
        return [worker for worker in self.workers if worker.active]

    def paths(self) -> Iterator[tuple[str, str, str]]:
        """Yield every path of a message: its source network, its destination network, and the workers that carry it."""
        for put, take in itertools.product(self.active(), repeat=2):
            across = put.network != take.network and self.same_hub(put, take)
            if across and take.name in put.election.outcome.carried:
                yield take.network, put.network, f"{take.name} {put.name}"

    def check(self) -> None:
        """Assert that no message has two paths to a network, or two paths into a hub."""
        paths = [path[:2] for path in self.paths()]
        assert len(paths) == len(set(paths)), sorted(self.paths())
        entries = itertools.combinations(self.active(), 2)
        assert not [(w.name, v.name) for w, v in entries if w.network == v.network and self.same_hub(w, v)]

    def reached(self) -> set[tuple[str, str]]:
        return {path[:2] for path in self.paths()}


@pytest.fixture
def world() -> World:
    return World()


def pairs(networks: str) -> set[tuple[str, str]]:
    return set(itertools.permutations(networks, 2))


def ring(world: World, hubs: Sequence[str]) -> list[Worker]:
    return [world.add(f"{d}/{n}", n, hub) for d, hub in zip("AB", hubs, strict=True) for n in "XY"]


def test_lone_daemon_becomes_active_once_settled(world: World) -> None:
    world.add("A/X", "X", "h")
    world.add("A/Y", "Y", "h")
    assert world.until(lambda: world.reached() == pairs("XY"), 2) >= world.settle


@pytest.mark.parametrize("hubs", ["hh", "ij"])
def test_a_ring_of_two_started_at_once_is_bridged_once(world: World, hubs: str) -> None:
    ring(world, hubs)
    world.until(lambda: world.reached() == pairs("XY"), 5)
    world.run(10)
    assert world.reached() == pairs("XY")


@pytest.mark.parametrize("hubs", ["hhh", "ijk", "iij"])
def test_a_triangle_of_three_is_bridged_once(world: World, hubs: str) -> None:
    for daemon, networks, hub in zip("ABC", ("XY", "YZ", "ZX"), hubs, strict=True):
        for network in networks:
            world.add(f"{daemon}/{network}", network, hub)
    world.until(lambda: world.reached() == pairs("XYZ"), 5)
    world.run(5)
    assert world.reached() == pairs("XYZ")


def test_separate_hubs_forward_to_networks_that_only_one_of_them_has(world: World) -> None:
    for network in "XY":
        world.add(f"A/{network}", network, "i")
    for network in "XYZ":
        world.add(f"B/{network}", network, "j")
    world.until(lambda: world.reached() == pairs("XYZ"), 5)
    assert all(w.active for w in world.workers), "each hub's own programs reach every network"


@pytest.mark.parametrize("hubs", ["hh", "ij"])
@pytest.mark.parametrize("known_gone", [True, False])
def test_the_successor_keeps_its_claims_when_the_former_worker_returns(
    world: World, hubs: str, known_gone: bool
) -> None:
    first = [world.add(f"A/{n}", n, hubs[0]) for n in "XY"]
    world.until(lambda: world.reached() == pairs("XY"), 5)
    for network in "XY":
        world.add(f"B/{network}", network, hubs[1], known_gone=known_gone)
    world.run(5)
    assert all("A/" in path[2] and "B/" not in path[2] for path in world.paths())
    for worker in first:
        world.kill(worker)
    taken = world.until(lambda: world.reached() == pairs("XY"), 5)
    assert taken < (3 * PERIOD if known_gone else SILENCE + 2 * PERIOD)
    for network in "XY":
        world.add(f"A2/{network}", network, hubs[0], skew=-3600 * NS)
    world.run(5)
    assert all("B/" in path[2] and "A2/" not in path[2] for path in world.paths()), (
        "the successor keeps its claims, although those of the newcomer look older"
    )


@pytest.mark.parametrize("hubs", ["hh", "ij"])
def test_only_one_worker_of_the_active_daemon_dies(world: World, hubs: str) -> None:
    workers = ring(world, hubs)
    world.until(lambda: world.reached() == pairs("XY"), 5)
    victim = next(w for w in workers if w.active and w.network == "X" and (hubs == "hh" or w.election.outcome.carried))
    world.kill(victim)
    world.run(0.1)
    world.until(lambda: world.reached() == pairs("XY"), SILENCE + 5 * PERIOD)


def test_suspended_daemon_is_inactive_until_it_has_checked(world: World) -> None:
    workers = ring(world, "hh")
    world.until(lambda: world.reached() == pairs("XY"), 5)
    still = [w for w in workers if w.active]
    for worker in still:
        worker.alive = False
    world.until(lambda: world.reached() == pairs("XY"), SILENCE + 3 * PERIOD)
    for worker in still:
        worker.alive = True
        worker.election.lapse(world.now)
        assert not worker.active
        world.run_round(worker)
        assert not worker.active
    world.run(5)
    assert not any(w.active for w in still)


def test_suspended_lone_daemon_continues_in_a_new_term(world: World) -> None:
    worker = world.add("A/X", "X", "h")
    world.until(lambda: worker.active, 5)
    term = worker.election.outcome.term
    worker.election.lapse(world.now)
    world.until(lambda: worker.active, 1)
    assert worker.election.outcome.term == term + 1


def test_only_records_received_after_a_suspension_count() -> None:
    election = Election("a", "A")

    def run_round(now: float, heard: bytes) -> bool:
        election.run_round(now, 5, [Sighting("b", heard, now)], HubView(frozenset("ab")), settled=True)
        return election.outcome.active

    def standby(acked: int) -> bytes:
        return Record("b", "B", acked, {"a": acked}, frozenset("ab"), "", Claim(9, held=False, first=1), {}).encode()

    assert not run_round(1.0, standby(0))
    assert run_round(1.2, standby(1))
    election.lapse(5.0)
    assert not run_round(5.0, standby(2)), "b may have taken over since it sent this record"
    assert run_round(5.2, standby(3))


def test_other_sessions_of_its_own_network_are_not_carried(world: World) -> None:
    first, second = world.add("A/X", "X", "h"), world.add("B/X", "X", "h")
    world.until(lambda: first.active or second.active, 5)
    world.run(2)
    assert not first.election.outcome.carried | second.election.outcome.carried


def test_unreachable_daemon_delays_activation_for_a_limited_time() -> None:
    election, unheard = Election("a", "A"), Sighting("?", None, 10.0)
    for now, active in ((10.0, False), (10.0 + UNKNOWN - 0.1, False), (10.0 + UNKNOWN, True)):
        election.run_round(now, int(now * NS), [unheard], HubView(), settled=True)
        assert election.outcome.active is active
    assert not election.outcome.waiting


def test_no_daemon_is_active_beside_another_major_version() -> None:
    election = Election("b", "B")
    other = json.loads(Record("a", "A", 5, {"b": 100}, frozenset("a"), "", Claim(1, held=True, first=1), {}).encode())

    def run_round(now: float, heard: float, version: str) -> str:
        record = json.dumps({**other, "wire": version, "more": 1}).encode()
        election.run_round(now, 100, [Sighting("a", record, heard)], HubView(frozenset("ab")), settled=True)
        assert not election.outcome.active
        return election.outcome.waiting

    for now in (1.0, 1.0 + 10 * UNKNOWN):
        assert "uses version 2.0 of Midspan's protocol" in run_round(now, now, "2.0")
    assert run_round(90.0, 90.0, "1.99") == ""
    assert election.outcome.standing_by == "A", "records of a later minor version are understood"
    election.run_round(91.0 + SILENCE, 100, [Sighting("a", b'{"wire": "2.0"}', 90.0)], HubView(), settled=True)
    election.run_round(91.0 + UNKNOWN, 100, [], HubView(), settled=True)
    assert election.outcome.active, "the other worker has left"


def test_nothing_is_bridged_while_it_is_unknown_whether_hubs_are_joined() -> None:
    election = Election("b", "B")
    other = Record("a", "A", 5, {"b": 100}, frozenset("a"), "", Claim(1, held=True, first=1), {})

    def run_round(now: float, hub: HubView) -> tuple[bool, str]:
        election.run_round(now, 100, [Sighting("a", other.encode(), now)], hub, settled=True)
        return election.outcome.active, election.outcome.standing_by

    assert run_round(1.0, HubView(settled=False)) == (False, "")
    assert "share this hub" in election.outcome.waiting
    assert run_round(2.0, HubView(frozenset("ab"))) == (False, "A")
    assert run_round(2.0 + CUT / 2, HubView()) == (False, "A"), "a link may fail and be restored"
    assert run_round(2.0 + CUT, HubView()) == (True, ""), "the hubs are separate, and no other worker serves this one"


def test_joined_hubs_agree_on_one_active_daemon(world: World) -> None:
    ring(world, "ij")
    world.until(lambda: world.reached() == pairs("XY"), 5)
    world.check = lambda: None  # type: ignore[method-assign]  # both are active until they notice the link
    world.joined.add(frozenset("ij"))
    world.run(2 * PERIOD)
    del world.check
    world.until(lambda: world.reached() == pairs("XY"), 5)
    assert sum(w.active for w in world.workers) == 2


@pytest.mark.parametrize("seed", range(30))
def test_two_daemons_are_never_active_on_one_network(seed: int) -> None:
    """Daemons start, die and are suspended at random, with slow links and wrong clocks; each step is checked."""
    dice, world = random.Random(seed), World()
    names = (f"D{n}" for n in itertools.count())
    for _ in range(60):
        event = dice.random()
        alive = [w for w in world.workers if w.alive]
        if event < 0.4 and len(alive) < 8:
            name, hub = next(names), dice.choice("hij")
            for network in dice.sample("XYZ", 2):
                skew = dice.choice((0, -3600, 3600)) * NS
                world.add(f"{name}/{network}", network, hub, delay=dice.uniform(0.01, 0.2), skew=skew)
        elif event < 0.6 and alive:
            world.kill(dice.choice(alive))
        elif event < 0.7 and alive:
            still = dice.choice(alive)
            still.alive = False
            world.run(dice.uniform(0.8, 2.0))
            still.alive = True
            still.election.lapse(world.now)
            still.started = world.now
        world.run(dice.uniform(0.0, 1.5))
    alive = [w for w in world.workers if w.alive]
    world.run(6)
    hubs = {hub: {w.network for w in alive if w.hub == hub} for hub in "hij"}
    assert world.reached() == {pair for networks in hubs.values() for pair in itertools.permutations(networks, 2)}


def test_records_survive_the_round_trip() -> None:
    claims = {frozenset({"x", "y"}): Claim(1, held=False, first=9)}
    record = Record("a", "A", 9, {"b": 3}, frozenset({"a", "b"}), "p", Claim(7, held=True, first=4), claims)
    assert Record.decode(record.encode()) == record
    assert record.first == 9
    assert not record.same(None)


@pytest.mark.parametrize(
    "junk", [b"", b"{}", b"[]", b"\xff", b"[" * 100_000, b'{"id":1}', b'{"role": [1, 2]}', b"null" * 100_000]
)
def test_malformed_record_is_rejected(junk: bytes) -> None:
    assert Record.decode(junk) is None


@pytest.mark.parametrize(("key", "value"), [("role", [1]), ("carries", [1]), ("acks", {"a": []}), ("crew", 1)])
def test_record_with_an_invalid_part_is_rejected(key: str, value: object) -> None:
    tree = json.loads(Record("a", "A", 1, {}, frozenset(), "", None, {}).encode())
    assert Record.decode(json.dumps(tree).encode()) is not None
    assert Record.decode(json.dumps({**tree, key: value}).encode()) is None


def test_overlapping_networks_are_joined() -> None:
    announced = {"a": frozenset("ab"), "c": frozenset("bc"), "d": frozenset("d"), "e": frozenset("ec")}
    assert sorted(map(sorted, join(announced))) == [["a", "b", "c", "e"], ["d"]]
