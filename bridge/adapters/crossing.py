"""One foreign network joined to the hub: a hub session, its side's edge, and the engine that routes between them."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from typing import Any

import psutil

from bridge.adapters.base import Edge
from bridge.clock import RunClock
from bridge.config.model import Config
from bridge.config.sections.routing import RoutingSection
from bridge.config.state import state_folder
from bridge.hub.clock import follow
from bridge.hub.errors import HubError
from bridge.hub.session import Hub, HubSettings
from bridge.messages.registry import Registry
from bridge.routing import room
from bridge.routing.diagnostics import Diagnostics
from bridge.routing.engine import Engine
from bridge.worker import Health, costs

_log = logging.getLogger(__name__)

_STOPPING = "the worker is stopping"


class Crossing:
    """Joins one network; it answers on the hub's control plane under its name.

    Args:
        name: of the worker on the control plane; the side's, where the worker has one network.
        edge: not started yet.
        config: the configuration.
        registry: of types, shared by a worker's crossings.
        failed: called with the reason when the edge or the engine cannot go on.
        diagnostics: whether the counters are published on the side.
    """

    def __init__(
        self,
        name: str,
        edge: Edge,
        config: Config,
        registry: Registry,
        failed: Callable[[str], None],
        *,
        diagnostics: bool,
    ) -> None:
        self.name, self._config = name, config
        self._side = edge.side
        self._started = time.monotonic()
        self._process = psutil.Process()
        self._closers: list[Callable[[], None]] = []
        self._diagnostics: Diagnostics | None = None
        self._hub: Hub | None = Hub.open(
            HubSettings(
                domain=config.hub.domain,
                router=config.hub.listen,
                zenoh=config.hub.zenoh,
                shared_memory=config.hub.shared_memory,
                node=f"midspan_{name}",
                namespace="/",
                daemon=config.name,
                worker=name,
                max_payload=config.limits.message_bytes,
            )
        )
        edge.clock = RunClock(simulated=config.clock.simulated)
        follow(edge.clock, self._hub)
        self._engine: Engine | None = Engine(edge, self._hub, config.rules, config.name, failed, registry)
        self._engine.start()
        self._share_parameters(config.routing)
        verbs = {"status": self._status, "explain": self._explain, "tap": self._tap, "time": self._time}
        self._closers = [self._hub.serve(verb, handler) for verb, handler in verbs.items()]
        if diagnostics:
            self._diagnostics = Diagnostics(edge, registry, self._engine, f"midspan {config.name}/{name}")
        self._process.cpu_percent()

    def reload(self, routing: RoutingSection) -> None:
        """Take up new rules."""
        self._running().reload(routing)
        if routing.parameters != self._parameters:
            self._unshare()
            self._share_parameters(routing)

    def _share_parameters(self, routing: RoutingSection) -> None:
        engine, hub = self._engine, self._hub
        assert engine is not None
        assert hub is not None
        self._parameters = routing.parameters
        self._unshare = engine.edge.carry_parameters(
            routing.parameters, hub, lambda: engine.summary().state == "running"
        )

    def health(self) -> Health:
        """How the engine is; raises `TimeoutError` where it stands still."""
        engine = self._running()
        engine.alive()
        summary = engine.summary()
        if self._diagnostics is not None:
            self._diagnostics.publish()
        return Health(summary.state, summary.text or f"{self.name} is away")

    def stop(self) -> None:
        """Give back every endpoint and close the session."""
        diagnostics, self._diagnostics = self._diagnostics, None
        if diagnostics is not None:
            diagnostics.close()
        for closer in self._closers:
            closer()
        self._closers = []
        self._unshare()
        engine, self._engine = self._engine, None
        if engine is not None:
            engine.stop()
        hub, self._hub = self._hub, None
        if hub is not None:
            hub.close()

    def _status(self, _params: dict[str, Any]) -> dict[str, Any]:
        engine, hub = self._engine, self._hub
        if engine is None or hub is None:
            raise HubError(_STOPPING)
        document = engine.status()
        return {
            "daemon": self._config.name,
            "worker": self.name,
            "side": self._side,
            "pid": os.getpid(),
            "zid": hub.zid,
            "state": engine.summary().state,
            "uptime": round(time.monotonic() - self._started, 1),
            **costs(self._process),
            **document,
            **engine.edge.details(),
            "warnings": [*document["warnings"], *room.warnings(state_folder(self._config))],
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
