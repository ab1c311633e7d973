"""Sensor data that waits for its sensor's pose, which usually arrives a little later."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from logging import Logger
from typing import Generic, TypeVar

from bridge.clock import RunClock
from navigation.frames import FramesError

PATIENCE_NS = 1_000_000_000

T = TypeVar("T")


@dataclass
class _Entry(Generic[T]):
    item: T
    received_ns: int
    reason: str = "messages arrive faster than they can be used"


class SensorQueue(Generic[T]):
    """Passes data on in order of arrival, each item as soon as its pose is known. Not thread-safe.

    An item is dropped after a second, or when ``limit`` newer ones wait.

    Args:
        use: called with an item; raises `FramesError` while it has to wait, `ValueError` if it is invalid.
        limit: maximum number of waiting items.
        what: the item's name in log lines.
        clock: the run's clock.

    Attributes:
        received_ns: when the last item arrived; None before the first, and after a jump of the clock.
        dropped: number of dropped items.
        trouble: why the last item was dropped, "" if one has been used since.
    """

    def __init__(self, use: Callable[[T], None], *, limit: int, what: str, clock: RunClock, log: Logger) -> None:
        self._use, self._limit, self._what, self._clock, self._log = use, limit, what, clock, log
        self._waiting: deque[_Entry[T]] = deque()
        self.received_ns: int | None = None
        self.dropped, self.trouble = 0, ""

    def add(self, item: T) -> None:
        """Add an item; use it at once if its pose is known."""
        self.received_ns = now = self._clock.now_ns()
        if len(self._waiting) == self._limit:
            self.drop(self._waiting.popleft().reason)
        self._waiting.append(_Entry(item, now))
        self.work()

    def work(self) -> None:
        """Use the items whose poses are known, and drop those that waited too long."""
        now, waiting, self._waiting = self._clock.now_ns(), self._waiting, deque()
        for entry in waiting:
            try:
                self._use(entry.item)
            except FramesError as err:
                entry.reason = str(err)
                if 0 <= now - entry.received_ns < PATIENCE_NS:
                    self._waiting.append(entry)
                else:
                    self.drop(entry.reason)
            except ValueError as err:
                self.drop(str(err))
            else:
                self.trouble = ""

    def drop(self, reason: str) -> None:
        """Count an item that cannot be used, and log a new reason."""
        self.dropped += 1
        if reason != self.trouble:
            self._log.warning("dropped a %s: %s", self._what, reason)
        self.trouble = reason

    def clear(self) -> None:
        """Discard waiting items, after the clock jumped."""
        self._waiting.clear()
        self.received_ns = None
