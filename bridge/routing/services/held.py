"""Calls that arrive while the worker lacks the lease: they wait a few seconds for it, in their order.

A worker that was starved or suspended for more than a second loses its lease until it has checked whether another
worker is active. Its clients cannot see that, and would have to repeat their calls.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Lock
from typing import NamedTuple

from bridge.concurrency import DelayedCalls
from bridge.routing.limits import QUEUE_BYTES
from bridge.routing.peer_watch import Lease

HOLD_SECONDS = 5.0
"""Maximum seconds for which a call waits. A lone worker has its lease again after 0.1 to 3 s."""

LATE_SECONDS = 15.0
"""Seconds without the lease after which calls are refused at once, because they may have waited in sockets for so long.
No client expects a goal that it sent before a laptop was closed to begin when the laptop is opened."""

MOST_HELD = 1000


class _Held(NamedTuple):
    since: float
    size: int
    begin: Callable[[], None]
    refuse: Callable[[], None]


class HeldCalls:
    """The calls of all services of one side that wait for the lease. Safe to use from any thread.

    One queue for all services keeps the order of a goal and of the request that cancels it.
    """

    def __init__(self, side: str, lease: Lease) -> None:
        self._lease = lease
        self._lock = Lock()
        self._held: dict[object, _Held] = {}
        self._bytes = 0
        self._later = DelayedCalls(f"midspan-{side}-held")
        lease.extended = self._on_lease

    def admit(self, call: object, size: int, begin: Callable[[], None], refuse: Callable[[], None]) -> None:
        """Begin a call; without the lease, or after other waiting calls, hold it and begin or refuse it later."""
        if not self._held and not self._lease.over:
            begin()
        elif self._hold(call, _Held(time.monotonic(), size, begin, refuse)):
            self._later.after(HOLD_SECONDS, self._check, once=True)
        else:
            refuse()

    def _hold(self, call: object, held: _Held) -> bool:
        with self._lock:
            late = held.since - self._lease.until > LATE_SECONDS
            if late or len(self._held) >= MOST_HELD or (self._held and self._bytes + held.size > QUEUE_BYTES):
                return False
            self._held[call] = held
            self._bytes += held.size
            return True

    def drop(self, call: object) -> None:
        """Forget a call that has ended, for example because its client left."""
        if self._held:
            with self._lock:
                held = self._held.pop(call, None)
                self._bytes -= held.size if held is not None else 0

    def close(self) -> None:
        """End the thread; the routes end their calls."""
        self._later.close(1.0)

    def _on_lease(self) -> None:
        if self._held:
            self._later.after(0.0, self._begin_all, once=True)

    def _begin_all(self) -> None:
        """Begin the calls in order. Each stays listed until then, so that no newer call overtakes it."""
        while not self._lease.over:
            call, held = self._first()
            if held is None:
                return
            try:
                held.begin()
            finally:
                self.drop(call)

    def _check(self) -> None:
        """Refuse the calls that have waited for too long."""
        self._begin_all()
        while True:
            call, held = self._first()
            if held is None:
                return
            left = held.since + HOLD_SECONDS - time.monotonic()
            if left > 0:
                self._later.after(left, self._check, once=True)
                return
            self.drop(call)
            held.refuse()

    def _first(self) -> tuple[object, _Held | None]:
        with self._lock:
            return next(iter(self._held.items()), (None, None))
