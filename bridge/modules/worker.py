"""The worker that hosts the modules."""

from __future__ import annotations

import logging
import os
import sys
import time
from threading import Event
from typing import Any

import psutil

from bridge.concurrency import Backoff
from bridge.config.model import Config
from bridge.config.sections.section import Section
from bridge.hub.errors import HubError
from bridge.messages.errors import MessageError
from bridge.messages.registry import Registry
from bridge.modules.host import Host
from bridge.modules.module import Module, kind_of
from bridge.modules.shared import Shared
from bridge.progress import working
from bridge.stores.entry import StoreError
from bridge.stores.store import Store
from bridge.worker import Health, Worker, costs

_log = logging.getLogger(__name__)
_START_SECONDS = 30.0  # a module that stands still for longer as it starts has failed: what it waits for does not come
WIND_DOWN_SECONDS = 2.0
"""A module has this time to bring its robot to rest before it is stopped; `bridge.daemon.supervisor` allows 3.3 s."""

_SILENCE = 60.0  # seconds between two lines in the log that tell of the same


class Running:
    """A module and its host, while its section says that it runs."""

    def __init__(
        self,
        kind: type[Module],
        name: str,
        section: Section,
        config: Config,
        registry: Registry,
        shared: Shared | None = None,
    ) -> None:
        self.name, self.section = name, section
        self._kind, self._config, self._registry, self._shared = kind, config, registry, shared
        self._backoff = Backoff()
        self._again = 0.0
        self._trouble = ""
        self._silent = 0.0
        self._computes = ""
        self._started = time.monotonic()
        self._process = psutil.Process()
        self._host: Host | None = None
        self._module: Module | None = None

    @property
    def host(self) -> Host:
        """The host of this start; raises `RuntimeError` while the module does not run."""
        if self._host is None:
            raise RuntimeError(f"{self.name} does not run: {self._trouble or 'stopped'}")
        return self._host

    @property
    def module(self) -> Module:
        """The module of this start; raises `RuntimeError` while it does not run."""
        if self._module is None:
            raise RuntimeError(f"{self.name} does not run: {self._trouble or 'stopped'}")
        return self._module

    def start(self) -> None:
        """Start the module; where it fails, it is tried again later (`health`)."""
        self._started = time.monotonic()
        working.at(f"starting the module {self.name}")
        try:
            host = self._host = Host(self.name, self._config, self._registry, self._shared)
            module = self._module = self._kind()
            host.loop.start()
            host.loop.work(lambda: module.start(host, self.section), _START_SECONDS)
            host.acknowledge()
            host.answer("status", self._status)
            host.loop.every(1.0, host.tick)
        except (RuntimeError, HubError, MessageError, OSError, TimeoutError) as err:
            self._failed(str(err) or type(err).__name__)
        except Exception as err:
            _log.exception("%s", self.name)
            self._failed(f"{type(err).__name__}: {err}")
        else:
            self._trouble = ""

    def take_up_releases(self, config: Config) -> None:
        """Answer YARP programs as another configuration says, whose network is the same; nothing begins anew."""
        self._config = config
        if self._host is not None:
            self._host.yarp.generations.adopt(config.yarp.generations())

    def reload(self, section: Section, config: Config) -> None:
        """Take up another section."""
        self.section, self._config = section, config
        module, host = self._module, self._host
        if module is not None and host is not None and not self._trouble:
            try:
                if host.loop.work(lambda: module.reload(section)):
                    return
            except Exception:
                _log.exception("%s cannot take up its new configuration", self.name)
        self.stop()
        self.start()

    def health(self) -> Health:
        """How the module is; starts it again in time where it failed. Raises `TimeoutError` if it hangs."""
        if self._trouble:
            if time.monotonic() >= self._again:
                self.start()
            return Health("waiting", self._trouble) if self._trouble else Health("running", "")
        host, module = self._host, self._module
        if host is None or module is None:
            return Health("waiting", "stopped")
        self._computes = host.loop.computes()
        health = self._word(module)
        return Health(health.state, "; ".join(filter(None, (self._computes, health.text, host.yarp.trouble()))))

    def stop(self) -> None:
        """Stop the module and close its ends. Safe to call twice."""
        module, self._module = self._module, None
        host, self._host = self._host, None
        if module is not None and host is not None:
            try:
                done = Event()
                host.loop.call(lambda: module.begin_stop(done.set), seconds=1.0)
                done.wait(WIND_DOWN_SECONDS)
                host.loop.call(lambda: _end(module, host), seconds=1.0)
            except Exception:
                _log.exception("%s did not stop in good order", self.name)
        if host is not None:
            host.close()

    def _word(self, module: Module) -> Health:
        """What a module says of itself; one that fails at that keeps no other from being asked."""
        try:
            return module.health()
        except Exception as err:
            now = time.monotonic()
            if now >= self._silent:
                self._silent = now + _SILENCE
                _log.exception("%s cannot say how it is", self.name)
            return Health("waiting", f"it cannot say how it is: {type(err).__name__}: {err}")

    def _failed(self, why: str) -> None:
        self.stop()
        pause = self._backoff.pause(time.monotonic() - self._started)
        self._trouble, self._again = why, time.monotonic() + pause
        _log.error("%s cannot start: %s; tried again in %.0f s", self.name, why, pause)

    def _status(self, _params: dict[str, Any]) -> dict[str, Any]:
        module, host = self._module, self._host
        if module is None or host is None:
            return {"daemon": self._config.name, "worker": self.name, "module": True, "state": "stopped", "routes": []}
        health = self._word(module)
        return {
            "daemon": self._config.name,
            "worker": self.name,
            "module": True,
            "pid": os.getpid(),
            "zid": host.node.hub.zid,
            "state": health.state,
            "text": "; ".join(filter(None, (self._computes, health.text))),
            "uptime": round(time.monotonic() - self._started, 1),
            **costs(self._process),
            "routes": [],
            "refused": [],
            "warnings": list(filter(None, [host.yarp.trouble()])),
            **host.status(),
            **module.status(),
        }


def _end(module: Module, host: Host) -> None:
    """In one step: a timer or a goal that came before its ends are closed would go on without the module."""
    try:
        module.stop()
    finally:
        host.loop.close()


SWITCH_INTERVAL = 0.0005
"""Seconds after which a thread that only computes gives way to one that has a message."""

_FIXED = ("name", "state", "hub", "store", "types", "limits")


class ModulesWorker(Worker):
    """Runs the modules that the configuration switches on, or one of them alone.

    Args:
        only: the one module that this process runs, "" for all.
    """

    def __init__(self, only: str = "") -> None:
        self._only = only
        self._config: Config | None = None
        self._registry: Registry | None = None
        self._shared: Shared | None = None
        self._running: dict[str, Running] = {}

    def start(self, config: Config) -> None:
        """Start the modules; one that cannot start does not keep the others from it."""
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._config = config
        self._registry = Registry.of(config.types)
        self._shared = Shared(config, self._only)
        for name, section in self._sections(config).items():
            self._start(name, section, config, self._registry, self._shared)

    def reload(self, config: Config) -> bool:
        """Start, stop and change what the configuration says otherwise now."""
        old, registry, shared = self._config, self._registry, self._shared
        if old is None or registry is None or shared is None or not config.yarp.opens_as(old.yarp):
            return False
        if any(getattr(config, part) != getattr(old, part) for part in _FIXED):
            return False
        self._config = config
        logging.getLogger().setLevel(config.log.level.upper())
        sections = self._sections(config)
        for name in self._running.keys() - sections.keys():
            self._running.pop(name).stop()
        for name, section in sections.items():
            running = self._running.get(name)
            if running is None:
                self._start(name, section, config, registry, shared)
                continue
            running.take_up_releases(config)
            if running.section != section:
                running.reload(section, config)
        return True

    def running(self, name: str) -> Running:
        """A module that is switched on, for who runs the worker in a process of its own; raises `KeyError`."""
        return self._running[name]

    @property
    def store(self) -> Store:
        """The store of this process, that all its modules share; raises `StoreError` where it cannot be used."""
        if self._shared is None:
            raise StoreError("the worker has not started")
        return self._shared.stores.store

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

    def hears_diagnostics(self) -> bool:
        """See `Worker`."""
        return self._shared is not None and self._shared.hears_diagnostics()

    def stop(self) -> None:
        """Stop all modules."""
        while self._running:
            self._running.popitem()[1].stop()
        if self._shared is not None:
            self._shared.close()

    def _store_health(self) -> Health | None:
        """Of a store that is there always; modules tell of one that they cannot use."""
        if self._shared is None or self._config is None or self._config.store.enabled is not True or self._only:
            return None
        trouble = self._shared.stores.trouble()
        return Health("waiting" if trouble else "running", trouble)

    def _sections(self, config: Config) -> dict[str, Section]:
        sections = config.hosted
        return {self._only: sections[self._only]} if self._only in sections else {} if self._only else sections

    def _start(self, name: str, section: Section, config: Config, registry: Registry, shared: Shared) -> None:
        try:
            kind = kind_of(name, section)
        except RuntimeError as err:
            _log.error("%s", err)
            return
        self._running[name] = Running(kind, name, section, config, registry, shared)
        self._running[name].start()


def _words(name: str, health: Health) -> str:
    words = " ".join(filter(None, ("" if health.state == "running" else health.state, health.text)))
    return f"{name}: {words}" if words else name
