"""The source of the metrics: the status documents of this daemon's workers, and the daemon's own.

Each daemon reports only its own parts, so scraping several joined daemons yields nothing twice.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from bridge.config.model import Config
from bridge.daemon.query import Phase, ask_daemon
from bridge.hub.control import WorkerAnswer
from bridge.hub.errors import HubError
from bridge.status import INVALID, DaemonStatus, StatusDocument, WorkerReport, read_status

_log = logging.getLogger("midspan.metrics")

ASK_SECONDS = 1.0
"""A worker that has not answered within this time is reported as not answering."""

FRESH_SECONDS = 1.0
"""Snapshots are cached this long, so each worker is queried at most once a second, however many clients scrape."""

AT_REST = frozenset({Phase.OFF.value, Phase.UNAVAILABLE.value})
"""Phases of a worker that is not supposed to run here."""

_DAEMON_SECONDS = 0.5

READY_SECONDS = 0.5
"""How long readiness is cached; only the daemon is queried for it."""

Ask = Callable[[], list[WorkerAnswer]]
"""Queries all workers of this daemon for their status documents, for `ASK_SECONDS`; raises `HubError` without a hub."""


@dataclass(frozen=True)
class Snapshot:
    """The known state at one moment.

    Attributes:
        name: the daemon's name.
        documents: the status documents of the workers and modules that answered.
        daemon: the daemon's own document; None if it does not answer.
        hub: whether the hub could be queried.
        seconds: duration of the queries of the workers and of the daemon.
    """

    name: str
    documents: tuple[StatusDocument, ...]
    daemon: DaemonStatus | None
    hub: bool
    seconds: float

    @property
    def workers(self) -> list[WorkerReport]:
        """The daemon's status of each worker that is supposed to run."""
        return enabled_workers(self.daemon)


def enabled_workers(daemon: DaemonStatus | None) -> list[WorkerReport]:
    """Return the daemon's reports of the workers that are supposed to run; empty if the daemon does not answer."""
    return [] if daemon is None else [worker for worker in daemon.workers if worker.phase not in AT_REST]


class Source:
    """Queries at most once per `FRESH_SECONDS`. Safe to use from any thread; concurrent callers share an answer."""

    def __init__(self, config: Config, ask: Ask) -> None:
        self._config, self._ask = config, ask
        self._lock = threading.Lock()
        self._snapshot: Snapshot | None = None
        self._until = 0.0
        self._errors: dict[str, str] = {}

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
        own = [answer for answer in answers if answer.daemon == self._config.name and not answer.error]
        documents = tuple(
            read_status(answer.value, answer.daemon, answer.worker) for answer in own if isinstance(answer.value, dict)
        )
        self._log_errors(documents)
        daemon = ask_daemon(self._config, _DAEMON_SECONDS)
        return Snapshot(self._config.name, documents, daemon, hub, time.monotonic() - began)

    def _log_errors(self, documents: Sequence[StatusDocument]) -> None:
        """Log once which values are missing from the metrics."""
        errors = {document.worker: document.error for document in documents if INVALID in document.error}
        for worker, error in errors.items():
            if self._errors.get(worker) != error:
                _log.warning("%s: %s", worker, error)
        self._errors = errors


class Readiness:
    """Whether the daemon's workers are up, according to the daemon."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._lock = threading.Lock()
        self._reasons: list[str] = []
        self._until = 0.0

    def reasons(self) -> list[str]:
        """Return why the daemon is not ready, one reason for each worker; empty if it is ready."""
        with self._lock:
            if time.monotonic() >= self._until:
                self._reasons = _reasons(ask_daemon(self._config, _DAEMON_SECONDS), self._config.name)
                self._until = time.monotonic() + READY_SECONDS
            return self._reasons


def _reasons(daemon: DaemonStatus | None, name: str) -> list[str]:
    if daemon is None:
        return [f"no daemon named '{name}' answers"]
    return [
        ": ".join(filter(None, (worker.worker, worker.phase, worker.text)))
        for worker in enabled_workers(daemon)
        if worker.phase != Phase.UP.value
    ]
