"""Lets a worker publish on ``/diagnostics`` if no other process of the daemon does.

Without subscribers the worker has no thread, session or topic for this, and does not import the publishing code.
"""

from __future__ import annotations

import threading

from bridge.config.model import Config
from bridge.metrics.section import MetricsSection
from bridge.worker import Worker

_END_SECONDS = 2.0


class DiagnosticsOnDemand:
    """Publishes on a separate thread, which ends with the last subscriber."""

    def __init__(self, worker: Worker, name: str) -> None:
        self._worker, self._name = worker, name
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None
        self._config: Config | None = None

    def on_heartbeat(self, config: Config) -> None:
        """Start if there are subscribers, restart if the configuration has changed; called repeatedly by one thread."""
        if self._thread is not None and (config is not self._config or not self._thread.is_alive()):
            self.close()
        if self._thread is None and config.section(MetricsSection).diagnostics and self._worker.diagnostics_wanted():
            self._config = config
            # a new event, because the previous thread may still be in a query
            self._closing = threading.Event()
            self._thread = threading.Thread(
                target=self._run, args=(config, self._closing), name="midspan-diagnostics", daemon=True
            )
            self._thread.start()

    def close(self) -> None:
        """Stop publishing until the next `on_heartbeat`."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._closing.set()
            thread.join(_END_SECONDS)

    def _run(self, config: Config, closing: threading.Event) -> None:
        from bridge.metrics.diagnostics import publish_while

        publish_while(self._worker.diagnostics_wanted, closing, config, self._name)
