"""Makes the persistent connections of a name server, a few at a time, and tries again what did not work at once."""

from __future__ import annotations

import heapq
import logging
import threading
import time

from yarp_compat.naming import connections
from yarp_compat.naming.errors import NamingError
from yarp_compat.naming.naming import Naming
from yarp_compat.naming.subscriptions import Wish

_log = logging.getLogger("yarp.names")

WORKERS = 4
MAX_WAITING = 10_000
TIMEOUT = 3.0
"""Seconds for each step of making a connection."""
PAUSES = (0.0, 0.5, 2.0, 8.0)
"""Seconds before each try. A port that is gone by then is not tried again: it announces itself when it returns."""


class Connector:
    """Makes connections between other programs' ports.

    Args:
        naming: who knows the ports.
    """

    def __init__(self, naming: Naming) -> None:
        self._naming = naming
        self._changed = threading.Condition()
        self._due: list[tuple[float, int, Wish, int]] = []
        self._waiting: set[Wish] = set()
        self._order = 0
        self._idle = 0
        self._closed = False
        self._threads: list[threading.Thread] = []

    def want(self, wish: Wish) -> None:
        """Have a connection made, unless it is there; returns at once."""
        with self._changed:
            if self._closed or wish in self._waiting or len(self._waiting) >= MAX_WAITING:
                return
            self._waiting.add(wish)
            self._put(wish, 0)
            if len(self._due) > self._idle and len(self._threads) < WORKERS:
                name = f"yarp connector {len(self._threads)}"
                thread = threading.Thread(target=self._run, name=name, daemon=True)
                self._threads.append(thread)
                thread.start()

    def close(self) -> None:
        """Make no more connections; returns when the one in work is given up."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _put(self, wish: Wish, attempt: int) -> None:
        self._order += 1
        heapq.heappush(self._due, (time.monotonic() + PAUSES[attempt], self._order, wish, attempt))
        self._changed.notify()

    def _run(self) -> None:
        while (taken := self._take()) is not None:
            wish, attempt = taken
            error = self._make(wish)
            last = error is None or attempt + 1 >= len(PAUSES)
            if error is not None:
                _log.log(
                    logging.WARNING if last else logging.DEBUG,
                    "persistent connection from %s to %s not made: %s", wish.source, wish.target, error,
                )  # fmt: skip
            with self._changed:
                if last or self._closed:
                    self._waiting.discard(wish)
                else:
                    self._put(wish, attempt + 1)

    def _take(self) -> tuple[Wish, int] | None:
        with self._changed:
            self._idle += 1
            try:
                while not self._closed:
                    left = self._due[0][0] - time.monotonic() if self._due else None
                    if left is not None and left <= 0:
                        _, _, wish, attempt = heapq.heappop(self._due)
                        return wish, attempt
                    self._changed.wait(left)
                return None
            finally:
                self._idle -= 1

    def _make(self, wish: Wish) -> NamingError | None:
        try:
            if wish.anew or not connections.is_connected(self._naming, wish.source, wish.target, timeout=TIMEOUT):
                connections.connect(self._naming, wish.source, wish.target, timeout=TIMEOUT)
                _log.info("persistent connection from %s to %s made", wish.source, wish.target)
        except NamingError as err:
            return err
        return None
