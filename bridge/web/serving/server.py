"""An HTTP server with its own thread, for the console and for metrics. It refuses requests that other sites cause.

A foreign page in the operator's browser must not drive a robot: each request's ``Host`` must be one of this server's
names (against DNS rebinding), and a socket's ``Origin`` must be this server's own page (against cross-site WebSocket
hijacking; both are OWASP's terms).
"""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import uvicorn
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from bridge.config.sections.web import split
from bridge.web.serving.access import Access
from bridge.web.serving.connections import (
    MOST_CONNECTIONS,
    BoundedListener,
    BoundedWebSocket,
    ServerLoop,
    TimedHttp,
    quiet_server_log,
)
from bridge.web.serving.login import LoginGuard
from bridge.web.serving.scarce_log import ScarceLog

if TYPE_CHECKING:
    from bridge.web.serving.tls import ServerTls

_log = logging.getLogger("midspan.web")

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
_STOP_SECONDS = 1.5
_NAMES = ("localhost", "127.0.0.1", "[::1]")


class OwnOnly:
    """Passes requests whose ``Host`` is this server, sockets only from this server's own page."""

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
    """Return why a request is refused, "" if it is not."""
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
        return "a browser's request has no Origin"
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


class HttpServer:
    """An HTTP server with its own thread.

    Args:
        listen: address and port.
        routes: its routes.
        access: authentication of clients.
        tls: certificate and key, None without TLS.
        what: the server, for errors.
        key: the configuration's key of ``listen``, for errors.
        most_bytes: of a socket's message.

    Attributes:
        port: on which it listens.
        address: its URL.
    """

    def __init__(
        self, listen: str, routes: Sequence[BaseRoute], access: Access, tls: ServerTls | None, *, what: str, key: str,
        most_bytes: int = 1 << 16,
    ) -> None:  # fmt: skip
        address, port = split(listen)
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        self._socket = BoundedListener(family)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((address, port))
            self._socket.listen(128)  # connections wait here until the server runs
        except OSError as err:
            self._socket.close()
            raise RuntimeError(f"{what} cannot listen on {listen}: {err.strerror}; set {key}") from None
        self.port: int = self._socket.getsockname()[1]
        names = [bracketed(name) for name in (tls.names if tls else (address,))]
        self._hosts = hosts(names, self.port, tls=tls is not None)
        self.address = f"{'https' if tls else 'http'}://{names[0]}:{self.port}/"
        app = OwnOnly(LoginGuard(Starlette(routes=routes), access), lambda: self._hosts)
        self._server = uvicorn.Server(
            uvicorn.Config(
                app, log_config=None, access_log=False, lifespan="off", ws_max_size=most_bytes,
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
        """Start to serve."""
        self._thread.start()

    @property
    def trouble(self) -> str:
        """Why it does not run, "" if it does."""
        return self._trouble or ("" if self._thread.is_alive() else "the server has ended")

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
            _log.exception("the HTTP server failed")
            self._trouble = f"{type(err).__name__}: {err}"


def hosts(names: Sequence[str], port: int, *, tls: bool) -> frozenset[str]:
    """Return the valid values of ``Host``; browsers leave out the scheme's default port."""
    own = {name.lower() for name in (*_NAMES, *names)}
    return frozenset({f"{name}:{port}" for name in own} | (own if port == (443 if tls else 80) else set()))


def bracketed(name: str) -> str:
    """Return a name or an address as in a URL."""
    return f"[{name}]" if ":" in name else name
