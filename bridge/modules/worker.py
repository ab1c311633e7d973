"""The worker that hosts the modules."""

from __future__ import annotations

import logging
import sys
import time
from threading import Event
from typing import Any

from typing_extensions import override

from bridge.concurrency import Backoff
from bridge.config.model import Config
from bridge.config.sections.section import Section
from bridge.hub import listeners, opening
from bridge.hub.errors import HubError
from bridge.messages.errors import MessageError
from bridge.messages.registry import Registry
from bridge.modules.failures import FailureReports
from bridge.modules.host import Host
from bridge.modules.module import Module, kind_of
from bridge.modules.ports import ports_stay
from bridge.modules.shared import Shared
from bridge.modules.step_failures import described
from bridge.progress import working
from bridge.status import ModuleStatus, Part
from bridge.stores.entry import StoreError
from bridge.stores.store import Store
from bridge.worker import Health, StatusHead, Worker

_log = logging.getLogger(__name__)
_START_SECONDS = 30.0  # a start that makes no progress for this time has failed, because a dependency is missing
WIND_DOWN_SECONDS = 2.0
"""Seconds for a module to stop its robot before the module is stopped; `bridge.daemon.supervisor` allows 2.8 s."""

STOP_SECONDS = 1.0
"""Seconds for a module's thread to begin to stop the module; after that, its host is closed nevertheless."""

_SILENCE = 60.0  # seconds before the same failure is logged again


class Running:
    """A module that the configuration enables, and its host."""

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
        self._names: dict[str, Any] = {"daemon": config.name, "worker": name, "module": True}
        self._head = StatusHead(self._names)
        self._host: Host | None = None
        self._module: Module | None = None
        self._winding_down: tuple[Event, float] | None = None  # set when the robot is at rest; time of the limit

    @property
    def host(self) -> Host:
        """The host of the current run; raises `RuntimeError` if the module is not running."""
        if self._host is None:
            raise RuntimeError(f"{self.name} is not running: {self._trouble or 'stopped'}")
        return self._host

    @property
    def module(self) -> Module:
        """The module object of the current run; raises `RuntimeError` if the module is not running."""
        if self._module is None:
            raise RuntimeError(f"{self.name} is not running: {self._trouble or 'stopped'}")
        return self._module

    @property
    def trouble(self) -> str:
        """Why the module could not be started, "" if it could."""
        return self._trouble

    def start(self) -> None:
        """Start the module; if that fails, `health` retries it later."""
        self._started = time.monotonic()
        self._head = StatusHead(self._names)
        working.at(f"starting the module {self.name}")
        try:
            host = self._host = Host(self.name, self._config, self._registry, self._shared)
            module = self._module = self._kind()
            host.loop.failures.on_failure = lambda error: self._on_step_failure(module, host, error)
            host.loop.start()
            host.loop.work(lambda: module.start(host, self.section), _START_SECONDS)
            host.answer("status", self._status)
            host.loop.every(1.0, host.tick)
        except (RuntimeError, HubError, MessageError, OSError, TimeoutError) as err:
            self._on_failure(str(err) or type(err).__name__)
        except Exception as err:
            _log.exception("%s", self.name)
            self._on_failure(f"{type(err).__name__}: {err}")
        else:
            self._trouble = ""

    def adopt_releases(self, config: Config) -> None:
        """Apply the YARP generations of a new configuration with the same network, without a restart."""
        self._config = config
        if self._host is not None:
            self._host.yarp.generations.adopt(config.yarp.generations())

    def reload(self, section: Section, config: Config) -> None:
        """Apply a new section; restart the module if it cannot reload."""
        self.section, self._config = section, config
        module, host = self._module, self._host
        if module is not None and host is not None and not self._trouble:
            try:
                if host.loop.work(lambda: module.reload(section)):
                    return
            except Exception:
                _log.exception("%s: reload failed, restarting the module", self.name)
        self.stop()
        self.start()

    def health(self) -> Health:
        """Return the module's health; retry a failed start when due. Raises `TimeoutError` if the module hangs."""
        if self._trouble:
            if time.monotonic() >= self._again:
                self.start()
            return Health("waiting", self._trouble) if self._trouble else Health("running", "")
        host, module = self._host, self._module
        if host is None or module is None:
            return Health("waiting", "stopped")
        self._computes = host.loop.computes()
        opening.check_pool()
        health = self._module_health(module)
        return Health(health.state, "; ".join(filter(None, (self._computes, health.text, host.yarp.trouble()))))

    def begin_stop(self, *, started: bool = True) -> None:
        """Let the module begin to stop, without waiting for it as `stop` does. Safe to call twice.

        A module that has not ``started`` may lack what it stops; its errors are logged at the level debug.
        """
        module, host = self._module, self._host
        if module is None or host is None or self._winding_down is not None:
            return
        done = Event()
        self._winding_down = done, time.monotonic() + WIND_DOWN_SECONDS

        def begin() -> None:
            try:
                module.begin_stop(done.set)
            except Exception:
                self._log_stop(started=started)
                done.set()

        host.loop.post(begin)

    def stop(self, *, started: bool = True) -> None:
        """Stop the module and close its endpoints; ``started`` as in `begin_stop`. Safe to call twice."""
        self.begin_stop(started=started)
        module, self._module = self._module, None
        host, self._host = self._host, None
        winding_down, self._winding_down = self._winding_down, None
        if module is not None and host is not None and winding_down is not None:
            done, end = winding_down
            try:
                done.wait(max(end - time.monotonic(), 0.0))
                host.loop.call(lambda: _end(module, host), seconds=STOP_SECONDS)
            except Exception:
                self._log_stop(started=started)
        if host is not None:
            host.close()

    def _log_stop(self, *, started: bool) -> None:
        _log.log(logging.ERROR if started else logging.DEBUG, "%s: error while stopping", self.name, exc_info=True)

    def _module_health(self, module: Module) -> Health:
        """Return the health that the module reports; an exception in the report must not affect other modules."""
        try:
            return module.health()
        except Exception as err:
            now = time.monotonic()
            if now >= self._silent:
                self._silent = now + _SILENCE
                _log.exception("%s: health check failed", self.name)
            return Health("waiting", f"health check failed: {type(err).__name__}: {err}")

    def _on_step_failure(self, module: Module, host: Host, error: BaseException) -> None:
        if not module.on_failure(error):
            host.node.fail_goals(f"{self.name} failed: {described(error)}")

    def _reports(self, module: Module) -> tuple[dict[str, Any], list[str]]:
        """Return the module's own keys and warnings; an exception there must not hide the rest of the status."""
        try:
            own = module.status()
            # modules of other packages may return a dictionary
            return dict(own.document() if isinstance(own, Part) else own), list(module.warnings())
        except Exception as err:
            return {}, [f"the module's status failed: {described(err)}"]

    def _on_failure(self, why: str) -> None:
        self.stop(started=False)
        pause = self._backoff.pause(time.monotonic() - self._started)
        self._trouble, self._again = why, time.monotonic() + pause
        _log.error("%s cannot start: %s; retrying in %.0f s", self.name, why, pause)

    def _status(self, _params: dict[str, Any]) -> dict[str, Any]:
        module, host = self._module, self._host
        if module is None or host is None:
            return ModuleStatus(**self._names, state="stopped", routes=[]).document()
        health = self._module_health(module)
        own, warnings = self._reports(module)
        text = "; ".join(filter(None, (self._computes, health.text)))
        failures = host.loop.failures.warning()
        troubles = failures, host.yarp.trouble(), host.clock.trouble(), opening.trouble(), listeners.trouble()
        status = ModuleStatus(
            **self._head.fields(health.state, text, refused=[]),
            zid=host.node.hub.zid,
            routes=[],
            warnings=[text for text in (*warnings, *troubles) if text],
            **host.status(),
        )
        return {**status.document(), **own}


def _end(module: Module, host: Host) -> None:
    """Stop the module and its loop in one step, so that no timer or goal runs between the two."""
    try:
        module.stop()
    finally:
        host.loop.close()


SWITCH_INTERVAL = 0.0005
"""Seconds after which a computing thread yields the interpreter to a thread that has a message to handle."""

_FIXED = ("name", "state", "hub", "types", "limits", "clock")


class ModulesWorker(Worker):
    """Runs the modules that the configuration enables, or a single one.

    Args:
        only: name of the single module that this process runs, "" for all.
    """

    def __init__(self, only: str = "") -> None:
        self._only = only
        self._config: Config | None = None
        self._registry: Registry | None = None
        self._shared: Shared | None = None
        self._running: dict[str, Running] = {}
        self._unusable: dict[str, str] = {}
        self._failures: FailureReports | None = None

    @override
    def start(self, config: Config) -> None:
        """Start the modules; if one fails, the others are started nevertheless."""
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._config = config
        self._registry = Registry.of(config.types)
        self._shared = Shared(config, self._only)
        self._failures = FailureReports(config.name, self._shared.join)
        for name, section in self._sections(config).items():
            self._start(name, section, config, self._registry, self._shared)

    @override
    def reload(self, config: Config) -> bool:
        """Start, stop and reload the modules whose configuration changed."""
        old, registry, shared = self._config, self._registry, self._shared
        if old is None or registry is None or shared is None or not ports_stay(config, old):
            return False
        if any(getattr(config, part) != getattr(old, part) for part in _FIXED):
            return False
        if list(config.store) != list(old.store):  # only the keys, without the contents of the files that they name
            return False
        self._config = config
        if config.store != old.store:
            shared.stores.import_again()
        logging.getLogger().setLevel(config.log.level.upper())
        sections = self._sections(config)
        self._unusable.clear()
        for name in self._running.keys() - sections.keys():
            self._running.pop(name).stop()
        for name, section in sections.items():
            running = self._running.get(name)
            if running is None:
                self._start(name, section, config, registry, shared)
                continue
            running.adopt_releases(config)
            if running.section != section:
                running.reload(section, config)
        return True

    def running(self, name: str) -> Running:
        """Return an enabled module, for programs that host this worker in their process; raises `KeyError`."""
        return self._running[name]

    @property
    def store(self) -> Store:
        """The store that all modules of this process share; raises `StoreError` if it is unavailable."""
        if self._shared is None:
            raise StoreError("the worker has not started")
        return self._shared.stores.store

    @override
    def health(self) -> Health:
        """Combine the modules' health; the worker is running if any module is."""
        reports = {name: running.health() for name, running in self._running.items()}
        troubles = {**self._unusable, **{n: running.trouble for n, running in self._running.items() if running.trouble}}
        reports |= {name: Health("waiting", trouble) for name, trouble in self._unusable.items()}
        store = self._store_health()
        if store is not None:
            reports["store"] = store
            troubles |= {"store": store.text} if store.state != "running" else {}
        if self._failures is not None:
            self._failures.show(troubles)
        if not reports:
            return Health("waiting", "no module is enabled")
        best = min(reports.values(), key=lambda health: health.state != "running")
        return Health(best.state, ", ".join(_describe(name, health) for name, health in reports.items()))

    @override
    def diagnostics_wanted(self) -> bool:
        return self._shared is not None and self._shared.diagnostics_wanted()

    @override
    def stop(self) -> None:
        for running in self._running.values():
            running.begin_stop()  # of all at once, because one whose thread is busy must not delay another's robot
        while self._running:
            self._running.popitem()[1].stop()
        if self._failures is not None:
            self._failures.close()
        if self._shared is not None:
            self._shared.close()

    def _store_health(self) -> Health | None:
        """Return the health of the store if ``store.enabled`` is true; else None, because its users report failures."""
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
            self._unusable[name] = str(err)
            return
        self._running[name] = Running(kind, name, section, config, registry, shared)
        self._running[name].start()


def _describe(name: str, health: Health) -> str:
    named = health.state == "running" or health.text.startswith(health.state)
    return ": ".join(filter(None, (name if named else f"{name} {health.state}", health.text)))
