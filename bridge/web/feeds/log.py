"""The log of the daemon and its workers: a feed tells that there is more, a verb reads what a page wants of it."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

from bridge.cli.output import CliError
from bridge.concurrency import SerialExecutor
from bridge.config.model import Config
from bridge.daemon.log_query import ask_log
from bridge.modules.host import Host
from bridge.web.feeds.hub import AskingFeed
from bridge.web.verbs.verbs import PageVerb

LEVELS = ("debug", "info", "warning", "error")
MOST_LINES = 2000
MOST_TOLD = 500
LOG_SECONDS = 0.5
_MOST_WORDS = 200
_ROUNDS = 50


class LogFollower:
    """Keeps what the daemon says of its log. `ask` is called by one thread, `read` by any."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._lock = threading.Lock()
        self._lines: deque[dict[str, Any]] = deque(maxlen=MOST_LINES)
        self._last = 0

    def ask(self) -> dict[str, Any]:
        """The value of ``log``; reads all that is new. Raises `CliError` where no daemon answers."""
        for _ in range(_ROUNDS):
            said = ask_log(self._config, self._last)
            if said is None:
                raise CliError("the daemon does not answer: this console runs without it, and has no log to show")
            self._take(said)
            if self._last >= said["last"]:
                break
        with self._lock:
            return {"last": self._last, "workers": sorted({line["worker"] for line in self._lines})}

    def _take(self, said: dict[str, Any]) -> None:
        with self._lock:
            if said["last"] < self._last:  # another daemon, which counts from its own beginning
                self._last = 0
                self._lines.clear()
            elif said["lines"]:
                self._lines.extend(said["lines"])
                self._last = said["lines"][-1]["n"]

    def read(self, after: int = 0, level: str = "debug", worker: str = "", text: str = "") -> dict[str, Any]:
        """The newest lines behind a number that pass the filters; see the protocol."""
        kept, words = LEVELS[LEVELS.index(level) :], text.lower().split()
        with self._lock:
            lines, last = list(self._lines), self._last
        found = [
            line
            for line in lines
            if line["n"] > after
            and line["level"] in kept
            and worker in ("", line["worker"])
            and all(word in line["text"].lower() for word in words)
        ]
        return {"last": last, "lines": found[-MOST_TOLD:]}


def log_feed(host: Host, executor: SerialExecutor, follower: LogFollower) -> AskingFeed:
    """``log``: which line is the newest, and whose lines there are."""
    return AskingFeed(host, "log", executor, follower.ask, LOG_SECONDS)


def _number(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
        raise ValueError("is the number of a line")
    return value


def _level(value: Any) -> str:
    if value not in LEVELS:
        raise ValueError(f"is one of {', '.join(LEVELS)}")
    return str(value)


def _words(value: Any) -> str:
    if not isinstance(value, str) or len(value) > _MOST_WORDS:
        raise ValueError(f"is a text of up to {_MOST_WORDS} characters")
    return value


def log_verb(follower: LogFollower) -> PageVerb:
    """``log``: the lines that a page wants."""
    may = {"after": _number, "level": _level, "worker": _words, "text": _words}
    return PageVerb(follower.read, {}, may, commands=False)
