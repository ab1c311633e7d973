"""Warnings caused by clients, limited in rate."""

from __future__ import annotations

import logging
import threading
import time

_LINES, _LINES_SECONDS = 20, 10.0


class ScarceLog:
    """Logs up to 20 lines in ten seconds, and counts the others. Safe to use from any thread."""

    def __init__(self, name: str = "midspan.web") -> None:
        self._log = logging.getLogger(name)
        self._lock = threading.Lock()
        self._begun, self._count = 0.0, 0

    def warn(self, text: str) -> None:
        """Log a line, or count it."""
        now, left_out = time.monotonic(), 0
        with self._lock:
            if now - self._begun > _LINES_SECONDS:
                left_out = max(self._count - _LINES, 0)
                self._begun, self._count = now, 0
            self._count += 1
            logged = self._count <= _LINES
        if left_out:
            self._log.warning("%d further warnings were suppressed", left_out)
        if logged:
            self._log.warning("%s", text)
