"""The console's HTTP server: the page's files, the map's pictures, the socket. It answers this page alone.

A strange page in the operator's browser must not drive a robot: each request's ``Host`` is one that this server has
(which keeps out names that are made to point here), and a socket's ``Origin`` is this server's own page (OWASP, "DNS
rebinding" and "Cross-site WebSocket hijacking").
"""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from bridge.config.sections.web import split
from bridge.web.access import Access, Grant
from bridge.web.connections import (
    MOST_CONNECTIONS,
    BoundedListener,
    BoundedWebSocket,
    ScarceLog,
    ServerLoop,
    TimedHttp,
    quiet_server_log,
)
from bridge.web.login import STATIC, Login, LoginGuard, address_of
from bridge.web.map_pictures import Pictures
from bridge.web.page import MOST_BYTES
from bridge.web.tls import ServerTls

_log = logging.getLogger("midspan.web")

PROTOCOL = "midspan.console.1"
MOST_PAGES, MOST_PAGES_OF_ADDRESS = 50, 25
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self';"
        " font-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-cache",
}
_START_SECONDS = 10.0
_STOP_SECONDS = 1.5
_NAMES = ("localhost", "127.0.0.1", "[::1]")

Serve = Callable[[WebSocket, Grant], Awaitable[None]]


class OwnOnly:
    """Lets requests through that name this server as their host, sockets only from this server's own page."""

    def __init__(self, app: ASGIApp, hosts: Callable[[], frozenset[str]]) -> None:
        self._app, self._hosts = app, hosts
        self._refused = ScarceLog()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve or refuse one request."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        why = refusal(scope, self._hosts())
        if not why:
            await self._app(scope, receive, _with_headers(send))
            return
        self._refused.warn(f"a request from {(scope.get('client') or ('?',))[0]} is refused: {why}")
        answer = PlainTextResponse(f"{why}\n", 403, HEADERS)
        if scope["type"] == "websocket":
            await WebSocket(scope, receive, send).send_denial_response(answer)
        else:
            await answer(scope, receive, send)


def refusal(scope: Scope, hosts: frozenset[str]) -> str:
    """Why a request is not answered, "" where it is."""
    found: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        found.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    host, origin = found.get("host", []), found.get("origin", [])
    if len(host) != 1 or host[0].lower() not in hosts:
        return f"no such host here: {', '.join(host)[:80]!r}"
    own = f"{'https' if scope.get('scheme') in ('https', 'wss') else 'http'}://{host[0].lower()}"
    if any(each.lower() != own for each in origin):
        return f"a page of {', '.join(origin)[:80]!r} may not ask"
    if scope["type"] == "websocket" and not origin and "user-agent" in found and "Mozilla" in found["user-agent"][0]:
        return "a browser that does not say which page asks"
    if found.get("sec-fetch-site", ["same-origin"])[0] not in ("same-origin", "none"):
        return "another site's page may not ask"
    return ""


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            names = {name.lower() for name, _ in message.get("headers", ())}
            added = [(k.encode(), v.encode()) for k, v in HEADERS.items() if k.encode() not in names]
            message["headers"] = [*message.get("headers", ()), *added]
        await send(message)

    return sending


class WebServer:
    """Serves on a thread of its own.

    Args:
        listen: address and port.
        serve: converses with a page until its socket ends.
        access: who may come in.
        tls: where it has TLS.
    """

    def __init__(
        self, listen: str, serve: Serve, pictures: Pictures, access: Access, tls: ServerTls | None = None
    ) -> None:
        self._serve, self._pictures, self._access = serve, pictures, access
        address, port = split(listen)
        self._pages: Counter[str] = Counter()
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        self._socket = BoundedListener(family)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((address, port))
            self._socket.listen(128)  # who comes before the server turns waits
        except OSError as err:
            self._socket.close()
            raise RuntimeError(f"the console cannot listen on {listen}: {err.strerror}; set web.listen") from None
        self.port: int = self._socket.getsockname()[1]
        names = [bracketed(name) for name in (tls.names if tls else (address,))]
        self._hosts = hosts(names, self.port, tls=tls is not None)
        self.address = f"{'https' if tls else 'http'}://{names[0]}:{self.port}/"
        self._server = uvicorn.Server(
            uvicorn.Config(
                self._app(), log_config=None, access_log=False, lifespan="off", ws_max_size=MOST_BYTES,
                limit_concurrency=MOST_CONNECTIONS, timeout_graceful_shutdown=1, server_header=False,
                h11_max_incomplete_event_size=16 * 1024, timeout_keep_alive=5, http=TimedHttp, ws=BoundedWebSocket,
                proxy_headers=False,
            )
        )  # fmt: skip
        self._server.config.load()
        self._server.config.ssl = tls.context if tls else None
        self._server.install_signal_handlers = lambda: None  # type: ignore[attr-defined]
        self._thread = threading.Thread(target=self._run, name="midspan-web-server", daemon=True)
        self._trouble = ""

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    @property
    def trouble(self) -> str:
        """Why it does not serve, "" where it does."""
        return self._trouble or ("" if self._thread.is_alive() else "the server has ended")

    @property
    def pages(self) -> int:
        """How many sockets are open."""
        return self._pages.total()

    def close(self) -> None:
        """Close every socket and end the thread."""
        self._server.should_exit = True
        self._server.force_exit = True
        if self._thread.is_alive():
            self._thread.join(_STOP_SECONDS)
        self._socket.close()

    def _run(self) -> None:
        quiet_server_log()
        try:
            with asyncio.Runner(loop_factory=ServerLoop) as runner:
                runner.run(self._server.serve([self._socket]))
        except Exception as err:
            _log.exception("the server")
            self._trouble = f"{type(err).__name__}: {err}"

    def _app(self) -> ASGIApp:
        routes = [
            WebSocketRoute("/socket", self._page),
            *Login(self._access).routes,
            Route("/map/{name:str}.png", self._picture),
            Route("/", self._index),
            Mount("/", StaticFiles(directory=STATIC)),
        ]
        return OwnOnly(LoginGuard(Starlette(routes=routes), self._access), lambda: self._hosts)

    async def _index(self, _request: Request) -> Response:
        return Response((STATIC / "index.html").read_bytes(), media_type="text/html; charset=utf-8")

    async def _picture(self, request: Request) -> Response:
        asked = request.query_params
        found = self._pictures.get(request.path_params["name"], asked.get("v", ""), dark="dark" in asked)
        if found is None:
            return PlainTextResponse("this picture is gone; the feed 'map' says the address of the newest\n", 404)
        return Response(found, media_type="image/png", headers={"cache-control": "private, max-age=86400, immutable"})

    async def _page(self, page: WebSocket) -> None:
        address = address_of(page.scope)
        refused = None
        if PROTOCOL not in page.scope.get("subprotocols", ()):
            refused = PlainTextResponse(f"the subprotocol is {PROTOCOL}\n", 400)
        elif self._pages.total() >= MOST_PAGES or self._pages[address] >= MOST_PAGES_OF_ADDRESS:
            refused = PlainTextResponse(
                f"{MOST_PAGES} pages may be open, {MOST_PAGES_OF_ADDRESS} of one address\n", 503
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
        except TimeoutError:  # the login has ended
            await page.close(1008)
        finally:
            self._pages[address] -= 1
            if not self._pages[address]:
                del self._pages[address]


def hosts(names: Sequence[str], port: int, *, tls: bool) -> frozenset[str]:
    """What a request's ``Host`` may be; the scheme's own port is left out by browsers."""
    own = {name.lower() for name in (*_NAMES, *names)}
    return frozenset({f"{name}:{port}" for name in own} | (own if port == (443 if tls else 80) else set()))


def bracketed(name: str) -> str:
    """A name or an address as it stands in an URL."""
    return f"[{name}]" if ":" in name else name


def hello(daemon: str, version: str, frame: str, most: tuple[float, float], hold_seconds: float) -> dict[str, Any]:
    """The first message to a page, but for who it is."""
    speed = {"x": most[0], "y": most[0], "turn": most[1]}
    head = {"op": "hello", "daemon": daemon, "version": version, "frame": frame}
    return {**head, "hold_seconds": hold_seconds, "speed": speed}
