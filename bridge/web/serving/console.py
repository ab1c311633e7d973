"""The console's server: the page's files, the map's images, the socket, metrics for Prometheus."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from typing import Any, Protocol

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket

from bridge.web.serving.access import Access, Grant
from bridge.web.serving.login import Login, address_of
from bridge.web.serving.page_files import PageFiles, Tab
from bridge.web.serving.server import HttpServer
from bridge.web.serving.tls import ServerTls

PROTOCOL = "midspan.console.1"
MOST_PAGES, MOST_PAGES_OF_ADDRESS = 50, 25
MOST_BYTES = 64 * 1024
"""Maximum size of a page's message."""

Serve = Callable[[WebSocket, Grant], Awaitable[None]]


class Pictures(Protocol):
    """The images of a map."""

    def get(self, name: str, version: str, *, dark: bool = False) -> bytes | None:
        """Return the PNG at an address, in the colors for dark or light pages; None if it has expired."""


class WebServer(HttpServer):
    """The console's HTTP server.

    Args:
        listen: address and port.
        serve: runs the protocol with a page until its socket closes.
        tabs: the views of the page.
        pictures: the images of the map.
        access: authentication of clients.
        tls: certificate and key; None without TLS.
        more: routes in addition to the page's.
        names: further names by which browsers open the console.
    """

    def __init__(
        self, listen: str, serve: Serve, tabs: Sequence[Tab], pictures: Pictures, access: Access,
        tls: ServerTls | None = None, more: Sequence[BaseRoute] = (), names: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self._serve, self._pictures = serve, pictures
        self._pages: Counter[str] = Counter()
        routes = [
            WebSocketRoute("/socket", self._page),
            *Login(access).routes,
            Route("/map/{name:str}.png", self._picture),
            *more,
            *PageFiles(tabs).routes,
        ]
        super().__init__(
            listen, routes, access, tls, what="the console", key="web.listen", names=names, most_bytes=MOST_BYTES
        )

    @property
    def pages(self) -> int:
        """Number of open sockets."""
        return self._pages.total()

    async def _picture(self, request: Request) -> Response:
        query = request.query_params
        png = self._pictures.get(request.path_params["name"], query.get("v", ""), dark="dark" in query)
        if png is None:
            return PlainTextResponse("this image has expired; the feed 'map' has the address of the newest one\n", 404)
        return Response(png, media_type="image/png", headers={"cache-control": "private, max-age=86400, immutable"})

    async def _page(self, page: WebSocket) -> None:
        address = address_of(page.scope)
        refused = None
        if PROTOCOL not in page.scope.get("subprotocols", ()):
            refused = PlainTextResponse(f"the subprotocol must be {PROTOCOL}\n", 400)
        elif self._pages.total() >= MOST_PAGES or self._pages[address] >= MOST_PAGES_OF_ADDRESS:
            refused = PlainTextResponse(
                f"too many pages: the limits are {MOST_PAGES} in total and {MOST_PAGES_OF_ADDRESS} per address\n", 503
            )
        if refused is not None:
            await page.send_denial_response(refused)
            return
        grant: Grant = page.scope["state"]["grant"]
        self._pages[address] += 1
        try:
            await page.accept(PROTOCOL)
            async with asyncio.timeout(grant.until - time.time() if grant.until else None):
                await self._serve(page, grant)
        except TimeoutError:  # the login has expired
            await page.close(1008)
        finally:
            self._pages[address] -= 1
            if not self._pages[address]:
                del self._pages[address]


def hello(daemon: str, version: str, frame: str, most: tuple[float, float], hold_seconds: float) -> dict[str, Any]:
    """Return the first message to a page, without the page's role and name."""
    speed = {"x": most[0], "y": most[0], "turn": most[1]}
    head = {"op": "hello", "daemon": daemon, "version": version, "frame": frame}
    return {**head, "hold_seconds": hold_seconds, "speed": speed}
