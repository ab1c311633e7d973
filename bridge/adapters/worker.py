"""The worker of one side: connects each of its networks to the hub."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from typing_extensions import override

from bridge import resources
from bridge.adapters.memory import keep_memory, keep_objects
from bridge.clock import RunClock
from bridge.config.model import Config
from bridge.config.sections.navigation import ACTION
from bridge.config.sections.routing import RoutingSection
from bridge.config.sections.section import SideSection
from bridge.hub import listeners, opening, shared_memory
from bridge.hub.control import Handler
from bridge.hub.daemons import identity_of
from bridge.hub.diagnostics import has_subscribers
from bridge.hub.errors import HubError
from bridge.hub.node import Hub, follow_clock
from bridge.hub.session import HubSettings
from bridge.messages.actions import GET_RESULT, split
from bridge.messages.registry import Registry
from bridge.progress import working
from bridge.registration import imported
from bridge.routing.diagnostics import Diagnostics
from bridge.routing.edge import Edge
from bridge.routing.engine import Engine
from bridge.routing.hold import Hold, held_topics
from bridge.routing.relay.relay import HubRelay
from bridge.routing.route import Route
from bridge.routing.rules import ENTRY, RuleSet
from bridge.routing.services.route import ServiceRoute
from bridge.routing.services.side_to_hub import PLANNERS
from bridge.sides import all_networks
from bridge.state_file import lane_folder, state_folder, worker_folder
from bridge.worker import Health, StatusHead, Worker, WorkerFailedError

_log = logging.getLogger(__name__)

SWITCH_INTERVAL = 0.0002
"""Seconds after which a computing thread yields to a thread that has a message to handle."""

DRAIN_SECONDS = 2.2
"""A stopping worker forwards the last replies of navigation for this time: longer than
`bridge.modules.worker.WIND_DOWN_SECONDS`, and within the 2.8 s that the daemon allows."""

_DRAIN_PERIOD = 0.02
_FIXED = ("name", "state", "hub", "types", "limits", "clock")
_LAST_SECONDS = 0.1


def make_edges(name: str, config: Config, registry: Registry, folder: Path) -> dict[str, Edge]:
    """Import and construct a side's edges; the keys are their names on the control plane."""
    side = all_networks()[name]
    edges: Any = imported(side.edges)(config, registry, folder)
    return dict(edges) if side.networks else {side.name: edges}


class BridgeWorker(Worker):
    """Connects one side to the hub.

    Attributes:
        config: the active configuration, None before the start.
        bridges: a `NetworkBridge` for each network of the side.
    """

    def __init__(self, side: str) -> None:
        self.side = all_networks()[side]
        self.config: Config | None = None
        self.bridges: list[NetworkBridge] = []
        self._failure = ""

    @override
    def start(self, config: Config) -> None:
        self.config = config
        # Building the status or diagnostics of many routes must not delay a message by Python's default of 5 ms.
        sys.setswitchinterval(SWITCH_INTERVAL)
        keep_memory()
        config = _with_memory(config)
        registry = Registry.of(config.types)
        working.at(self.side.loading or f"loading the {self.side.name} side")
        for name, edge in make_edges(self.side.name, config, registry, worker_folder(config)).items():
            working.at("opening the hub")
            diagnostics = not self.side.networks  # programs on foreign keys do not expect diagnostics
            self.bridges.append(NetworkBridge(name, edge, config, registry, self._failed, diagnostics=diagnostics))
        keep_objects()

    @override
    def reload(self, config: Config) -> bool:
        """Apply new rules and the log level; return False if another change needs a restart."""
        old = self.config
        if old is None or not self.bridges:
            return False
        if any(getattr(config, part) != getattr(old, part) for part in _FIXED):
            return False
        section: SideSection = getattr(config, self.side.name)
        if not section.joins_as(getattr(old, self.side.name)):
            return False
        self.config = config
        logging.getLogger().setLevel(config.log.level.upper())
        if config.rules != old.rules:
            for bridge in self.bridges:
                bridge.reload(config)
        return True

    @override
    def health(self) -> Health:
        """Return the combined health of the engines: running if any engine is."""
        if self._failure:
            raise WorkerFailedError(self._failure)
        if endpoint := listeners.arrived():
            raise WorkerFailedError(f"this machine has got the address of {endpoint} (hub.zenoh): restarting")
        reports = {bridge.name: bridge.health() for bridge in self.bridges}
        if not reports:
            return Health("waiting", "starting")
        if len(reports) == 1:
            return next(iter(reports.values()))
        best = min(reports.values(), key=lambda health: health.state != "running")
        return Health(best.state, "; ".join(f"{name}: {health.text}" for name, health in reports.items()))

    @override
    def diagnostics_wanted(self) -> bool:
        return bool(self.bridges) and self.bridges[0].diagnostics_wanted()

    @override
    def stop(self) -> None:
        """Close all endpoints and sessions once no result of a navigation goal is pending, or after `DRAIN_SECONDS`."""
        bridges, self.bridges = self.bridges, []
        deadline = time.monotonic() + DRAIN_SECONDS
        for bridge in bridges:
            bridge.drain(deadline)
        for bridge in bridges:
            bridge.stop()

    def _failed(self, reason: str) -> None:
        _log.error("%s: %s", self.side.name, reason)
        self._failure = reason


def _with_memory(config: Config) -> Config:
    """Return the configuration, without the hub's shared memory if programs still hold pools of dead sessions."""
    if sys.platform != "linux":  # other systems do not expose shared memory as files
        return config
    removed = shared_memory.clean()
    if removed:
        _log.info("removed %d shared-memory files of dead zenoh sessions", removed)
    orphans = shared_memory.orphans() if config.hub.shared_memory else 0
    if not orphans:
        return config
    _log.warning(
        "%d shared-memory pools of killed zenoh sessions are held by running programs: this worker does not use shared"
        " memory for the hub; restart those programs, then this worker",
        orphans,
    )
    return config.model_copy(update={"hub": config.hub.model_copy(update={"shared_memory": False})})


def _navigates(route: Route) -> bool:
    """Return whether the route has a pending get_result call for a goal of the gateway or of a planner."""
    if not isinstance(route, ServiceRoute) or not route.counters.pending:
        return False
    action, part = split(route.hub_topic)
    return part == GET_RESULT and (action == ACTION or action.startswith(PLANNERS))


class NetworkBridge:
    """Connects one network to the hub, and responds on the hub's control plane under its ``name``.

    ``edge`` is not started yet; ``failed`` is called with the reason when the edge or the engine fails permanently;
    with ``diagnostics``, the counters are published on the side.
    """

    def __init__(
        self, name: str, edge: Edge, config: Config, registry: Registry, failed: Callable[[str], None], *,
        diagnostics: bool,
    ) -> None:  # fmt: skip
        self.name, self._config = name, config
        self._side = edge.side
        self._head = StatusHead({"daemon": config.name, "worker": name, "side": edge.side})
        self._stopped = False
        self._never = threading.Event()  # never set; waiting for it pauses the thread
        settings = HubSettings(
            domain=config.hub.domain,
            router=config.hub.listen,
            zenoh=config.hub.zenoh,
            shared_memory=config.hub.shared_memory,
            node=f"midspan_{name}",
            namespace="/",
            daemon=config.name,
            worker=name,
            max_payload=config.limits.message_bytes,
            lane=lane_folder(config),
            identity=identity_of(config),
        )
        self._hub = Hub.open(settings)
        self._hub.versions = registry.releases
        edge.clock = RunClock(simulated=config.clock.simulated)
        follow_clock(edge.clock, self._hub)
        held, native = held_topics(config.navigation, edge.side), held_topics(config.navigation, ENTRY)
        self._hold = Hold(self._hub, held, native)
        self._engine = Engine(edge, self._hub, config.rules, config.name, failed, registry, self._hold)
        self._engine.start()
        rules, detector = RuleSet(config.rules), self._engine.stall_detector
        self._relay = HubRelay(self._hub, settings, rules, detector, self._hold, failed)
        self._relay.start()
        self._share_parameters(config.routing)
        verbs: dict[str, Handler] = {
            "status": lambda _params: self._status(),
            "explain": lambda params: self._running().explain(str(params.get("topic", ""))),
            "connections": lambda _params: [c.document() for c in self._running().edge.connections()],
            "tap": lambda params: self._running().tap(str(params.get("topic", "")), float(params.get("seconds", 10.0))),
            "time": lambda _params: {"time_ns": time.time_ns()},
        }
        self._closers = [self._hub.serve(verb, handler) for verb, handler in verbs.items()]
        source = f"midspan {config.name}/{name}"
        self._diagnostics = Diagnostics(edge, registry, self._engine, source, counters=diagnostics)

    def reload(self, config: Config) -> None:
        """Apply new rules."""
        routing = config.rules
        self._hold.topics = held_topics(config.navigation, self._side)
        self._hold.native = held_topics(config.navigation, ENTRY)
        self._running().reload(routing)
        self._relay.reload(RuleSet(routing))
        if routing.parameters != self._parameters:
            self._unshare()
            self._share_parameters(routing)

    def _share_parameters(self, routing: RoutingSection) -> None:
        engine, self._parameters = self._engine, routing.parameters
        carry = engine.edge.carry_parameters
        self._unshare = carry(routing.parameters, self._hub, lambda: engine.summary().state == "running")

    def health(self) -> Health:
        """Return the engine's health; raises `TimeoutError` if the engine hangs."""
        engine = self._running()
        computes = engine.alive() or self._relay.alive()
        opening.check_pool()
        engine.measure_rates()
        summary = engine.summary()
        self._diagnostics.publish()
        text = summary.text or engine.edge.away or f"waiting for {engine.edge.awaited}"
        return Health(summary.state, f"{text}; it {computes}" if computes else text)

    def diagnostics_wanted(self) -> bool:
        """Return whether `/diagnostics` has a subscriber on the hub or on any side."""
        return has_subscribers(self._hub.graph)

    def drain(self, deadline: float) -> None:
        """Wait until no result of a navigation goal is pending; meanwhile the daemon's gateway stops the robot.

        The wait ends at ``deadline``, in monotonic seconds, at the latest.
        """
        pending = any(map(_navigates, self._engine.routes()))
        while any(map(_navigates, self._engine.routes())) and time.monotonic() < deadline:
            self._never.wait(_DRAIN_PERIOD)
        if pending:
            self._never.wait(_LAST_SECONDS)  # until the last replies have been sent

    def stop(self) -> None:
        """Close all endpoints and the session."""
        self._diagnostics.close()
        for closer in self._closers:
            closer()
        self._unshare()
        self._hold.close()
        self._stopped = True
        self._relay.stop()
        self._engine.stop()
        self._engine.edge.clock.close()
        self._hub.close()

    def _status(self) -> dict[str, Any]:
        engine = self._running()
        troubles = engine.edge.away, engine.edge.clock.trouble(), opening.trouble(), listeners.trouble()
        return engine.status(
            [*filter(None, troubles), *resources.warnings(state_folder(self._config))],
            **self._head.fields(engine.summary().state),
            **engine.edge.details(),
            zid=self._hub.zid,
            lane=self._hub.lane(),
            relay=self._relay.status(),
        ).document()

    def _running(self) -> Engine:
        if self._stopped:
            raise HubError("the worker is stopping")
        return self._engine
