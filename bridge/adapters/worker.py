"""The worker of one side: a hub session, the side's edge, and the engine that routes between them."""

from __future__ import annotations

import importlib
import logging
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

from bridge.adapters.base import Edge
from bridge.adapters.memory import keep_memory
from bridge.config.model import Config
from bridge.config.state import state_folder
from bridge.hub.errors import HubError
from bridge.hub.session import Hub, HubSettings
from bridge.messages.registry import Registry
from bridge.routing.diagnostics import Diagnostics
from bridge.routing.engine import Engine
from bridge.worker import Health, Worker

_log = logging.getLogger(__name__)

_STOPPING = "the worker is stopping"

SWITCH_INTERVAL = 0.0002
"""Seconds after which a thread that only computes gives way to one that has a message."""

EDGES = {"ros1": "bridge.adapters.ros1.edge:Ros1Edge", "ros2": "bridge.adapters.ros2.edge:Ros2Edge"}
"""Edge class of each side; imported in that side's worker alone."""


def make_edge(side: str, config: Config, registry: Registry, state: Path) -> Edge:
    """Import and construct a side's edge."""
    module, _, name = EDGES[side].partition(":")
    edge: Edge = getattr(importlib.import_module(module), name)(config, registry, state)
    return edge


class BridgeWorker(Worker):
    """Joins one side to the hub."""

    def __init__(self, side: str) -> None:
        self.side = side
        self._config: Config | None = None
        self._hub: Hub | None = None
        self._engine: Engine | None = None
        self._diagnostics: Diagnostics | None = None
        self._closers: list[Callable[[], None]] = []
        self._failure = ""
        self._started = time.monotonic()
        self._process = psutil.Process()

    def start(self, config: Config) -> None:
        """Open the hub session and begin to join the side."""
        self._config = config
        # A status document or diagnostics of many routes must not hold up a message for Python's usual 5 ms.
        sys.setswitchinterval(SWITCH_INTERVAL)
        keep_memory()
        state = state_folder(config)
        registry = Registry(folders=list(config.types.folders), mapping_rules=list(config.types.mapping_rules))
        edge = make_edge(self.side, config, registry, state)
        self._hub = Hub.open(
            HubSettings(
                domain=config.hub.domain,
                router=config.hub.listen,
                zenoh=config.hub.zenoh,
                shared_memory=config.hub.shared_memory,
                node=f"midspan_{self.side}",
                namespace="/",
                daemon=config.name,
                worker=self.side,
                max_payload=config.limits.message_bytes,
            )
        )
        self._engine = Engine(edge, self._hub, config.routing, config.name, self._failed)
        self._engine.start()
        verbs = {"status": self._status, "explain": self._explain, "tap": self._tap, "time": self._time}
        self._closers = [self._hub.serve(verb, handler) for verb, handler in verbs.items()]
        self._diagnostics = Diagnostics(edge, registry, self._engine, f"midspan {config.name}/{self.side}")
        self._process.cpu_percent()

    def reload(self, config: Config) -> bool:
        """Take up new rules; other changes of what it uses need a restart."""
        old = self._config
        if old is None or self._engine is None:
            return False
        fixed = ("name", "state", "hub", "types", "limits", self.side)
        if any(getattr(config, part) != getattr(old, part) for part in fixed):
            return False
        self._config = config
        logging.getLogger().setLevel(config.log.level.upper())
        if config.routing != old.routing:
            self._engine.reload(config.routing)
        return True

    def health(self) -> Health:
        """How the engine is."""
        engine = self._engine
        if engine is None:
            return Health("waiting", "starting")
        if self._failure:
            raise RuntimeError(self._failure)
        engine.alive()
        summary = engine.summary()
        if self._diagnostics is not None:
            self._diagnostics.publish()
        if summary.network is None:
            return Health("waiting", f"{self.side} is away")
        refused = f", {summary.refused} refused" if summary.refused else ""
        return Health("running", f"{summary.routes} routes, {summary.rate:.0f} msg/s{refused}")

    def stop(self) -> None:
        """Give back every endpoint and close the session."""
        diagnostics, self._diagnostics = self._diagnostics, None
        if diagnostics is not None:
            diagnostics.close()
        for closer in self._closers:
            closer()
        self._closers = []
        engine, self._engine = self._engine, None
        if engine is not None:
            engine.stop()
        hub, self._hub = self._hub, None
        if hub is not None:
            hub.close()

    def _failed(self, reason: str) -> None:
        _log.error("%s: %s", self.side, reason)
        self._failure = reason

    def _status(self, _params: dict[str, Any]) -> dict[str, Any]:
        engine, hub, config = self._engine, self._hub, self._config
        if engine is None or hub is None or config is None:
            raise HubError(_STOPPING)
        document = engine.status()
        return {
            "daemon": config.name,
            "worker": self.side,
            "side": self.side,
            "pid": os.getpid(),
            "zid": hub.zid,
            "state": "waiting" if document["network"] is None else "running",
            "uptime": round(time.monotonic() - self._started, 1),
            "cpu": round(self._process.cpu_percent() / 100, 4),
            "rss": self._process.memory_info().rss,
            **document,
        }

    def _explain(self, params: dict[str, Any]) -> list[dict[str, Any]]:
        return self._running().explain(str(params.get("topic", "")))

    def _tap(self, params: dict[str, Any]) -> dict[str, str]:
        return self._running().tap(str(params.get("topic", "")), float(params.get("seconds", 10.0)))

    def _running(self) -> Engine:
        if self._engine is None:
            raise HubError(_STOPPING)
        return self._engine

    def _time(self, _params: dict[str, Any]) -> dict[str, int]:
        return {"time_ns": time.time_ns()}
