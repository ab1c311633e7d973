"""A stream of which only the newest matters, on its way to a module's thread."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

from bridge.modules.loop import Loop

T = TypeVar("T")


class Newest(Generic[T]):
    """Gives a module's thread the newest value; while it is busy one waits, and not all that came.

    Args:
        loop: the module's.
        take: called with it there.
    """

    def __init__(self, loop: Loop, take: Callable[[T], object]) -> None:
        self._loop, self._take = loop, take
        self._lock = Lock()
        self._waiting: list[T] = []

    def put(self, value: T) -> None:
        """Another one came, on any thread."""
        with self._lock:
            posted, self._waiting = bool(self._waiting), [value]
        if not posted:
            self._loop.post(self._run)

    def _run(self) -> None:
        with self._lock:
            (value,), self._waiting = self._waiting, []
        self._take(value)
