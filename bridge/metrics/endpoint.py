"""``/metrics``, ``/healthz`` and ``/readyz``, for the console's server and the separate metrics server."""

from __future__ import annotations

from prometheus_client import CollectorRegistry
from prometheus_client.exposition import choose_encoder
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from bridge.config.model import Config
from bridge.metrics.collector import MidspanCollector
from bridge.metrics.section import MetricsSection
from bridge.metrics.source import Readiness, Source


class MetricsRoutes:
    """HTTP routes whose handlers run on threads that may block.

    Args:
        config: the configuration.
        source: provides the status documents of this daemon's workers.

    Attributes:
        routes: the routes for an HTTP server.
    """

    def __init__(self, config: Config, source: Source) -> None:
        self._readiness = Readiness(config)
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(MidspanCollector(source, config.section(MetricsSection).routes))
        self.routes = [
            Route("/metrics", self._metrics),
            Route("/healthz", self._alive),
            Route("/readyz", self._ready),
        ]

    def _metrics(self, request: Request) -> Response:
        encode, content_type = choose_encoder(request.headers.get("accept", ""))
        return Response(encode(self._registry), headers={"content-type": content_type, "cache-control": "no-store"})

    def _alive(self, _request: Request) -> Response:
        return PlainTextResponse("alive\n", headers={"cache-control": "no-store"})

    def _ready(self, request: Request) -> Response:
        """Return 503 if something is not ready. Only authenticated clients see the reasons."""
        reasons = self._readiness.reasons()
        known = request.scope["state"]["grant"] is not None
        shown = reasons if known or not reasons else ["not ready; authenticate to see the reasons"]
        text = "\n".join(shown or ["ready"])
        return PlainTextResponse(f"{text}\n", 503 if reasons else 200, headers={"cache-control": "no-store"})
