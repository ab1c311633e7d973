"""The log of the daemon and its workers."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

from bridge.client.errors import ClientError
from bridge.config.model import Config
from bridge.daemon.log_query import ask_log

LEVELS = ("debug", "info", "warning", "error")
MOST_LINES = 2000
MOST_RETURNED = 500
LOG_SECONDS = 0.5
"""Interval at which the feed ``log`` checks for new lines."""

_ROUNDS = 50  # maximum number of queries with which `ask` reads the new lines


class LogFollower:
    """Caches the daemon's log. `ask` is called by one thread, `read` by any."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._lock = threading.Lock()
        self._lines: deque[dict[str, Any]] = deque(maxlen=MOST_LINES)
        self._last = 0

    def ask(self) -> dict[str, Any]:
        """Read all new lines, and return the value of ``log``. Raises `ClientError` if no daemon answers."""
        for _ in range(_ROUNDS):
            reply = ask_log(self._config, self._last)
            if reply is None:
                raise ClientError("the daemon does not respond, so its log cannot be read")
            self._append(reply)
            if self._last >= reply["last"]:
                break
        with self._lock:
            return {"last": self._last, "workers": sorted({line["worker"] for line in self._lines})}

    def _append(self, reply: dict[str, Any]) -> None:
        with self._lock:
            if reply["last"] < self._last:  # a restarted daemon counts from the beginning
                self._last = 0
                self._lines.clear()
            elif reply["lines"]:
                self._lines.extend(reply["lines"])
                self._last = reply["lines"][-1]["n"]

    def read(self, after: int = 0, level: str = "debug", worker: str = "", text: str = "") -> dict[str, Any]:
        """Return the newest lines after a number that pass the filters; see the protocol."""
        levels, terms = LEVELS[LEVELS.index(level) :], text.lower().split()
        with self._lock:
            lines, last = list(self._lines), self._last
        matching = [
            line
            for line in lines
            if line["n"] > after
            and line["level"] in levels
            and worker in ("", line["worker"])
            and all(term in line["text"].lower() for term in terms)
        ]
        return {"last": last, "lines": matching[-MOST_RETURNED:]}
