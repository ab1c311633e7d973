"""Lets a worker that carries messages tell on ``/diagnostics`` where no other process of the daemon does.

Until somebody hears there is no thread, no session and no topic, and what tells is not imported.
"""

from __future__ import annotations

import threading

from bridge.config.model import Config
from bridge.worker import Worker


class DiagnosticsOnDemand:
    """Tells on a thread of its own, which ends when nobody hears any more."""

    def __init__(self, worker: Worker, name: str) -> None:
        self._worker, self._name = worker, name
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None
        self._config: Config | None = None

    def look(self, config: Config) -> None:
        """Begin where it is heard, and anew with another configuration; called again and again by one thread."""
        if self._thread is not None and (config is not self._config or not self._thread.is_alive()):
            self.close()
        if self._thread is None and config.metrics.diagnostics and self._worker.hears_diagnostics():
            self._config = config
            self._closing.clear()
            self._thread = threading.Thread(target=self._run, args=(config,), name="midspan-diagnostics", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Tell no more, until the next look."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._closing.set()
            thread.join(2.0)

    def _run(self, config: Config) -> None:
        from bridge.metrics.diagnostics import publish_while

        publish_while(self._worker.hears_diagnostics, self._closing, config, self._name)
