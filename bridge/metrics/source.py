"""What the figures are made of: the status documents of this daemon's workers, and the daemon's own word.

Each daemon tells of its own parts alone, so that who scrapes several joined ones has nothing twice.
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
"""A worker that has not answered by then is told of as not answering."""

FRESH_SECONDS = 1.0
"""Whoever asks again sooner gets what was found: a worker is asked once a second at most, however many scrape."""

AT_REST = frozenset({Phase.OFF.value, Phase.UNAVAILABLE.value})
"""Phases of a worker that is not to run here."""

_DAEMON_SECONDS = 0.5

READY_SECONDS = 0.5
"""The same for the question whether all is ready, which the daemon alone is asked."""

Ask = Callable[[], list[WorkerAnswer]]
"""Asks all workers of this daemon for their status documents, for `ASK_SECONDS`; raises `HubError` without a hub."""


@dataclass(frozen=True)
class Snapshot:
    """What is known at one moment.

    Attributes:
        name: of the daemon.
        documents: of the workers and modules that answered.
        daemon: the daemon's own, empty where none answers.
        hub: whether the hub could be asked.
        seconds: that asking took.
    """

    name: str
    documents: tuple[Document, ...]
    daemon: Document
    hub: bool
    seconds: float

    @property
    def workers(self) -> list[Document]:
        """The daemon's word on each worker that is to run."""
        return [worker for worker in self.daemon.get("workers", ()) if worker["phase"] not in AT_REST]


class Source:
    """Asks, at most once in `FRESH_SECONDS`. Safe to use from any thread; who comes meanwhile waits for the answer."""

    def __init__(self, config: Config, ask: Ask) -> None:
        self._config, self._ask = config, ask
        self._lock = threading.Lock()
        self._snapshot: Snapshot | None = None
        self._until = 0.0

    def snapshot(self) -> Snapshot:
        """What is known now, or was a moment ago."""
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
    """Whether the daemon's workers are up, by its own word alone."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._lock = threading.Lock()
        self._reasons: list[str] = []
        self._until = 0.0

    def reasons(self) -> list[str]:
        """Why it is not ready, one reason for each worker; none where it is."""
        with self._lock:
            if time.monotonic() >= self._until:
                self._reasons = _reasons(ask_daemon(self._config, _DAEMON_SECONDS), self._config.name)
                self._until = time.monotonic() + READY_SECONDS
            return self._reasons


def _reasons(daemon_status: Document | None, name: str) -> list[str]:
    if daemon_status is None:
        return [f"no daemon of the name '{name}' answers"]
    ready = {*AT_REST, Phase.UP.value}
    return [
        f"{worker['worker']}: {worker['phase']}" + (f": {worker['text']}" if worker["text"] else "")
        for worker in daemon_status.get("workers", ())
        if worker["phase"] not in ready
    ]
