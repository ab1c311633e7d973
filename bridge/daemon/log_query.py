"""The newest log lines of the daemon and its workers, for requests to the daemon."""

from __future__ import annotations

import json
import logging
from collections import deque
from typing import Any

from typing_extensions import override

from bridge.config.model import Config
from bridge.daemon.query import request

LOG = "log"
OWN = "daemon"
"""The ``worker`` of the daemon's own lines."""

_LEVELS = ((logging.ERROR, "error"), (logging.WARNING, "warning"), (logging.INFO, "info"))
_LONGEST = 8 << 10


class RecentLines(logging.Handler):
    """Stores the newest lines with consecutive numbers, up to a number of lines and of bytes."""

    def __init__(self, most: int = 2000, most_bytes: int = 512 << 10) -> None:
        super().__init__()
        self._most, self._most_bytes = most, most_bytes
        self._lines: deque[dict[str, Any]] = deque()
        self._bytes = 0
        self._n = 0

    @override
    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if record.exc_info:
            text += "\n" + logging.Formatter().formatException(record.exc_info)
        level = next((name for least, name in _LEVELS if record.levelno >= least), "debug")
        for whole in text.split("\n"):
            self._n += 1
            line = whole[:_LONGEST]
            about = {"n": self._n, "time": round(record.created, 3), "level": level}
            self._lines.append({**about, "worker": getattr(record, "worker", OWN), "text": line})
            self._bytes += len(line)
        while len(self._lines) > self._most or (self._bytes > self._most_bytes and len(self._lines) > 1):
            self._bytes -= len(self._lines.popleft()["text"])

    def respond(self, request: dict[str, Any]) -> dict[str, Any]:
        """Respond to a request, whose ``after`` is the number of a line."""
        return self.after(int(request["after"]))

    def after(self, n: int, most_bytes: int = 64 << 10) -> dict[str, Any]:
        """Return ``last``, the number of the newest line, and ``lines``: as many lines after line ``n`` as fit."""
        self.acquire()
        try:
            last, recent = self._n, [line for line in self._lines if line["n"] > n]
        finally:
            self.release()
        room, lines = most_bytes, list[dict[str, Any]]()
        for line in recent:
            room -= len(json.dumps(line)) + 2
            if room < 0 and lines:
                break
            lines.append(line)
        return {"last": last, "lines": lines}


def ask_log(config: Config, after: int, seconds: float = 1.0) -> dict[str, Any] | None:
    """Return the newest log lines of this configuration's daemon, None if it is not running.

    Returns:
        ``last``: the number of the newest line; less than ``after`` only if the daemon was restarted. ``lines``: those
        after the line ``after``, oldest first, as many as fit, each with ``n``, ``time`` (s since 1970), ``level``
        (``error``, ``warning``, ``info``, ``debug``), ``worker`` (`OWN`: the daemon itself) and ``text``.
    """
    document = request(config, LOG, seconds, after=after)
    return document if document is not None and "lines" in document else None
