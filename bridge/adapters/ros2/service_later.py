"""One thread for what services have to do later: time that is over, replies that must wait a moment."""

from __future__ import annotations

import heapq
import itertools
import logging
import threading
import time
from collections.abc import Callable

_log = logging.getLogger(__name__)


class Later:
    """Does errands when they are due, one after the other; its thread is made for the first."""

    def __init__(self) -> None:
        self._turn = threading.Condition()
        self._errands: list[tuple[float, int, Callable[[], object]]] = []
        self._numbers = itertools.count()
        self._thread: threading.Thread | None = None
        self._stopping = False

    def after(self, seconds: float, errand: Callable[[], object]) -> None:
        """Have it done after so many seconds; never after `stop`."""
        with self._turn:
            if self._stopping:
                return
            heapq.heappush(self._errands, (time.monotonic() + seconds, next(self._numbers), errand))
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="midspan-ros2-later", daemon=True)
                self._thread.start()
            self._turn.notify()

    def stop(self) -> None:
        """End the thread; what is not due by now is not done."""
        with self._turn:
            self._stopping = True
            self._errands.clear()
            self._turn.notify()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        while (errand := self._next()) is not None:
            try:
                errand()
            except Exception:
                _log.exception("a service's errand failed")

    def _next(self) -> Callable[[], object] | None:
        with self._turn:
            while not self._stopping:
                left = self._errands[0][0] - time.monotonic() if self._errands else None
                if left is not None and left <= 0:
                    return heapq.heappop(self._errands)[2]
                self._turn.wait(left)
            return None
