"""The worker that serves metrics without the console: its server, and nothing of its pages."""

from __future__ import annotations

import logging
import os
import secrets
from typing import Any

import psutil

from bridge.config.model import Config
from bridge.config.sections.web import WebSection
from bridge.metrics.endpoint import MetricsRoutes
from bridge.metrics.link import HubLink
from bridge.web.access import Access
from bridge.web.serving import HttpServer
from bridge.web.tls import ServerTls
from bridge.worker import Health, Worker, costs

_log = logging.getLogger("midspan.metrics")


class MetricsWorker(Worker):
    """Answers Prometheus at an address of its own, under the console's rules where other machines reach it."""

    def __init__(self) -> None:
        self._config: Config | None = None
        self._server: HttpServer | None = None
        self._link: HubLink | None = None
        self._tls: ServerTls | None = None
        self._process = psutil.Process(os.getpid())

    def start(self, config: Config) -> None:
        """Open the server; raises `RuntimeError` where the address is taken, or not to be served like this."""
        self._config = config
        section = config.metrics
        if unguarded := section.unguarded(config.web):
            raise RuntimeError(f"metrics.listen: {unguarded}")
        self._link = HubLink(config, "metrics", self._status)
        self._tls = ServerTls(config) if section.reached else None
        # nobody logs in here, so no cookie fits
        access = Access(config.web if section.reached else WebSection(), secrets.token_bytes(32))
        routes = MetricsRoutes(config, self._link.ask).routes
        self._server = HttpServer(
            section.listen, routes, access, self._tls, what="the worker metrics", key="metrics.listen"
        )
        self._server.start()
        self._process.cpu_percent()
        _log.info("metrics are at %smetrics", self._server.address)

    def reload(self, config: Config) -> bool:
        """A scrape that is missed costs nothing, so a new start is all that is needed."""
        return config == self._config

    def health(self) -> Health:
        """Where it is; joins the hub where it has not yet."""
        assert self._server is not None
        assert self._link is not None
        if self._tls is not None:
            self._tls.look()
        if self._server.trouble:
            raise RuntimeError(self._server.trouble)
        self._link.look()
        return Health("running", "; ".join(filter(None, (f"{self._server.address}metrics", self._link.trouble))))

    def stop(self) -> None:
        """Close the server and the session."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
        if self._link is not None:
            self._link.close()

    def _status(self) -> dict[str, Any]:
        server = self._server
        return {
            "side": "metrics", "state": "running", "text": "" if server is None else f"{server.address}metrics",
            "pid": os.getpid(), **costs(self._process),
        }  # fmt: skip
