"""Elects which of several Midspan workers on one network forwards which messages, so that none is forwarded twice.

Each worker announces its claims to the others over their common foreign network, because their hubs may not be joined.
A claim is first requested, then held. Two claims conflict if they would together deliver a message twice:

- Of the workers whose hubs are joined, one holds the role of the hub on this network: it forwards messages from this
  network's programs to the hub, and messages from the hub's own programs to this network.
- Of all workers on this network whose hub has another network X, one forwards messages from X to this network. Workers
  whose hubs are not joined share this network without conflict, except for networks X that both hubs have.

A worker holds a claim as soon as every other living worker has acknowledged a record with the claim, none of them holds
a conflicting claim, and none requests an older conflicting one. A held claim stays held, even if an older worker
returns. While another worker is known but has not announced its claims, the role does not become held; only a worker
that holds the role claims networks.

This module contains only the policy, without a clock, threads or a network; `bridge.routing.peer_watch` drives it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from bridge.hub.wire.version import WIRE, refusal
from bridge.routing.edge import Sighting

PERIOD = 0.2
"""Seconds between two records."""

SILENCE = 1.0
"""Seconds without a record after which a worker counts as dead."""

UNKNOWN = 5.0
"""Maximum time in seconds to wait for the first record of a worker."""

CUT = 1.0
"""Seconds after which a worker on this network that left our hub counts as a worker of another hub."""

FOREIGN = "another Midspan worker on this network is incompatible"
"""Prefix of the reason why this worker does not become active if another worker's version is incompatible."""

MAX_RECORD = 1 << 18
_MAX_NAMES = 10_000


@dataclass(frozen=True, slots=True)
class Claim:
    """A worker's claim to a role or to the messages of a network.

    ``since`` is the time of the first request (wall clock, ns). The oldest of conflicting claims wins, even if the
    clocks differ. ``held``: the worker forwards the messages. ``first`` is the number of the first record with this
    request.
    """

    since: int
    held: bool
    first: int


@dataclass(frozen=True, slots=True)
class Record:
    """The record that a worker sends to the others on its network.

    Attributes:
        id: id of the worker's hub session.
        acks: number of the newest record received from each other worker.
        sessions: ids of the Midspan sessions on the worker's hub.
        process: name of the worker's process; see `bridge.routing.processes`.
        role: the claim to the hub's role on this network, None if the worker is leaving.
        carries: the claims to other networks; each network is identified by the ids of its workers.
    """

    id: str
    daemon: str
    seq: int
    acks: Mapping[str, int]
    sessions: frozenset[str]
    process: str
    role: Claim | None
    carries: Mapping[frozenset[str], Claim]

    def encode(self) -> bytes:
        """Encode the record as JSON."""
        return json.dumps({
            "wire": WIRE, "id": self.id, "daemon": self.daemon, "seq": self.seq, "acks": dict(self.acks),
            "crew": sorted(self.sessions), "process": self.process, "role": self.role and _words(self.role),
            "carries": [[sorted(of), _words(claim)] for of, claim in self.carries.items()],
        }, separators=(",", ":")).encode()  # fmt: skip

    @classmethod
    def decode(cls, data: bytes) -> Record | None:
        """Decode a record; return None if the bytes are invalid or the version is incompatible."""
        try:
            tree = None if cls.foreign(data) or len(data) > MAX_RECORD else json.loads(data)
            match tree:
                case {
                    "id": str(id_), "daemon": str(daemon), "seq": int(seq), "acks": dict(acks), "crew": list(sessions),
                    "process": str(process), "role": role, "carries": list(carries),
                } if len(acks) + len(sessions) + len(carries) < _MAX_NAMES:  # fmt: skip
                    return cls(
                        id_, daemon[:100], seq, {str(k): int(v) for k, v in acks.items()}, _ids(sessions), process,
                        None if role is None else _claim(role), {_ids(of): _claim(claim) for of, claim in carries},
                    )  # fmt: skip
        except (ValueError, TypeError, OverflowError, RecursionError):
            return None
        return None

    @staticmethod
    def foreign(data: bytes) -> str:
        """Return why the version of a record is incompatible, "" if it is compatible."""
        try:
            tree = json.loads(data) if len(data) <= MAX_RECORD else None
        except (ValueError, RecursionError):
            return ""
        return refusal(tree.get("wire")) if isinstance(tree, dict) else ""

    @property
    def first(self) -> int:
        """Number of the worker's first record that had all of this record's claims."""
        claims = [*self.carries.values(), *([self.role] if self.role else [])]
        return max((c.first for c in claims), default=0)

    def same(self, other: Record | None) -> bool:
        """Return whether two records are equal except for their numbers and acknowledgments."""
        return other is not None and replace(self, seq=0, acks={}) == replace(other, seq=0, acks={})


@dataclass(frozen=True, slots=True)
class HubView:
    """The part of the hub's state that the election needs.

    ``sessions`` are the ids of the hub's Midspan sessions, including ours. ``networks`` are its foreign networks, each
    given by the ids of its workers (`join`). ``settled``: all sessions on the hub are known.
    """

    sessions: frozenset[str] = frozenset()
    networks: Sequence[frozenset[str]] = ()
    settled: bool = True


@dataclass(frozen=True, slots=True)
class Outcome:
    """The state of the election for this worker.

    Attributes:
        term: a number that changes when held claims may have been lost; the routes are then created again.
        active: whether this worker holds its hub's role on this network.
        carried: ids of the hub sessions whose messages this worker forwards to this network.
        carriers: for each other hub session, the daemon that forwards its messages to this network instead.
        holder: the daemon that holds the role instead, "" if none does.
        waiting: why no worker is known to hold the role yet.
        members: ids of all living workers on this network, including this one.
    """

    term: int = 0
    active: bool = False
    carried: frozenset[str] = frozenset()
    carriers: Mapping[str, str] = field(default_factory=dict)
    holder: str = ""
    waiting: str = ""
    members: frozenset[str] = frozenset()

    @property
    def standing_by(self) -> str:
        """The daemons that forward to this network instead of this worker, "" if this worker forwards.

        If this worker holds the role but forwards the messages of no other network, these are the daemons that do so;
        if it does not hold the role, its holder.
        """
        if not self.active:
            return self.holder
        return "" if self.carried else ", ".join(sorted(set(self.carriers.values())))


class Election:
    """One worker's part in the election on one network; ``gone`` returns whether a record's process has exited."""

    def __init__(
        self, me: str, daemon: str, process: str = "", gone: Callable[[Record], bool] = lambda _: False
    ) -> None:
        self._me, self._daemon, self._process, self._gone = me, daemon, process, gone
        self._seq = 0
        self._role: Claim | None = None
        self._carries: dict[frozenset[str], Claim] = {}
        self._lapsed = float("-inf")
        self._met: dict[str, float] = {}
        self._decoded: dict[str, tuple[bytes, Record | None]] = {}
        self._last_sent: Record | None = None
        self.outcome = Outcome()

    def lapse(self, now: float, *, same_term: bool = False) -> None:
        """Request all claims again, with unchanged ``since``, because others may hold them after a suspension.

        With ``same_term``, keep the term, unless another worker appears before the role is held again.
        """
        self._lapsed = now
        if self._role is not None and self._role.held:
            term = self.outcome.term + (not same_term)
            self.outcome = replace(self.outcome, term=term, active=False, carried=frozenset())
        if self._role is not None:
            self._role = self._requested_again(self._role)
        self._carries = {of: self._requested_again(claim) for of, claim in self._carries.items()}

    def _requested_again(self, claim: Claim) -> Claim:
        return replace(claim, held=False, first=self._seq + 1)

    def run_round(
        self, now: float, wall_ns: int, sightings: Sequence[Sighting], hub: HubView, *, settled: bool
    ) -> tuple[Record, bool]:
        """Decide according to the current sightings; return the record to send, and whether it is urgent.

        ``now`` is on the sightings' monotonic clock, ``wall_ns`` on the wall clock; ``settled``: all workers on the
        network are known.
        """
        others, waiting = self._living(now, sightings)
        joined = [o for o in others if self._joined(o, hub, now)]
        if not settled:
            waiting = "discovering other Midspan daemons on this network"
        elif not waiting and not hub.settled and len(joined) < len(others):
            waiting = "checking whether the other Midspan daemons on this network share this hub"
        self._elect_role(joined, others, wall_ns, ready=not waiting)
        members = frozenset({self._me, *(o.id for o in others)})
        carriers = self._elect_networks(hub.networks, members, others, wall_ns)
        self._seq += 1
        record = self._record(others, hub)
        urgent = not record.same(self._last_sent) or any(o.first > self._acked(o) for o in others)
        self._conclude(joined, carriers, members, waiting)
        return record, urgent

    def sent(self, record: Record) -> None:
        """Note that the record was sent."""
        self._last_sent = record

    def leave(self) -> Record:
        """Return the last record, which releases all claims."""
        self._seq += 1
        self._role, self._carries = None, {}
        return Record(self._me, self._daemon, self._seq, {}, frozenset(), self._process, None, {})

    # -- other workers -------------------------------------------------------------------------------------------------

    def _living(self, now: float, sightings: Sequence[Sighting]) -> tuple[list[Record], str]:
        """Return the records of the other living workers, and why some claims are not known yet, "" if all are."""
        waiting = ""
        decoded: dict[str, tuple[bytes, Record | None]] = {}
        living: dict[str, Record] = {}
        for sighting in sightings:
            record = self._decode(sighting, decoded)
            age = now - max(sighting.received, self._lapsed)
            if record is None:
                reason = "" if sighting.record is None else Record.foreign(sighting.record)
                if reason and age < SILENCE:
                    waiting = f"{FOREIGN}, and {reason}"
                elif age < UNKNOWN and not waiting:
                    waiting = "another Midspan worker on this network has not announced its claims yet"
            elif record.id != self._me and record.role is not None and age < SILENCE and not self._gone(record):
                living[record.id] = record
        self._decoded = decoded
        return list(living.values()), waiting

    def _decode(self, sighting: Sighting, decoded: dict[str, tuple[bytes, Record | None]]) -> Record | None:
        if sighting.record is None:
            return None
        cached = self._decoded.get(sighting.id)
        if cached is None or cached[0] is not sighting.record:
            cached = (sighting.record, Record.decode(sighting.record))
        decoded[sighting.id] = cached
        return cached[1]

    def _joined(self, other: Record, hub: HubView, now: float) -> bool:
        """Whether another worker shares our hub, or left it only a moment ago."""
        if other.id in hub.sessions or self._me in other.sessions:
            self._met[other.id] = now
        return now - self._met.get(other.id, float("-inf")) < CUT

    def _acked(self, other: Record) -> int:
        return self._last_sent.acks.get(other.id, 0) if self._last_sent is not None else 0

    # -- claims --------------------------------------------------------------------------------------------------------

    def _elect_role(self, joined: Sequence[Record], others: Sequence[Record], wall_ns: int, *, ready: bool) -> None:
        role = self._role or Claim(wall_ns, held=False, first=self._seq + 1)
        rivals = [(o.id, o.role) for o in joined if o.role is not None]
        self._role = self._elect(role, rivals, others, wall_ns, ready=ready)
        if role.held and not self._role.held:
            self.outcome = replace(self.outcome, term=self.outcome.term + 1)

    def _elect_networks(
        self, networks: Sequence[frozenset[str]], members: frozenset[str], others: Sequence[Record], wall_ns: int
    ) -> dict[str, str]:
        """Elect for each of the hub's networks; return by session the daemon that forwards its messages instead."""
        before, self._carries = self._carries, {}
        carriers: dict[str, str] = {}
        if self._role is None or not self._role.held:
            return carriers
        for network in networks:
            if network & members:
                continue
            claims = [claim for of, claim in before.items() if of & network]
            claim = min(claims, key=lambda c: (not c.held, c.since), default=Claim(wall_ns, False, self._seq + 1))
            rivals = [(o.id, theirs, o.daemon) for o in others for of, theirs in o.carries.items() if of & network]
            claim = self._elect(claim, [r[:2] for r in rivals], others, wall_ns, ready=True)
            self._carries[network] = claim
            if not claim.held:
                best = min(rivals, key=lambda r: (not r[1].held, r[1].since), default=("", claim, ""))
                carriers.update(dict.fromkeys(network, best[2]))
        return carriers

    def _elect(
        self, claim: Claim, rivals: Sequence[tuple[str, Claim]], others: Sequence[Record], wall_ns: int, *, ready: bool
    ) -> Claim:
        better = [c for id_, c in rivals if (c.since, id_) < (claim.since, self._me)]
        if claim.held:
            # Two workers can hold the same claim after separate networks or hubs were joined.
            lost = any(c.held for c in better)
            return Claim(wall_ns, held=False, first=self._seq + 1) if lost else claim
        if not ready or better or any(c.held for _, c in rivals):
            return claim
        answered = all(o.acks.get(self._me, 0) >= claim.first for o in others)
        return replace(claim, held=True) if answered else claim

    # -- the outcome ---------------------------------------------------------------------------------------------------

    def _record(self, others: Sequence[Record], hub: HubView) -> Record:
        acks = {o.id: o.seq for o in others}
        role, carries = self._role, dict(self._carries)
        return Record(self._me, self._daemon, self._seq, acks, hub.sessions, self._process, role, carries)

    def _conclude(
        self, joined: Sequence[Record], carriers: Mapping[str, str], members: frozenset[str], waiting: str
    ) -> None:
        active = self._role is not None and self._role.held
        holder = next((o.daemon for o in joined if o.role is not None and o.role.held), "")
        carried = frozenset().union(*(of for of, claim in self._carries.items() if claim.held))
        if not active and not holder:
            waiting = waiting or "the workers on this network are agreeing on who is active"
        before = self.outcome
        met = not active and len(members) > 1 and len(before.members) <= 1
        self.outcome = Outcome(
            before.term + met,
            active,
            carried,
            carriers,
            "" if active else holder,
            "" if active or holder else waiting,
            members,
        )


def join(members: Mapping[str, frozenset[str]]) -> list[frozenset[str]]:
    """Return the networks of a hub's sessions; ``members``: by session, the workers that it announces on its network.

    The sets of two sessions on the same network overlap, because at least one of the two workers knows the other.
    """
    networks: list[frozenset[str]] = []
    for session, announced in members.items():
        network = announced | {session}
        apart = [other for other in networks if not other & network]
        networks = [*apart, network.union(*(other for other in networks if other & network))]
    return networks


def _words(claim: Claim) -> list[int]:
    return [claim.since, int(claim.held), claim.first]


def _claim(words: Any) -> Claim:
    since, held, first = words
    return Claim(int(since), bool(held), int(first))


def _ids(names: list[Any]) -> frozenset[str]:
    return frozenset(str(name)[:100] for name in names)
