"""Tells on ``/diagnostics`` of the hub how each part of this daemon is, while anybody hears it.

It is heard where a native program of the hub subscribes, or a side's worker says that one of its side does
(`bridge.hub.diagnostics.HEARD`). Else nothing is asked and nothing is published. One process of the daemon tells
(`publishing_worker`): where that one ends, the next one goes on.
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
from bridge.hub.session import Hub, follow_clock
from bridge.messages.errors import MessageError
from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter
from bridge.metrics.link import HubLink
from bridge.metrics.parts import Level, parts, worker_status
from bridge.metrics.source import AT_REST, Document, Source
from bridge.sides import all_sides

_log = logging.getLogger("midspan.metrics")

PERIOD = 1.0
POLL_SECONDS = 0.2
"""So often the daemon is asked whose turn it is, and whether a worker's level has changed, which is told at once."""

_DAEMON_SECONDS = 0.5
_RETRY_SECONDS = 60.0
"""After what cannot be told."""


def publishing_worker(daemon_status: Document) -> str:
    """Which worker tells: the first that runs, by the daemon's word; "" where it gives none.

    First those that are to tell and carry no messages, then the sides.
    """
    up = {worker["worker"] for worker in daemon_status.get("workers", ()) if worker["phase"] == Phase.UP.value}
    order = ("metrics", "web", "foxglove", *(side.name for side in all_sides()), "modules")
    return next((name for name in order if name in up), "")


class DiagnosticsPublisher:
    """Makes the message, and publishes it.

    Args:
        hub: a node that speaks for no side, so that what it says goes to all of them.
        source: what is known.
    """

    def __init__(self, config: Config, hub: Hub, source: Source) -> None:
        self._config, self._source = config, source
        self._clock = RunClock(simulated=config.clock.simulated)
        follow_clock(self._clock, hub)
        registry = Registry.of(config.types)
        self._publisher, self._schema = announce(hub, registry), registry.schema(TYPE)
        self._levels: dict[str, Level] = {}
        self._due = 0.0

    def look(self, daemon_status: Document) -> None:
        """Tell if it is time, or a worker's level is another one by the daemon's word; raises `HubError`."""
        if time.monotonic() >= self._due or self._level_changed(daemon_status):
            self._due = time.monotonic() + PERIOD
            self._publish(daemon_status)

    def _level_changed(self, daemon_status: Document) -> bool:
        statuses = [worker_status(worker) for worker in daemon_status.get("workers", ()) if worker["phase"] not in AT_REST]
        return any(self._levels.get(status.part) != status.level for status in statuses)

    def _publish(self, daemon_status: Document) -> None:
        statuses = parts(replace(self._source.snapshot(), daemon=daemon_status), self._config)
        self._levels = {status.part: status.level for status in statuses}
        message = {
            "header": {"stamp": self._clock.stamp()},
            "status": [status.message_of(self._config.name) for status in statuses],
        }
        self._publisher.put(MessageWriter(self._schema).message(message))


def publish_while(wanted: Callable[[], bool], closing: threading.Event, config: Config, worker: str) -> None:
    """Tell while it is heard and this worker's turn, by a session that is open for so long.

    The worker's own would not do: what a side's session says comes from that side, and does not go back to it; and what
    one node says, it does not hear itself, as the console would.
    """
    link, publisher = HubLink(config, f"{worker}_diagnostics"), None
    try:
        while wanted() and not closing.is_set():
            daemon_status = ask_daemon(config, _DAEMON_SECONDS) or {}
            is_publisher = publishing_worker(daemon_status) == worker
            if publisher is None and is_publisher and (hub := link.join()) is not None:
                publisher = DiagnosticsPublisher(config, hub, Source(config, link.ask))
            elif publisher is not None and daemon_status and not is_publisher:
                link.close()
                publisher = None
            if publisher is not None:
                publisher.look(daemon_status)
            closing.wait(POLL_SECONDS)
    except (HubError, MessageError) as err:
        _log.warning("no diagnostics: %s", err)
        closing.wait(_RETRY_SECONDS)
    finally:
        link.close()
