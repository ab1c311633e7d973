"""Watches the other Midspan workers on the side's network, takes part in their election, and holds the lease."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from bridge.hub.errors import HubError
from bridge.hub.session import Hub
from bridge.hub.zenoh_config import LEASE_MS
from bridge.progress import StepWatch
from bridge.routing.edge import Edge
from bridge.routing.election import FOREIGN, PERIOD, Election, HubView, Outcome, join
from bridge.routing.processes import has_ended, process_name


class Lease:
    """The time until which messages may cross. A worker that stood still finds it over, and drops its backlog."""

    __slots__ = ("_until",)

    def __init__(self) -> None:
        self._until = 0.0

    @property
    def over(self) -> bool:
        """Whether nothing may cross now. Quick enough to be asked for each message."""
        return time.monotonic() > self._until

    def extend(self, until: float) -> None:
        """Let messages cross until then, on the monotonic clock."""
        self._until = until

    def end(self) -> None:
        """Let nothing cross any more."""
        self._until = 0.0


_log = logging.getLogger(__name__)

FENCE = 0.7
"""Seconds after its last record for which a worker carries on: less than `bridge.routing.election.SILENCE`."""

ALONE = 1.5
"""The same where no other worker is on the network: one that comes meanwhile waits longer than that."""

_ALONE_PERIOD = 0.4
"""Seconds between two turns where no other worker is seen; one that comes is told of at once."""

_TURN_SECONDS = 3.0
"""A turn that stands still for longer hangs."""

_PAUSE = 0.02
_HUB_LINKED = 1.0
"""Seconds from the first link on the hub until all that is on the hub would be seen."""

_HUB_AGAIN = 2.5
"""The same for one whose links were given up while it stood still: not all come back at once (`bridge.hub.links`)."""

_LINKS_LAST = 0.75 * LEASE_MS / 1000
"""So long it may stand still before the hub's other sessions give its links up: the last keep-alive was sent before."""

_HUB_ALONE = 3.0
"""Seconds after which a session without any link counts as the only one on its hub."""


class PeerWatch:
    """Exchanges records with the other workers on a thread, decides by `Election`, and keeps the ``lease``."""

    def __init__(self, edge: Edge, hub: Hub, daemon: str, changed: Callable[[], None]) -> None:
        self._edge, self._hub, self._changed = edge, hub, changed
        self._election = Election(hub.zid, daemon, process_name(), lambda record: has_ended(record.process))
        self.lease = Lease()
        self._outcome = Outcome()
        self.changes = 0  #: how often the role here was got or lost
        self._kept: Outcome | None = None
        self._started = self._since = self._turned = time.monotonic()
        self._linked: float | None = None
        self._settling = _HUB_LINKED
        self._due = 0.0
        self._step = StepWatch(_TURN_SECONDS)
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"midspan-{edge.side}-watch", daemon=True)

    @property
    def outcome(self) -> Outcome:
        """The outcome of the election."""
        return self._outcome

    def start(self) -> None:
        """Start taking part; the edge has started."""
        self._started = self._since = self._turned = time.monotonic()
        self._thread.start()

    def wake(self) -> None:
        """Look again soon. May be called from any thread."""
        self._wake.set()

    def stop(self) -> None:
        """Announce that this worker carries nothing any more; its routes are closed by now."""
        self.lease.end()
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
            self._edge.announce(self._election.leave().encode())

    def alive(self) -> str:
        """As `bridge.routing.engine.Engine.alive`, of this thread."""
        return self._step.judge(f"watching the other workers on {self._edge.side}", self._turned)

    def _run(self) -> None:
        self._step.begin()
        while not self._stopping.is_set():
            try:
                self.turn()
            except HubError:
                return
            except Exception:
                _log.exception("%s: watching the other workers failed", self._edge.side)
            outcome = self._election.outcome
            alone = outcome.active and len(outcome.members) == 1
            if self._wake.wait(_ALONE_PERIOD if alone else PERIOD):
                self._wake.clear()
                self._stopping.wait(_PAUSE)

    def turn(self) -> None:
        """Look once who is there, tell the others, and decide; raises `HubError` where the hub is closed."""
        now = time.monotonic()
        if self._election.outcome.active and self.lease.over:
            still = now - self._turned
            _log.warning("%s: stood still for %.1f s; looking who is active now", self._edge.side, still)
            alone = len(self._outcome.members) == 1
            self._kept = self._outcome if alone else None
            self._election.lapse(now, same_term=alone)
            self._since = now
            if still > _LINKS_LAST:
                self._started, self._linked, self._settling = now, None, _HUB_AGAIN
        self._turned = now
        record, urgent = self._election.turn(
            now, time.time_ns(), self._edge.sightings(), self._view(now), settled=self._edge.settled(self._since)
        )
        decided = self._election.outcome
        if urgent or now >= self._due:
            self._due = now + PERIOD - _PAUSE
            self._edge.announce(record.encode())
            self._election.sent(record)
        if decided.active:
            self.lease.extend(now + (FENCE if len(decided.members) > 1 else ALONE))
        else:
            self.lease.end()
        outcome = self._with_kept_routes(decided)
        if outcome != self._outcome:
            self._log_change(outcome)
            self.changes += outcome.active != self._outcome.active
            self._outcome = outcome
            self._changed()

    def _with_kept_routes(self, decided: Outcome) -> Outcome:
        """The outcome for the engine: who was alone before it stood still keeps its routes until another is met.

        Nothing crosses them meanwhile, by the lease. Programs that were connected to our endpoints by hand, as YARP's
        are, would not connect to new ones.
        """
        if decided.active or len(decided.members) > 1:
            self._kept = None
        return decided if self._kept is None else replace(self._kept, waiting=decided.waiting)

    def _view(self, now: float) -> HubView:
        graph = self._hub.graph
        if self._linked is None and self._hub.linked():
            self._linked = now
        since = self._started + _HUB_ALONE if self._linked is None else self._linked + self._settling
        members = graph.members()
        # One that carries without telling who is on its network, such as a worker of another make, is a network alone.
        sessions = frozenset(graph.origins())
        silent = sessions - members.keys()
        if silent:
            silent &= {e.zid for e in graph.publishers()}
        networks = join(members | dict.fromkeys(silent, frozenset()))
        return HubView(sessions | {self._hub.zid}, networks, settled=now > since)

    def _log_change(self, outcome: Outcome) -> None:
        before, now = self._outcome.standing_by, outcome.standing_by
        was_waiting = bool(self._outcome.waiting)
        if FOREIGN in outcome.waiting and outcome.waiting != self._outcome.waiting:
            _log.warning("%s: nothing crosses here: %s", self._edge.side, outcome.waiting)
        if now and now != before:
            _log.info("%s: standing by, %s is active on this network", self._edge.side, now)
        elif outcome.active and not now and not outcome.waiting and (before or was_waiting or not self._outcome.active):
            _log.info("%s: active on this network", self._edge.side)
