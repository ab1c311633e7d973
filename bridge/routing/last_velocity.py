"""Zero after the last velocity of a publisher whose velocities a route no longer passes on."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Container, Hashable
from threading import Lock
from typing import NamedTuple

from bridge.messages.velocities import is_zero, stop_after

_log = logging.getLogger(__name__)

Send = Callable[[bytes, int], int | None]
"""Publishes a velocity (CDR) that is later by so many nanoseconds than the one for which the call was made."""


class _Last(NamedTuple):
    source: Hashable
    cdr: bytes
    send: Send
    since: int  # monotonic ns


class LastVelocity:
    """Publishes a route's velocities, and zero if Midspan itself interrupts them.

    A base continues at its last velocity until its own time-out. That is correct if the publisher leaves or falls
    silent, as on its own network, but not if a rule denies its topic, commands displace it, or the worker stops.
    Thread-safe.
    """

    def __init__(self, type_name: str) -> None:
        self._type_name = type_name
        self._lock = Lock()
        self._last: _Last | None = None
        self._ended = False

    def publish(self, source: Hashable, cdr: bytes, send: Send) -> int | None:
        """Publish a velocity by ``send``, and return its result; None after the end."""
        with self._lock:
            if self._ended:
                return None
            size = send(cdr, 0)
            self._last = None if is_zero(cdr) else _Last(source, cdr, send, time.monotonic_ns())
            return size

    def stop(self, interrupted: Container[Hashable], *, end: bool = False) -> None:
        """Publish zero if the last velocity was another one, of a publisher that is interrupted.

        ``end``: publish no velocity after that.
        """
        with self._lock:
            self._ended = self._ended or end
            last = self._last
            if last is None or last.source not in interrupted:
                return
            self._last = None
            try:
                last.send(stop_after(self._type_name, last.cdr), time.monotonic_ns() - last.since)
            except Exception:  # the route has to be updated or closed nevertheless
                _log.exception("zero velocity could not be published")
