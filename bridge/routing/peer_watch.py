"""Follows the other Midspan workers on the side's network, takes part in the election, and holds the lease."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from bridge.clock import steady
from bridge.hub.errors import HubError
from bridge.hub.node import Hub
from bridge.hub.zenoh_config import LEASE_MS
from bridge.progress import StepWatch
from bridge.routing.edge import Edge
from bridge.routing.election import FOREIGN, PERIOD, Election, HubView, Outcome, join
from bridge.routing.processes import has_ended, process_name
from bridge.routing.shortcut import Deadline
from bridge.ticks import until_tick


class Lease(Deadline):
    """The time ``until`` which messages may be bridged (monotonic seconds).

    The lease of a worker that hangs expires, so that the worker drops its backlog afterwards. ``extended`` is called
    after each extension, on the thread that extends, and may only wake other threads.
    """

    __slots__ = ("extended",)

    def __init__(self) -> None:
        self.until = 0.0
        self.extended: Callable[[], None] = lambda: None

    @property
    def over(self) -> bool:
        """Whether the lease has expired. A route that already has the current time compares that with ``until``."""
        return time.monotonic() > self.until

    def extend(self, until: float) -> None:
        """Allow bridging until a time on the monotonic clock."""
        self.until = until
        self.extended()

    def end(self) -> None:
        """Allow no bridging from now on."""
        self.until = min(self.until, time.monotonic())


_log = logging.getLogger(__name__)

FENCE = 0.7
"""Seconds after a round within which the next one has to begin, less than `bridge.routing.election.SILENCE`. Otherwise
an active worker is no longer active, and no worker may count the records that it has not read yet as missing."""

ALONE = 1.5
"""Like `FENCE`, if no other worker is on the network; a worker that joins meanwhile waits longer than this."""

_ALONE_PERIOD = 0.5
"""Seconds between rounds if no other worker is known; the first worker that joins wakes the thread at once."""

_ROUND_SECONDS = 3.0
"""Seconds without progress after which a round counts as hanging."""

_PAUSE = 0.02
_HUB_LINKED = 1.0
"""Seconds from the first link on the hub until all sessions on the hub are known."""

HUB_AGAIN = 2.5
"""Like `_HUB_LINKED`, after a hang in which links were lost, which are restored one by one (`bridge.hub.links`)."""

LINKS_LAST = 0.75 * LEASE_MS / 1000
"""Seconds of a hang after which other sessions on the hub drop their links to this session. This is less than zenoh's
lease, because the last keep-alive was sent before the hang."""

_HUB_ALONE = 3.0
"""Seconds after which a session without links counts as the only one on its hub."""


class HubViews:
    """The hub as this worker's session sees it: its networks, and whether all of its sessions are known yet."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._linked: float | None = None
        self.restart(time.monotonic())

    def restart(self, now: float, settling: float = _HUB_LINKED) -> None:
        """Wait for the first link again, and from then on for ``settling`` seconds."""
        self._started, self._linked, self._settling = now, None, settling

    def now(self, now: float) -> HubView:
        """Return the view at a time on the monotonic clock."""
        graph = self._hub.graph
        if self._linked is None and self._hub.linked():
            self._linked = now
        since = self._started + _HUB_ALONE if self._linked is None else self._linked + self._settling
        members = graph.members()
        # A session that announces an origin but no members counts as a separate network if it has publishers.
        sessions = frozenset(graph.origins())
        silent = sessions - members.keys()
        if silent:
            silent &= {e.zid for e in graph.publishers()}
        networks = join(members | dict.fromkeys(silent, frozenset()))
        return HubView(sessions | {self._hub.zid}, networks, settled=now > since)


class PeerWatch:
    """A thread that exchanges records with the other workers, runs the `Election`, and holds the ``lease``.

    Other threads read the outcome, which is replaced as a whole, and the lease's ``until``. Only this thread writes
    them, except that `stop` ends the lease.
    """

    def __init__(self, edge: Edge, hub: Hub, daemon: str, changed: Callable[[], None]) -> None:
        self._edge, self._changed = edge, changed
        self._views = HubViews(hub)
        self._election = Election(hub.zid, daemon, process_name(), lambda record: has_ended(record.process))
        self.lease = Lease()
        self._outcome = Outcome()
        self.changes = 0  #: how often this worker became active or stopped being active
        self._outcome_before_hang: Outcome | None = None
        self._since = self._last_round = time.monotonic()
        self._next_by = self._last_round + ALONE  # a later round follows a hang
        self._slept = steady() - time.monotonic()  # the time for which the monotonic clock has stood
        self._due = 0.0
        self._step = StepWatch(_ROUND_SECONDS)
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"midspan-{edge.side}-watch", daemon=True)

    @property
    def outcome(self) -> Outcome:
        return self._outcome

    def start(self) -> None:
        """Start the thread; call it after the start of the edge."""
        self._since = self._last_round = now = time.monotonic()
        self._next_by = now + ALONE
        self._views.restart(now)
        self._thread.start()

    def wake(self) -> None:
        """Run a round soon. May be called from any thread."""
        self._wake.set()

    def stop(self) -> None:
        """Stop the thread, and announce that this worker has left; call it after its routes are closed."""
        self.lease.end()
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
            self._edge.announce(self._election.leave().encode())

    def alive(self) -> str:
        """Check this thread, as `bridge.routing.engine.Engine.alive` does for the engine's threads."""
        return self._step.judge(f"following the other workers on {self._edge.side}", self._last_round)

    def _run(self) -> None:
        self._step.begin()
        while not self._stopping.is_set():
            try:
                self.run_round()
            except HubError:
                return
            except Exception:
                _log.exception("%s: following the other workers failed", self._edge.side)
            outcome = self._election.outcome
            alone = outcome.active and len(outcome.members) == 1
            if self._wake.wait(until_tick(_ALONE_PERIOD) if alone else PERIOD):
                self._wake.clear()
                self._stopping.wait(_PAUSE)

    def run_round(self) -> None:
        """Read the other workers' records, announce this worker's record, and decide.

        Raises `HubError` if the hub is closed.
        """
        awake = steady()  # first, so that a pause between the two does not look like sleep
        now = time.monotonic()
        slept = max(awake - now - self._slept, 0.0)  # meanwhile the monotonic clock and the lease stood
        self._slept += slept
        if now + slept > self._next_by or (self._election.outcome.active and self.lease.over):
            hang = now - self._last_round + slept
            level = logging.WARNING if self._election.outcome.active else logging.DEBUG
            _log.log(level, "%s: suspended for %.1f s; checking for another active worker", self._edge.side, hang)
            alone = len(self._outcome.members) == 1
            self._outcome_before_hang = self._outcome if alone else None
            self._election.lapse(now, same_term=alone)
            self._since = now
            if hang > LINKS_LAST:
                self._views.restart(now, HUB_AGAIN)
        self._last_round = now
        record, urgent = self._election.run_round(
            now, time.time_ns(), self._edge.sightings(), self._views.now(now), settled=self._edge.settled(self._since)
        )
        decided = self._election.outcome
        if urgent or now >= self._due:
            self._due = now + PERIOD - _PAUSE
            self._edge.announce(record.encode())
            self._election.sent(record)
        self._next_by = now + (FENCE if len(decided.members) > 1 else ALONE)
        if decided.active:
            self.lease.extend(self._next_by)
        else:
            self.lease.end()
        outcome = self._with_routes_before_hang(decided)
        if outcome != self._outcome:
            self._log_change(outcome)
            self.changes += outcome.active != self._outcome.active
            self._outcome = outcome
            self._changed()

    def _with_routes_before_hang(self, decided: Outcome) -> Outcome:
        """Return the outcome for the engine, with which a lone worker keeps its routes after a hang.

        It keeps them until it sees another worker or is active again; the expired lease blocks the routes meanwhile.
        Users may have connected programs to the routes' endpoints by hand, as in YARP, and nothing would connect these
        programs to new endpoints.
        """
        if decided.active or len(decided.members) > 1:
            self._outcome_before_hang = None
        return (
            decided
            if self._outcome_before_hang is None
            else replace(self._outcome_before_hang, waiting=decided.waiting)
        )

    def _log_change(self, outcome: Outcome) -> None:
        before, now = self._outcome.standing_by, outcome.standing_by
        was_waiting = bool(self._outcome.waiting)
        if FOREIGN in outcome.waiting and outcome.waiting != self._outcome.waiting:
            _log.warning("%s: nothing is bridged: %s", self._edge.side, outcome.waiting)
        if now and now != before:
            _log.info("%s: on standby, %s is active on this network", self._edge.side, now)
        elif outcome.active and not now and not outcome.waiting and (before or was_waiting or not self._outcome.active):
            _log.info("%s: active on this network", self._edge.side)
