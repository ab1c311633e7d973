"""Opens the router for other machines, retries if that fails, and opens a new one for new certificates."""

from __future__ import annotations

import contextlib
import logging
import time
from dataclasses import asdict

import zenoh

from bridge.clock import steady
from bridge.config.model import Config
from bridge.config.rules import commands
from bridge.hub.errors import HubError
from bridge.hub.security.endpoints import closed_endpoints
from bridge.hub.security.external_router import ExternalRouter, has_tls, key_files
from bridge.hub.security.key_watch import KeyWatch
from bridge.hub.security.zenoh_log import ZenohLog
from bridge.status import EndpointStatus, MachineStatus, RouterStatus

_log = logging.getLogger(__name__)
_RETRY_SECONDS = 5.0
_REOPEN_SECONDS = 0.3
"""Pause before the next router, in seconds; a router that replaces another within 0.1 s gets no subscriptions."""


class ExternalAccess:
    """The access of other machines through ``hub.open``; if that is not set, all methods do nothing.

    Attributes:
        router: the router, None while it cannot be opened.
        trouble: why it cannot be opened, or "".
    """

    def __init__(self, zenoh_log: ZenohLog | None) -> None:
        self.router: ExternalRouter | None = None
        self.trouble = ""
        self._zenoh_log = zenoh_log
        self._keys: KeyWatch | None = None
        self._since, self._retry_at = steady(), 0.0

    def open(self, config: Config) -> None:
        """Open the router; if that fails, log the reason once, and retry in `check`."""
        if not config.hub.open.opened:
            return
        try:
            self._keys = KeyWatch(key_files(config)) if has_tls(config.hub.open) else None
            self.router = ExternalRouter(config, self._zenoh_log)
        except HubError as err:
            if str(err) != self.trouble:
                _log.error("hub.open: %s", err)
                self._since = steady()
            self.trouble = str(err)
            self._retry_at = time.monotonic() + _RETRY_SECONDS
            return
        self.trouble = ""
        if config.hub.open.insecure:
            _log.warning(
                "hub.open.insecure: any program that reaches %s may join the hub", ", ".join(config.hub.open.listen)
            )

    def check(self, config: Config) -> None:
        """Retry opening the router, or open a new one if there are new certificates; called at each health check."""
        if self.router is None and time.monotonic() > self._retry_at:
            self.open(config)
        elif self._keys is not None and self._keys.renewed():
            _log.info("hub.open: reopening with the new certificates")
            self.reopen(config)

    def reopen(self, config: Config) -> None:
        """Close the router, and open a router with this configuration."""
        was_open = self.router is not None
        self.close()
        if was_open:
            time.sleep(_REOPEN_SECONDS)
        self.open(config)

    def close(self) -> None:
        """Close the router. Safe to call twice."""
        router, self.router = self.router, None
        self._keys = None
        self.trouble, self._retry_at, self._since = "", 0.0, steady()
        if router is not None:
            router.close()

    def warning(self) -> str:
        """Return why the router cannot be opened, check its links or use new certificates; "" if it works."""
        router, keys = self.router, self._keys
        trouble = self.trouble or ("" if router is None else router.trouble) or ("" if keys is None else keys.trouble)
        return f"hub.open: {trouble}" if trouble else ""

    def text(self) -> str:
        """Return the part of the worker's status text about other machines, "" if ``hub.open`` is not set."""
        if self.trouble:
            return f"; closed to other machines: {self.trouble}"
        if self.router is None:
            return ""
        bad = [f"; {status}" for status in self.router.endpoints() if not status.good]
        return f"; {len(self.router.machines())} other machines{''.join(bad)}"

    def status(self, config: Config) -> RouterStatus:
        """Return the other machines, the endpoints through which they join, and the commands that need ``trusted``."""
        router = self.router  # meanwhile, the worker's main thread may close the router and open another one
        if router is not None:
            with contextlib.suppress(zenoh.ZError):
                return RouterStatus(
                    door=router.zid,
                    machines=[MachineStatus(**asdict(machine)) for machine in router.machines()],
                    endpoints=[EndpointStatus(**asdict(endpoint)) for endpoint in router.endpoints()],
                    refused_connections=router.refused(),
                    commands={name: sorted(parts) for name, parts in commands(config.rules).items()},
                )
        section = config.hub.open
        closed = closed_endpoints(section.listen, section.connect, self.trouble, self._since)
        return RouterStatus(machines=[], endpoints=[EndpointStatus(**asdict(endpoint)) for endpoint in closed])
