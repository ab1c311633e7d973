"""Reads zenoh's log in the router's process, the only source for the reason why a listener refused a connection.

zenoh (1.10) writes its log only to standard output. So the router's process, which has no other use for its standard
output, replaces it by a pipe and reads that. `zenoh_link_tls` logs each connection that its listener refuses (without
the other machine's address), and the orchestrator logs each failed attempt to connect. If the user sets ``RUST_LOG``,
it replaces the filter, and every line is passed on to stderr.
"""

from __future__ import annotations

import os
import re
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass

import zenoh

from bridge.hub.errors import zenoh_reason

_FILTER = "off,zenoh_link_tls=warn,zenoh_link_commons=warn,zenoh::net::runtime::orchestrator=debug"
_ZENOH = re.compile(r"\d{4}-\d\d-\d\dT\S+ +(?:ERROR|WARN|INFO|DEBUG|TRACE) ")
_COLORS = re.compile(r"\x1b\[[0-9;]*m")
_REFUSED = re.compile(
    r"WARN .*?(zenoh_link_(?:tls|quic|commons)\S*): (?:QUIC acceptor failed: )?(.*?)(?:\. Hint: .*)?$"
)
_FAILED = re.compile(r"DEBUG .*? Unable to connect to configured peer (\S+)! (.*?)(?:\.? Retry in \S+)?$")
_LONGEST = 64 << 10
_MOST_REFUSALS = 100
_MOST_ENDPOINTS = 100


@dataclass(frozen=True, slots=True)
class LoggedRefusal:
    """A connection that a listener refused; ``at`` is on the monotonic clock, ``protocol`` is ``tls`` or ``quic``."""

    at: float
    protocol: str
    error: str


class ZenohLog:
    """Collects the failed connections in zenoh's log."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._refusals: deque[LoggedRefusal] = deque(maxlen=_MOST_REFUSALS)
        self._failures: dict[str, tuple[float, str]] = {}

    @classmethod
    def capture(cls) -> ZenohLog:
        """Redirect this process's standard output; call it before the first session is opened.

        A second call replaces the first.
        """
        log = cls()
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

    def feed(self, line: str) -> None:
        """Add one line of the log, without colors."""
        if match := _REFUSED.search(line):
            protocol = "tls" if match[1].startswith("zenoh_link_tls") else "quic"
            with self._lock:
                self._refusals.append(LoggedRefusal(time.monotonic(), protocol, zenoh_reason(Exception(match[2]))))
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
        pass_on = bool(os.environ.get("RUST_LOG"))
        with os.fdopen(output, "rb") as lines:
            while line := lines.readline(_LONGEST):
                text = _COLORS.sub("", line.decode(errors="replace")).strip()
                self.feed(text)
                if pass_on or not _ZENOH.match(text):
                    os.write(2, line)
