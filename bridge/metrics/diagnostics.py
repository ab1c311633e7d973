"""Tells on ``/diagnostics`` of the hub how each part of this daemon is, while anybody hears it.

It is heard where a native program of the hub subscribes, or a side's worker says that one of its side does
(`bridge.hub.diagnostics.HEARD`). Else nothing is asked and nothing is published.
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import replace

from bridge.clock import RunClock
from bridge.config.model import Config
from bridge.daemon.query import ask_daemon
from bridge.hub.diagnostics import HEARD, TOPIC, TYPE
from bridge.hub.errors import HubError
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.errors import MessageError
from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter
from bridge.metrics.parts import Level, parts, worker_status
from bridge.metrics.source import AT_REST, Document, Source

_log = logging.getLogger("midspan.metrics")

PERIOD = 1.0
LOOK_SECONDS = 0.2
"""So often the daemon is asked whether a worker's level has changed, which is told at once."""

_DAEMON_SECONDS = 0.5


class DiagnosticsTeller:
    """Publishes on a thread of its own, which waits while nobody hears.

    Args:
        config: the configuration.
        hub: a node that speaks for no side, so that what it says goes to all of them.
        registry: of types.
        clock: the time of the stamps.
        source: what is known.
    """

    def __init__(self, config: Config, hub: Hub, registry: Registry, clock: RunClock, source: Source) -> None:
        self._config, self._hub, self._clock, self._source = config, hub, clock, source
        end = hub.publisher(TOPIC, TYPE, registry.ros2(TYPE).type_id, Qos(depth=10))
        self._publisher, self._schema = end, registry.schema(TYPE)
        self._changed, self._closing = threading.Event(), threading.Event()
        self._unwatch = hub.graph.watch(self._changed.set)
        self._levels: dict[str, Level] = {}
        self._thread = threading.Thread(target=self._run, name="midspan-diagnostics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Tell no more."""
        self._closing.set()
        self._changed.set()
        self._thread.join(2.0)
        self._unwatch()
        self._publisher.close()

    def _run(self) -> None:
        due = 0.0
        while not self._closing.is_set():
            self._changed.clear()
            if not self._heard():
                if not self._closing.is_set():
                    self._changed.wait()
                continue
            try:
                said = ask_daemon(self._config, _DAEMON_SECONDS) or {}
                if time.monotonic() >= due or self._level_changed(said):
                    due = time.monotonic() + PERIOD
                    self._tell(said)
            except HubError:
                return
            except MessageError:
                _log.exception("no diagnostics")
                return
            self._closing.wait(LOOK_SECONDS)

    def _heard(self) -> bool:
        graph = self._hub.graph
        native = (each for each in graph.subscriptions(TOPIC) if each.origin is None and not each.pending)
        return any(not each.own for each in native) or bool(graph.subscriptions(HEARD))

    def _level_changed(self, said: Document) -> bool:
        found = [worker_status(one) for one in said.get("workers", ()) if one["phase"] not in AT_REST]
        return any(self._levels.get(status.part) != status.level for status in found)

    def _tell(self, said: Document) -> None:
        found = parts(replace(self._source.snapshot(), daemon=said), self._config)
        self._levels = {status.part: status.level for status in found}
        name = self._config.name
        message = {
            "header": {"stamp": self._clock.stamp()},
            "status": [status.message_of(name) for status in found],
        }
        self._publisher.put(MessageWriter(self._schema).message(message))
