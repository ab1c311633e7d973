"""The worker that hosts the modules."""

from __future__ import annotations

import logging
import sys

from bridge.config.model import Config
from bridge.config.sections.section import Section
from bridge.messages.registry import Registry
from bridge.modules.kinds import kind_of
from bridge.modules.running import Running
from bridge.stores.service import StoreService
from bridge.worker import Health, Worker

_log = logging.getLogger(__name__)

SWITCH_INTERVAL = 0.0005
"""Seconds after which a thread that only computes gives way to one that has a message."""

_FIXED = ("name", "state", "hub", "store", "types", "limits", "yarp")


class ModulesWorker(Worker):
    """Runs the modules that the configuration switches on, or one of them alone.

    Args:
        only: the one module that this process runs, "" for all.
    """

    def __init__(self, only: str = "") -> None:
        self._only = only
        self._config: Config | None = None
        self._registry: Registry | None = None
        self._stores: StoreService | None = None
        self._running: dict[str, Running] = {}

    def start(self, config: Config) -> None:
        """Start the modules; one that cannot start does not keep the others from it."""
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._config = config
        self._registry = Registry(folders=list(config.types.folders), mapping_rules=list(config.types.mapping_rules))
        self._stores = StoreService(config, self._only)
        for name, section in self._sections(config).items():
            self._start(name, section, config, self._registry, self._stores)

    def reload(self, config: Config) -> bool:
        """Start, stop and change what the configuration says otherwise now."""
        old, registry, stores = self._config, self._registry, self._stores
        if (
            old is None
            or registry is None
            or stores is None
            or any(getattr(config, part) != getattr(old, part) for part in _FIXED)
        ):
            return False
        self._config = config
        logging.getLogger().setLevel(config.log.level.upper())
        sections = self._sections(config)
        for name in self._running.keys() - sections.keys():
            self._running.pop(name).stop()
        for name, section in sections.items():
            running = self._running.get(name)
            if running is None:
                self._start(name, section, config, registry, stores)
            elif running.section != section:
                running.reload(section, config)
        return True

    def health(self) -> Health:
        """How the modules are; the worker runs where one of them does."""
        found = {name: running.health() for name, running in self._running.items()}
        store = self._store_health()
        if store is not None:
            found["store"] = store
        if not found:
            return Health("waiting", "no module is switched on")
        best = min(found.values(), key=lambda health: health.state != "running")
        return Health(best.state, ", ".join(_words(name, health) for name, health in found.items()))

    def stop(self) -> None:
        """Stop all modules."""
        while self._running:
            self._running.popitem()[1].stop()
        if self._stores is not None:
            self._stores.close()

    def _store_health(self) -> Health | None:
        """Of a store that is there always; modules tell of one that they cannot use."""
        if self._stores is None or self._config is None or self._config.store.enabled is not True or self._only:
            return None
        trouble = self._stores.trouble()
        return Health("waiting" if trouble else "running", trouble)

    def _sections(self, config: Config) -> dict[str, Section]:
        sections = config.hosted
        return {self._only: sections[self._only]} if self._only in sections else {} if self._only else sections

    def _start(self, name: str, section: Section, config: Config, registry: Registry, stores: StoreService) -> None:
        try:
            kind = kind_of(name, section)
        except RuntimeError as err:
            _log.error("%s", err)
            return
        self._running[name] = Running(kind, name, section, config, registry, stores)
        self._running[name].start()


def _words(name: str, health: Health) -> str:
    words = " ".join(filter(None, ("" if health.state == "running" else health.state, health.text)))
    return f"{name}: {words}" if words else name
