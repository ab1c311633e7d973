"""Publishes the state of each part of this daemon on the hub's ``/diagnostics`` while the topic has subscribers.

The topic has subscribers if a native program of the hub subscribes, or if a side's worker reports a subscriber on its
side (`bridge.hub.diagnostics.DIAGNOSTICS_WANTED`). Otherwise nothing is queried or published. Only one process of the
daemon publishes (`publishing_worker`); if it ends, the next one takes over.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from bridge.clock import RunClock
from bridge.config.model import Config
from bridge.daemon.query import Phase, ask_daemon
from bridge.hub.diagnostics import TYPE, announce
from bridge.hub.errors import HubError
from bridge.hub.node import Hub, follow_clock
from bridge.messages.errors import MessageError
from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter
from bridge.metrics.link import HubLink
from bridge.metrics.parts import Level, parts, worker_status
from bridge.metrics.source import Source, enabled_workers
from bridge.sides import all_sides
from bridge.status import DaemonStatus

_log = logging.getLogger("midspan.metrics")

PERIOD = 1.0
POLL_SECONDS = 0.2
"""Interval at which the daemon is queried for the worker that publishes, and for changed levels of workers."""

_DAEMON_SECONDS = 0.5
_RETRY_SECONDS = 60.0
"""Delay after an error before the next attempt."""


def publishing_worker(daemon: DaemonStatus | None) -> str:
    """Return the worker that publishes: the first worker in a fixed order that is up, or "".

    Workers that bridge no messages come first, then the sides.
    """
    up = {report.worker for report in enabled_workers(daemon) if report.phase == Phase.UP.value}
    order = ("metrics", "web", "foxglove", *(side.name for side in all_sides()), "modules")
    return next((name for name in order if name in up), "")


class DiagnosticsPublisher:
    """Builds and publishes the diagnostics.

    Args:
        hub: a node without a side, so that all sides receive its messages.
        source: provides the status documents.
    """

    def __init__(self, config: Config, hub: Hub, source: Source) -> None:
        self._config, self._source = config, source
        self._clock = RunClock(simulated=config.clock.simulated)
        follow_clock(self._clock, hub)
        registry = Registry.of(config.types)
        self._publisher, self._schema = announce(hub, registry), registry.schema(TYPE)
        self._levels: dict[str, Level] = {}
        self._due = 0.0

    def refresh(self, daemon: DaemonStatus | None) -> None:
        """Publish if the period is over or the daemon reports a changed level of a worker; raises `HubError`."""
        if time.monotonic() >= self._due or self._level_changed(daemon):
            self._due = time.monotonic() + PERIOD
            self._publish(daemon)

    def _level_changed(self, daemon: DaemonStatus | None) -> bool:
        statuses = [worker_status(report) for report in enabled_workers(daemon)]
        return any(self._levels.get(status.part) != status.level for status in statuses)

    def _publish(self, daemon: DaemonStatus | None) -> None:
        statuses = parts(replace(self._source.snapshot(), daemon=daemon), self._config)
        self._levels = {status.part: status.level for status in statuses}
        message = {
            "header": {"stamp": self._clock.stamp()},
            "status": [status.message_of(self._config.name) for status in statuses],
        }
        self._publisher.put(MessageWriter(self._schema).message(message))


def publish_while(wanted: Callable[[], bool], closing: threading.Event, config: Config, worker: str) -> None:
    """Publish while there are subscribers and it is this worker's turn, on a session that exists only for that time.

    The worker's own session cannot be used. Messages on a side's session count as coming from that side, so they would
    not be sent to that side; and a node does not receive its own messages, which the console needs.
    """
    link, publisher = HubLink(config, f"{worker}_diagnostics"), None
    try:
        while wanted() and not closing.is_set():
            daemon = ask_daemon(config, _DAEMON_SECONDS)
            is_publisher = publishing_worker(daemon) == worker
            if publisher is None and is_publisher and (hub := link.join()) is not None:
                publisher = DiagnosticsPublisher(config, hub, Source(config, link.ask))
            elif publisher is not None and daemon is not None and not is_publisher:
                link.close()
                publisher = None
            if publisher is not None:
                publisher.refresh(daemon)
            closing.wait(POLL_SECONDS)
    except (HubError, MessageError) as err:
        _log.warning("no diagnostics: %s", err)
        closing.wait(_RETRY_SECONDS)
    finally:
        link.close()
