"""One thing after the other, on whatever thread is there: for state that many threads' events change."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable

_log = logging.getLogger(__name__)


class Turns:
    """Runs jobs in the order they came, one at a time.

    Whoever brings a job while none runs, runs it, and those that come meanwhile. So a job that brings another one, by
    a callback that answers at once for example, sees it run after itself, and nobody holds a lock while it calls.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jobs: deque[Callable[[], None]] = deque()
        self._running = False

    def take(self, job: Callable[[], None]) -> None:
        """Run a job now or, where another one runs, right after it."""
        with self._lock:
            self._jobs.append(job)
            if self._running:
                return
            self._running = True
        while True:
            with self._lock:
                if not self._jobs:
                    self._running = False
                    return
                job = self._jobs.popleft()
            try:
                job()
            except Exception:
                _log.exception("an event of an action failed in an unforeseen way")
