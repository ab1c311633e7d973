"""The worker that runs the simulator."""

from __future__ import annotations

import logging

from bridge.config.model import Config
from bridge.messages.registry import Registry
from bridge.modules.running import Running
from bridge.worker import Health, Worker
from sim.simulator import Simulator

_FIXED = ("name", "state", "hub", "types", "limits", "yarp", "clock")


class SimWorker(Worker):
    """One simulation in a process of its own: DART holds Python's lock while it computes."""

    def __init__(self) -> None:
        self._config: Config | None = None
        self._running: Running | None = None

    def start(self, config: Config) -> None:
        """Start the simulation; where it cannot, it is tried again and `health` says why."""
        self._config = config
        registry = Registry(folders=list(config.types.folders), mapping_rules=list(config.types.mapping_rules))
        self._running = Running(Simulator, Simulator.name, config.sim, config, registry)
        self._running.start()

    def reload(self, config: Config) -> bool:
        """Begin again with another section; False where only a restart of the worker can."""
        old, running = self._config, self._running
        if old is None or running is None or any(getattr(config, part) != getattr(old, part) for part in _FIXED):
            return False
        self._config = config
        logging.getLogger().setLevel(config.log.level.upper())
        if running.section != config.sim:
            running.reload(config.sim, config)
        return True

    def health(self) -> Health:
        """How the simulation is."""
        return self._running.health() if self._running is not None else Health("waiting", "stopped")

    def stop(self) -> None:
        """Stop it."""
        running, self._running = self._running, None
        if running is not None:
            running.stop()
