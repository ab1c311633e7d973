"""One module in its host: starts it, starts it again when it failed, and says how it is."""

from __future__ import annotations

import logging
import os
import time
from typing import Any

import psutil

from bridge.backoff import Backoff
from bridge.config.model import Config
from bridge.config.sections.section import Section
from bridge.hub.errors import HubError
from bridge.messages.errors import MessageError
from bridge.messages.registry import Registry
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.stores.service import StoreService
from bridge.worker import Health, costs

_log = logging.getLogger(__name__)
_STUCK = 5.0
_SILENCE = 60.0
"""Seconds between two lines in the log that tell of the same."""


class Running:
    """A module and its host, while its section says that it runs.

    Args:
        kind: the module's class.
        name: its name on the hub.
        section: its section of the configuration.
        config: the whole configuration.
        registry: of types.
        stores: the process's store, where it has one.
    """

    def __init__(
        self,
        kind: type[Module],
        name: str,
        section: Section,
        config: Config,
        registry: Registry,
        stores: StoreService | None = None,
    ) -> None:
        self.name, self.section = name, section
        self._kind, self._config, self._registry, self._stores = kind, config, registry, stores
        self._backoff = Backoff()
        self._again = 0.0
        self._trouble = ""
        self._silent = 0.0
        self._started = time.monotonic()
        self._process = psutil.Process()
        self._host: Host | None = None
        self._module: Module | None = None

    def start(self) -> None:
        """Start the module; where it fails, it is tried again later (`health`)."""
        self._started = time.monotonic()
        try:
            host = self._host = Host(self.name, self._config, self._registry, self._stores)
            module = self._module = self._kind()
            host.loop.start()
            host.loop.call(lambda: module.start(host, self.section), seconds=30.0)
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

    def reload(self, section: Section, config: Config) -> None:
        """Take up another section."""
        self.section, self._config = section, config
        module, host = self._module, self._host
        if module is not None and host is not None and not self._trouble:
            try:
                if host.loop.call(lambda: module.reload(section)):
                    return
            except Exception:
                _log.exception("%s cannot take up its new configuration", self.name)
        self.stop()
        self.start()

    def health(self) -> Health:
        """How the module is; starts it again where it failed and it is time."""
        if self._trouble:
            if time.monotonic() >= self._again:
                self.start()
            return Health("waiting", self._trouble) if self._trouble else Health("running", "")
        host, module = self._host, self._module
        if host is None or module is None:
            return Health("waiting", "stopped")
        if host.loop.stuck_for() > _STUCK:
            msg = f"{self.name} has been in one step for {host.loop.stuck_for():.1f} s"
            raise TimeoutError(msg)
        health = self._word(module)
        trouble = host.yarp.trouble()
        return Health(health.state, "; ".join(filter(None, (health.text, trouble))))

    def stop(self) -> None:
        """Stop the module and close its ends. Safe to call twice."""
        module, self._module = self._module, None
        host, self._host = self._host, None
        if module is not None and host is not None:
            try:
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
            "text": health.text,
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
