"""The worker of the server for the Foxglove app."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from threading import Lock
from typing import Any

import psutil

from bridge.config.model import Config
from bridge.foxglove.channels import Channels
from bridge.foxglove.events import Events
from bridge.foxglove.server import FoxgloveServer
from bridge.messages.registry import Registry
from bridge.modules.host import Host
from bridge.modules.hub_topics import HubTopics
from bridge.worker import Health, Worker, costs

_log = logging.getLogger("midspan.foxglove")

GATHER_SECONDS = 0.1
"""Changes of the hub's graph are gathered for so long: they come by the hundred."""


class FoxgloveWorker(Worker):
    """Shows the hub to the Foxglove app, and is a node of the hub like any module."""

    def __init__(self) -> None:
        self._config: Config | None = None
        self._live: Live | None = None

    def start(self, config: Config) -> None:
        """Open the node and the server; raises `RuntimeError` where the address is taken."""
        self._config = config
        self._live = Live(config)
        self._live.start()
        _log.info("the Foxglove app finds the hub at %s", self._live.server.address)

    def reload(self, config: Config) -> bool:
        """The app connects again by itself, so a new start is all that is needed."""
        return config == self._config

    def health(self) -> Health:
        """Where the server is; raises `TimeoutError` where the worker's thread hangs."""
        assert self._live is not None
        self._live.host.loop.computes()
        return Health("running", self._live.text())

    def stop(self) -> None:
        """Cut the clients, and leave the hub."""
        live, self._live = self._live, None
        if live is not None:
            live.close()


class Live:
    """The parts of the server, put together."""

    def __init__(self, config: Config) -> None:
        types = config.types
        registry = Registry(folders=list(types.folders), mapping_rules=list(types.mapping_rules))
        self.host = host = Host("foxglove", config, registry)
        try:
            events = Events(lambda: host.loop.post(self.channels.watch))
            self.server = FoxgloveServer(config.name, config.foxglove.listen, events, [])
        except BaseException:
            host.close()
            raise
        self._graph = Gathered(host, lambda: self.channels.look())
        self._topics = HubTopics(host.node.hub, registry, self._graph.changed)
        self.channels = Channels(self.server, self._topics, events)
        self._process = psutil.Process(os.getpid())
        self._started = time.monotonic()

    def start(self) -> None:
        """Show what there is."""
        self.host.loop.start()
        self.host.answer("status", self._status)
        self.host.loop.every(1.0, self._tick)
        self._graph.changed()

    def text(self) -> str:
        """Where it is, and what it shows."""
        return f"{self.server.address}, {self.channels.count} topics, {self.channels.watched} watched"

    def _tick(self) -> None:
        self.host.tick()
        self.channels.tick()

    def _status(self, _params: Any) -> dict[str, Any]:
        return {
            "daemon": self.host.config.name,
            "worker": "foxglove",
            "side": "foxglove",
            "state": "running",
            "text": self.text(),
            "pid": os.getpid(),
            "uptime": round(time.monotonic() - self._started, 1),
            **costs(self._process),
            **self.channels.status(),
        }

    def close(self) -> None:
        """Cut the clients, then leave."""
        self.server.close()
        self.host.loop.call(self.channels.close)
        self._topics.close()
        self.host.close()


class Gathered:
    """Calls once for many changes, a moment later, on the worker's thread."""

    def __init__(self, host: Host, look: Callable[[], None]) -> None:
        self._host, self._look = host, look
        self._lock = Lock()
        self._due = False

    def changed(self) -> None:
        """Something changed; may be called on any thread, also before the worker's runs."""
        with self._lock:
            due, self._due = self._due, True
        if not due:
            self._host.loop.after(GATHER_SECONDS, self._run)

    def _run(self) -> None:
        with self._lock:
            self._due = False
        self._look()
