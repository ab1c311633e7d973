"""Watches the other Midspan workers on the side's network, and takes part in the election among them."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from bridge.adapters.base import Edge
from bridge.hub.errors import HubError
from bridge.hub.session import Hub
from bridge.hub.settings import LEASE_MS
from bridge.routing.election import PERIOD, Election, HubView, Outcome, join
from bridge.routing.lease import Lease
from bridge.routing.processes import has_ended, process_name

_log = logging.getLogger(__name__)

FENCE = 0.7
"""Seconds after its last record for which a worker carries on: less than `bridge.routing.election.SILENCE`."""

ALONE = 1.5
"""The same where no other worker is on the network: one that comes meanwhile waits longer than that."""

_PAUSE = 0.02
_HUB_LINKED = 1.0
"""Seconds from the first link on the hub until all that is on the hub would be seen."""

_HUB_AGAIN = 2.5
"""The same for one whose links were given up while it stood still: not all come back at once (`bridge.hub.mesh`)."""

_LINKS_LAST = 0.75 * LEASE_MS / 1000
"""So long it may stand still before the hub's other sessions give its links up: the last keep-alive was sent before."""

_HUB_ALONE = 3.0
"""Seconds after which a session without any link counts as the only one on its hub."""


class Watch:
    """The thread that tells the others of this worker, hears them, and decides by `Election`.

    Attributes:
        lease: whether messages may cross at this moment.
    """

    def __init__(self, edge: Edge, hub: Hub, daemon: str, changed: Callable[[], None]) -> None:
        self._edge, self._hub, self._changed = edge, hub, changed
        self._election = Election(hub.zid, daemon, process_name(), lambda record: has_ended(record.process))
        self.lease = Lease()
        self._outcome = Outcome()
        self._started = self._since = self._turned = time.monotonic()
        self._linked: float | None = None
        self._settling = _HUB_LINKED
        self._due = 0.0
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"midspan-{edge.side}-watch", daemon=True)

    @property
    def outcome(self) -> Outcome:
        """What this worker may do now."""
        return self._outcome

    def start(self) -> None:
        """Start taking part; the edge has started."""
        self._started = self._since = self._turned = time.monotonic()
        self._thread.start()

    def wake(self) -> None:
        """Look again soon. May be called from any thread."""
        self._wake.set()

    def stop(self) -> None:
        """Tell the others that this worker carries nothing any more; its routes are closed by now."""
        self.lease.end()
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
            self._edge.announce(self._election.leave().encode())

    def stuck_for(self) -> float:
        """Seconds since the last turn."""
        return time.monotonic() - self._turned

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._turn()
            except HubError:
                return
            except Exception:
                _log.exception("%s: watching the other workers failed", self._edge.side)
            self._wake.wait(PERIOD)
            self._wake.clear()
            self._stopping.wait(_PAUSE)

    def _turn(self) -> None:
        now = time.monotonic()
        if self._outcome.active and self.lease.over:
            still = now - self._turned
            _log.warning("%s: stood still for %.1f s; looking who is active now", self._edge.side, still)
            self._election.lapse(now)
            self._since = now
            if still > _LINKS_LAST:
                self._started, self._linked, self._settling = now, None, _HUB_AGAIN
        self._turned = now
        record, urgent = self._election.turn(
            now, time.time_ns(), self._edge.sightings(), self._view(now), settled=self._edge.settled(self._since)
        )
        outcome = self._election.outcome
        if urgent or now >= self._due:
            self._due = now + PERIOD - _PAUSE
            self._edge.announce(record.encode())
            self._election.told(record)
        if outcome.active:
            self.lease.extend(now + (FENCE if len(outcome.members) > 1 else ALONE))
        else:
            self.lease.end()
        if outcome != self._outcome:
            self._tell(outcome)
            self._outcome = outcome
            self._changed()

    def _view(self, now: float) -> HubView:
        graph = self._hub.graph
        if self._linked is None and self._hub.linked():
            self._linked = now
        since = self._started + _HUB_ALONE if self._linked is None else self._linked + self._settling
        members = graph.members()
        # One that carries without telling who is on its network, such as a worker of another make, is a network alone.
        crew = frozenset(graph.origins())
        silent = crew - members.keys()
        if silent:
            silent &= {e.zid for e in graph.publishers()}
        networks = join(members | dict.fromkeys(silent, frozenset()))
        return HubView(crew | {self._hub.zid}, networks, settled=now > since)

    def _tell(self, outcome: Outcome) -> None:
        before, now = self._outcome.standing_by, outcome.standing_by
        if now and now != before:
            _log.info("%s: standing by, %s is active on this network", self._edge.side, now)
        elif outcome.active and not now and (before or not self._outcome.active):
            _log.info("%s: active on this network", self._edge.side)
