"""The data that metrics are made of: the status documents of this daemon's workers, and the daemon's own.

Each daemon reports only its own parts, so that scraping several joined daemons yields nothing twice.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from bridge.config.model import Config
from bridge.daemon.query import Phase, ask_daemon
from bridge.hub.control import WorkerAnswer
from bridge.hub.errors import HubError

Document = Mapping[str, Any]

ASK_SECONDS = 1.0
"""A worker that has not answered by then is reported as not answering."""

FRESH_SECONDS = 1.0
"""Snapshots are cached this long: each worker is queried at most once a second, however many clients scrape."""

AT_REST = frozenset({Phase.OFF.value, Phase.UNAVAILABLE.value})
"""Phases of a worker that is not supposed to run here."""

_DAEMON_SECONDS = 0.5

READY_SECONDS = 0.5
"""How long readiness is cached; it needs only the daemon's answer."""

Ask = Callable[[], list[WorkerAnswer]]
"""Queries all workers of this daemon for their status documents, for `ASK_SECONDS`; raises `HubError` without a hub."""


@dataclass(frozen=True)
class Snapshot:
    """The known state at one moment.

    Attributes:
        name: the daemon's name.
            documents: of the workers and modules that answered.
            daemon: the daemon's own document; empty if it does not answer.
            hub: whether the hub could be queried.
            seconds: duration of the query.
    """

    name: str
    documents: tuple[Document, ...]
    daemon: Document
    hub: bool
    seconds: float

    @property
    def workers(self) -> list[Document]:
        """The daemon's status of each worker that is supposed to run."""
        return [worker for worker in self.daemon.get("workers", ()) if worker["phase"] not in AT_REST]


class Source:
    """Queries at most once per `FRESH_SECONDS`. Safe to use from any thread; concurrent callers share an answer."""

    def __init__(self, config: Config, ask: Ask) -> None:
        self._config, self._ask = config, ask
        self._lock = threading.Lock()
        self._snapshot: Snapshot | None = None
        self._until = 0.0

    def snapshot(self) -> Snapshot:
        """Return the current state, at most `FRESH_SECONDS` old."""
        with self._lock:
            if self._snapshot is None or time.monotonic() >= self._until:
                self._snapshot = self._query()
                self._until = time.monotonic() + FRESH_SECONDS
            return self._snapshot

    def _query(self) -> Snapshot:
        began = time.monotonic()
        try:
            answers, hub = self._ask(), True
        except HubError:
            answers, hub = [], False
        documents = tuple(
            {**answer.value, "worker": answer.worker}
            for answer in answers
            if isinstance(answer.value, dict) and not answer.error and answer.daemon == self._config.name
        )
        daemon = ask_daemon(self._config, _DAEMON_SECONDS) or {}
        return Snapshot(self._config.name, documents, daemon, hub, time.monotonic() - began)


class Readiness:
    """Whether the daemon's workers are up, according to the daemon."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._lock = threading.Lock()
        self._reasons: list[str] = []
        self._until = 0.0

    def reasons(self) -> list[str]:
        """Return why it is not ready, one reason for each worker; empty if it is ready."""
        with self._lock:
            if time.monotonic() >= self._until:
                self._reasons = _reasons(ask_daemon(self._config, _DAEMON_SECONDS), self._config.name)
                self._until = time.monotonic() + READY_SECONDS
            return self._reasons


def _reasons(daemon_status: Document | None, name: str) -> list[str]:
    if daemon_status is None:
        return [f"no daemon named '{name}' answers"]
    ready = {*AT_REST, Phase.UP.value}
    return [
        f"{worker['worker']}: {worker['phase']}" + (f": {worker['text']}" if worker["text"] else "")
        for worker in daemon_status.get("workers", ())
        if worker["phase"] not in ready
    ]
