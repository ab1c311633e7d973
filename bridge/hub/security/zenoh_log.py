"""Reads zenoh's log in a worker's process: its warnings and errors, and why connections fail.

zenoh (1.10) writes its log only to standard output. So a worker's process, which has no other use for its standard
output, replaces it by a pipe and reads that. Warnings go into the worker's log, at a limited rate. `zenoh_link_tls`
logs each connection that its listener refuses (without the other machine's address), and the orchestrator logs each
failed attempt to connect; `bridge.hub.security.endpoints` reports these. If the user sets ``RUST_LOG``, it replaces the
filter, and every line is passed on to stderr.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass

import zenoh

from bridge.hub.errors import zenoh_reason

_log = logging.getLogger(__name__)

_FAILURES = "zenoh::net::runtime::orchestrator"
_PER_MESSAGE = "zenoh::net::routing::dispatcher::pubsub"
"""Logs an error for each message of a machine whose clock is 0.5 s fast; `midspan doctor` compares the clocks."""

_FILTER = f"warn,{_FAILURES}=debug,{_PER_MESSAGE}=off"
_HARMLESS = (
    "Scouting delay elapsed before start conditions are met",  # sessions open without waiting for their router
    "Unable to connect to any of ",  # opening the session fails with this text, and the worker reports it
    # a reply to a query that was canceled, or whose time is over
    "Received ReplyData for unknown Query",
    "Received ResponseFinal for unknown Request",
    "reply: Query not found!",
)
"""Warnings and errors that are not logged."""
_ZENOH = re.compile(r"\d{4}-\d\d-\d\dT\S+ +(?:ERROR|WARN|INFO|DEBUG|TRACE) ")
_WARNING = re.compile(r"\S+ +(ERROR|WARN) +(?:\S+ )?ThreadId\(\d+\) (.*)")
_VARIABLE = re.compile(r"[0-9a-f]{8,}|\d+")
_COLORS = re.compile(r"\x1b\[[0-9;]*m")
_REFUSED = re.compile(
    r"WARN .*?(zenoh_link_(?:tls|quic|commons)\S*): (?:QUIC acceptor failed: )?(.*?)(?:\. Hint: .*)?$"
)
_FAILED = re.compile(r"DEBUG .*? Unable to connect to configured peer (\S+)! (.*?)(?:\.? Retry in \S+)?$")
_LONGEST = 64 << 10
_MOST_REFUSALS = 100
_MOST_ENDPOINTS = 100

AGAIN_SECONDS = 60.0
"""Seconds until a warning that differs only in numbers is logged again."""

_MOST_WARNINGS = 20
"""Maximum number of different warnings that are logged in `AGAIN_SECONDS`; further warnings are only counted."""

_LONGEST_WARNING = 500


@dataclass(frozen=True, slots=True)
class LoggedRefusal:
    """A connection that a listener refused; ``at`` is on the monotonic clock, ``protocol`` is ``tls`` or ``quic``."""

    at: float
    protocol: str
    error: str


class ZenohWarnings:
    """Passes zenoh's warnings and errors on to this process's log, each kind once a minute."""

    def __init__(self) -> None:
        self.harmless: tuple[str, ...] = _HARMLESS
        self._begin = float("-inf")
        self._counts: dict[str, int] = {}
        self._left_out = 0

    def feed(self, line: str, now: float) -> None:
        """Log one line of zenoh's log, or count it; lines of lower levels are ignored."""
        match = _WARNING.match(line)
        if match is None or any(text in line for text in self.harmless):
            return
        if now >= self._begin + AGAIN_SECONDS:
            self._begin_minute(now)
        text = zenoh_reason(Exception(match[2]))[:_LONGEST_WARNING]
        kind = _VARIABLE.sub("#", text)
        if kind in self._counts:
            self._counts[kind] += 1
        elif len(self._counts) < _MOST_WARNINGS:
            self._counts[kind] = 0
            _log.log(logging.ERROR if match[1] == "ERROR" else logging.WARNING, "zenoh: %s", text)
        else:
            self._left_out += 1

    def _begin_minute(self, now: float) -> None:
        repeated = sum(self._counts.values()) + self._left_out
        if repeated:
            _log.warning("zenoh: %d warnings like those before were not logged", repeated)
        self._begin, self._counts, self._left_out = now, {}, 0


class ZenohLog:
    """Collects the failed connections in zenoh's log, and passes on its warnings.

    Attributes:
        reports_refusals: whether a program reads `refusals`; otherwise refusals are logged like other warnings.
    """

    reports_refusals = False

    def __init__(self) -> None:
        self._warnings = ZenohWarnings()
        self._passes_on = bool(os.environ.get("RUST_LOG"))
        self._lock = threading.Lock()
        self._refusals: deque[LoggedRefusal] = deque(maxlen=_MOST_REFUSALS)
        self._failures: dict[str, tuple[float, str]] = {}

    @classmethod
    def capture(cls) -> ZenohLog:
        """Redirect this process's standard output; call it before the first session is opened.

        A second call replaces the first.
        """
        global _captured
        log = _captured = cls()
        if sys.platform == "win32":  # pipes on Windows cannot be written without blocking
            return log
        output, to_log = os.pipe()
        os.set_blocking(to_log, False)  # a full pipe must not block zenoh's acceptor, which drops the line instead
        os.dup2(to_log, 1)
        os.close(to_log)
        threading.Thread(target=log._run, args=(output,), name="hub-zenoh-log", daemon=True).start()
        zenoh.init_log_from_env_or(_FILTER)
        return log

    @staticmethod
    def release() -> None:
        """Redirect standard output to stderr, which ends the thread."""
        os.dup2(2, 1)

    def ignore(self, text: str) -> None:
        """Log no further warnings that contain a text."""
        self._warnings.harmless += (text,)

    def feed(self, line: str) -> None:
        """Add one line of the log, without colors."""
        refused = _REFUSED.search(line)
        if not self._passes_on and (refused is None or not self.reports_refusals):
            self._warnings.feed(line, time.monotonic())
        if refused is not None:
            protocol = "tls" if refused[1].startswith("zenoh_link_tls") else "quic"
            with self._lock:
                self._refusals.append(LoggedRefusal(time.monotonic(), protocol, zenoh_reason(Exception(refused[2]))))
        elif match := _FAILED.search(line):
            with self._lock:
                if match[1] in self._failures or len(self._failures) < _MOST_ENDPOINTS:
                    self._failures[match[1]] = (time.monotonic(), zenoh_reason(Exception(match[2])).strip(". "))

    def refusals(self, since: float) -> list[LoggedRefusal]:
        """Return the refusals after a time on the monotonic clock, oldest first."""
        with self._lock:
            return [refusal for refusal in self._refusals if refusal.at > since]

    def failure(self, endpoint: str, since: float) -> str:
        """Return zenoh's reason for failing to connect to an endpoint after a time (monotonic), or ""."""
        with self._lock:
            at, reason = self._failures.get(endpoint, (float("-inf"), ""))
        return reason if at > since else ""

    def _run(self, output: int) -> None:
        with os.fdopen(output, "rb") as lines:
            while line := lines.readline(_LONGEST):
                text = _COLORS.sub("", line.decode(errors="replace")).strip()
                if self._passes_on or not _ZENOH.match(text):
                    with contextlib.suppress(OSError):  # stderr is full, or its reader has exited
                        os.write(2, line)
                self.feed(text)


_captured: ZenohLog | None = None


def captured() -> ZenohLog | None:
    """Return the log that this process captures, None if it captures none (commands do not)."""
    return _captured
