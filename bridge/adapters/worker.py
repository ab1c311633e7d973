"""The worker of one side: for each of its networks a crossing to the hub."""

from __future__ import annotations

import importlib
import logging
import sys
from pathlib import Path

from bridge.adapters.base import Edge
from bridge.adapters.crossing import Crossing
from bridge.adapters.memory import keep_memory, keep_objects
from bridge.config.model import Config
from bridge.config.state import worker_folder
from bridge.hub import pools
from bridge.messages.registry import Registry
from bridge.worker import Health, Worker

_log = logging.getLogger(__name__)

SWITCH_INTERVAL = 0.0002
"""Seconds after which a thread that only computes gives way to one that has a message."""

EDGES = {
    "ros1": "bridge.adapters.ros1.edge:Ros1Edge",
    "ros2": "bridge.adapters.ros2.edge:Ros2Edge",
    "yarp": "bridge.adapters.yarp.edge:YarpEdge",
}
"""Edge class of each side that has one network; imported in that side's worker alone."""

DIALECTS = "bridge.adapters.zenoh.dialects:make_edges"
"""What makes the edges of the zenoh side, one for each dialect that is configured."""


def make_edges(side: str, config: Config, registry: Registry, state: Path) -> dict[str, Edge]:
    """Import and construct a side's edges, by their names on the control plane."""
    module, _, name = EDGES.get(side, DIALECTS).partition(":")
    make = getattr(importlib.import_module(module), name)
    made = make(config, registry, state)
    return {side: made} if side in EDGES else made


class BridgeWorker(Worker):
    """Joins one side to the hub."""

    def __init__(self, side: str) -> None:
        self.side = side
        self._config: Config | None = None
        self._crossings: list[Crossing] = []
        self._failure = ""

    def start(self, config: Config) -> None:
        """Open the hub sessions and begin to join the side's networks."""
        self._config = config
        # A status document or diagnostics of many routes must not hold up a message for Python's usual 5 ms.
        sys.setswitchinterval(SWITCH_INTERVAL)
        keep_memory()
        config = _with_memory(config)
        registry = Registry(folders=list(config.types.folders), mapping_rules=list(config.types.mapping_rules))
        for name, edge in make_edges(self.side, config, registry, worker_folder(config)).items():
            told = self.side in EDGES  # on foreign keys nobody expects our diagnostics
            self._crossings.append(Crossing(name, edge, config, registry, self._failed, diagnostics=told))
        # The first route needs it. Where its compiled form cannot be kept this takes seconds, for which no engine may
        # hang; else it is done while they look who else is on their networks.
        importlib.import_module("bridge.messages.machine")
        keep_objects()

    def reload(self, config: Config) -> bool:
        """Take up new rules; other changes of what it uses need a restart."""
        old = self._config
        if old is None or not self._crossings:
            return False
        fixed = ("name", "state", "hub", "types", "limits", self.side)
        if any(getattr(config, part) != getattr(old, part) for part in fixed):
            return False
        self._config = config
        logging.getLogger().setLevel(config.log.level.upper())
        if config.rules != old.rules:
            for crossing in self._crossings:
                crossing.reload(config.rules)
        return True

    def health(self) -> Health:
        """How the engines are; of several, the first that runs says how the worker is."""
        if self._failure:
            raise RuntimeError(self._failure)
        found = {crossing.name: crossing.health() for crossing in self._crossings}
        if not found:
            return Health("waiting", "starting")
        if len(found) == 1:
            return next(iter(found.values()))
        best = min(found.values(), key=lambda health: health.state != "running")
        return Health(best.state, "; ".join(f"{name}: {health.text}" for name, health in found.items()))

    def stop(self) -> None:
        """Give back every endpoint and close the sessions."""
        crossings, self._crossings = self._crossings, []
        for crossing in crossings:
            crossing.stop()

    def _failed(self, reason: str) -> None:
        _log.error("%s: %s", self.side, reason)
        self._failure = reason


def _with_memory(config: Config) -> Config:
    """The configuration, without the hub's shared memory where dead sessions' still fills the machine's."""
    if sys.platform != "linux":  # elsewhere shared memory is no files that are seen
        return config
    removed = pools.clean()
    if removed:
        _log.info("removed %d shared-memory files of dead zenoh sessions", removed)
    orphans = pools.orphans() if config.hub.shared_memory else 0
    if not orphans:
        return config
    _log.warning(
        "%d shared-memory pools of zenoh sessions that were killed are held by programs that live: the hub does without"
        " shared memory in this worker; start those programs anew, and then this one",
        orphans,
    )
    return config.model_copy(update={"hub": config.hub.model_copy(update={"shared_memory": False})})
