"""The worker that serves metrics without the console: its server, and nothing of its pages."""

from __future__ import annotations

import logging
import os
import secrets
from typing import TYPE_CHECKING, Any

import psutil

from bridge.config.model import Config
from bridge.config.sections.web import WebSection
from bridge.hub.diagnostics import announce, heard
from bridge.hub.session import Hub
from bridge.messages.registry import Registry
from bridge.metrics.endpoint import MetricsRoutes
from bridge.metrics.link import HubLink
from bridge.metrics.source import Source
from bridge.web.serving.access import Access
from bridge.web.serving.server import HttpServer
from bridge.worker import Health, Worker, costs

if TYPE_CHECKING:
    from bridge.web.serving.tls import ServerTls

_log = logging.getLogger("midspan.metrics")


class MetricsWorker(Worker):
    """Answers Prometheus at an address of its own, under the console's rules where other machines reach it.

    Attributes:
        server: while it runs.
    """

    def __init__(self) -> None:
        self._config: Config | None = None
        self.server: HttpServer | None = None
        self._link: HubLink | None = None
        self._tls: ServerTls | None = None
        self._hub: Hub | None = None
        self._process = psutil.Process(os.getpid())

    def start(self, config: Config) -> None:
        """Open the server; raises `RuntimeError` where the address is taken, or not to be served like this."""
        self._config = config
        section = config.metrics
        if unguarded := section.unguarded(config.web):
            raise RuntimeError(f"metrics.listen: {unguarded}")
        self._link = HubLink(config, "metrics", self._status)
        if section.reached:
            from bridge.web.serving.tls import ServerTls  # what it needs is memory that nobody needs on loopback

            self._tls = ServerTls(config)
        # nobody logs in here, so no cookie fits
        access = Access(config.web if section.reached else WebSection(), secrets.token_bytes(32))
        routes = MetricsRoutes(config, Source(config, self._link.ask)).routes
        self.server = HttpServer(
            section.listen, routes, access, self._tls, what="the worker metrics", key="metrics.listen"
        )
        self.server.start()
        self._process.cpu_percent()
        _log.info("metrics are at %smetrics", self.server.address)

    def reload(self, config: Config) -> bool:
        """A scrape that is missed costs nothing, so a new start is all that is needed."""
        return config == self._config

    def health(self) -> Health:
        """Where it is; joins the hub where it has not yet."""
        assert self.server is not None
        assert self._link is not None
        assert self._config is not None
        if self._tls is not None:
            self._tls.look()
        if self.server.trouble:
            raise RuntimeError(self.server.trouble)
        hub = self._link.join()
        if hub is not None and self._hub is None and self._config.metrics.diagnostics:
            announce(hub, Registry())
            self._hub = hub
        return Health("running", "; ".join(filter(None, (f"{self.server.address}metrics", self._link.trouble))))

    def hears_diagnostics(self) -> bool:
        """See `Worker`."""
        return self._hub is not None and heard(self._hub.graph)

    def stop(self) -> None:
        """Close the server and the session."""
        server, self.server = self.server, None
        if server is not None:
            server.close()
        self._hub = None
        if self._link is not None:
            self._link.close()

    def _status(self) -> dict[str, Any]:
        server = self.server
        return {
            "side": "metrics", "state": "running", "text": "" if server is None else f"{server.address}metrics",
            "pid": os.getpid(), **costs(self._process),
        }  # fmt: skip
