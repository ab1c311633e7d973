"""The worker that serves metrics without the console."""

from __future__ import annotations

import logging
import secrets
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from bridge.config.model import Config
from bridge.hub.diagnostics import announce, has_subscribers
from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from bridge.metrics.endpoint import MetricsRoutes
from bridge.metrics.link import HubLink
from bridge.metrics.section import MetricsSection
from bridge.metrics.source import Source
from bridge.status import WorkerStatus
from bridge.web.section import WebSection
from bridge.web.serving.access import Access
from bridge.web.serving.server import HttpServer
from bridge.worker import Health, StatusHead, Worker

if TYPE_CHECKING:
    from bridge.web.serving.tls import ServerTls

_log = logging.getLogger("midspan.metrics")


class MetricsWorker(Worker):
    """Serves metrics at a separate address, with the console's authentication if other machines reach the address.

    Attributes:
        server: the HTTP server, while it runs.
    """

    def __init__(self) -> None:
        self._config: Config | None = None
        self.server: HttpServer | None = None
        self._link: HubLink | None = None
        self._tls: ServerTls | None = None
        self._hub: Hub | None = None
        self._head = StatusHead({"side": "metrics"}, uptime=False)

    @override
    def start(self, config: Config) -> None:
        """Open the server; raises `RuntimeError` if the address is in use, or needs authentication that is missing."""
        self._config = config
        section, web = config.section(MetricsSection), config.section(WebSection)
        if conflict := section.conflict(config):
            raise RuntimeError(f"metrics.listen: {conflict}")
        self._link = HubLink(config, "metrics", self._status)
        if section.reached:
            from bridge.web.serving.tls import ServerTls  # not imported on loopback, to save memory

            self._tls = ServerTls(config)
        # without a login page, no cookie is valid
        web = web.model_copy(update={"prefix": ""})
        access = Access(web if section.reached else WebSection(), secrets.token_bytes(32))
        routes = MetricsRoutes(config, Source(config, self._link.ask)).routes
        self.server = HttpServer(
            section.listen, routes, access, self._tls, what="the worker metrics", key="metrics.listen", names=web.names
        )  # fmt: skip
        self.server.start()
        _log.info("metrics are at %smetrics", self.server.address)

    @override
    def reload(self, config: Config) -> bool:
        """Return whether nothing changed; otherwise the worker restarts, which loses at most one scrape."""
        return config == self._config

    @override
    def health(self) -> Health:
        """Return the address, and join the hub if necessary; raises `RuntimeError` if the server has ended."""
        assert self.server is not None
        assert self._link is not None
        assert self._config is not None
        if self._tls is not None:
            self._tls.refresh()
        if self.server.trouble:
            raise RuntimeError(self.server.trouble)
        hub = self._link.join()
        if hub is not None and self._hub is None and self._config.section(MetricsSection).diagnostics:
            announce(hub, Registry())
            self._hub = hub
        return Health("running", "; ".join(filter(None, (f"{self.server.address}metrics", self._link.trouble))))

    @override
    def diagnostics_wanted(self) -> bool:
        return self._hub is not None and has_subscribers(self._hub.graph)

    @override
    def stop(self) -> None:
        server, self.server = self.server, None
        if server is not None:
            server.close()
        self._hub = None
        if self._link is not None:
            self._link.close()

    def _status(self) -> dict[str, Any]:
        server = self.server
        return WorkerStatus(
            **self._head.fields("running", "" if server is None else f"{server.address}metrics")
        ).document()
