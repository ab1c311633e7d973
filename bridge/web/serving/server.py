"""An HTTP server with its own thread, for the console and for metrics. It refuses requests caused by other sites.

A foreign page in the operator's browser must not drive a robot: each request's ``Host`` must be one of this server's
names (against DNS rebinding), and its ``Origin``, which browsers send with each socket, must be this server's own
(against cross-site WebSocket hijacking; both are OWASP's terms).
"""

from __future__ import annotations

import asyncio
import logging
import re
import socket
import threading
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING
from urllib.parse import quote

import uvicorn
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from bridge.config.sections.listen import split
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
_PORT = re.compile(r":[0-9]{1,5}\Z")
_DEFAULT_PORTS = {"http": ":80", "https": ":443"}


class OwnOnly:
    """Passes on only requests that use a name of this server and were not caused by a foreign page; see `refusal`."""

    def __init__(self, app: ASGIApp, hosts: frozenset[str], names: frozenset[str]) -> None:
        self._app, self._hosts, self._names = app, hosts, names
        self._refused = ScarceLog()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        reason = refusal(scope, self._hosts, self._names)
        if not reason:
            await self._app(scope, receive, _with_headers(send))
            return
        self._refused.warn(f"refused a request from {(scope.get('client') or ('?',))[0]}: {reason}")
        answer = PlainTextResponse(f"{reason}\n", 403, HEADERS)
        if scope["type"] == "websocket":
            await WebSocket(scope, receive, send).send_denial_response(answer)
        else:
            await answer(scope, receive, send)


class Prefixed:
    """Serves an application also below a path prefix, because a reverse proxy may forward the prefix or remove it."""

    def __init__(self, app: ASGIApp, prefix: str) -> None:
        self._app, self._prefix = app, prefix

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if self._prefix and scope["type"] in ("http", "websocket"):
            path: str = scope["path"]
            if path == self._prefix and scope["type"] == "http":  # relative addresses of the page need the slash
                await RedirectResponse(f"{self._prefix}/", 303)(scope, receive, send)
                return
            if path.startswith(f"{self._prefix}/"):
                inner = path.removeprefix(self._prefix)
                scope = {**scope, "path": inner, "raw_path": quote(inner).encode()}
        await self._app(scope, receive, send)


def refusal(scope: Scope, hosts: frozenset[str], names: frozenset[str] = frozenset()) -> str:
    """Return why a request is refused; "" if it is not.

    Args:
        scope: the request.
        hosts: valid values of ``Host``.
        names: names that are valid with any port, because a proxy's or a tunnel's port differs from this server's.
    """
    headers: dict[str, list[str]] = {}
    for name, value in scope["headers"]:
        headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    host, origin = [value.lower() for value in headers.get("host", [])], headers.get("origin", [])
    named = len(host) == 1 and _PORT.sub("", host[0]) in names
    if len(host) != 1 or not (named or host[0] in hosts):
        return f"unknown host: {', '.join(host)[:80]!r}; if it is this console's name, add it to web.names"
    own_pages = _origins(host[0], _schemes(scope, headers.get("x-forwarded-proto", []) if named else None))
    if any(page.lower() not in own_pages for page in origin):
        relation = f"{', '.join(origin)[:80]!r} may not access {host[0]!r}"
        return f"a page of {relation}; a proxy must forward Host with its port, and X-Forwarded-Proto"
    if (
        scope["type"] == "websocket"
        and not origin
        and "user-agent" in headers
        and "Mozilla" in headers["user-agent"][0]
    ):
        return "a request from a browser must have an Origin header"
    if headers.get("sec-fetch-site", ["same-origin"])[0] not in ("same-origin", "none"):
        return "pages of other sites may not access this server"
    return ""


def _schemes(scope: Scope, forwarded: Sequence[str] | None) -> Collection[str]:
    """Return the schemes of a server's own pages.

    ``forwarded``: the values of ``X-Forwarded-Proto``, because a proxy may add TLS; None if the host is not a proxy's.
    """
    if scope.get("scheme") in ("https", "wss"):
        return ("https",)
    if forwarded is None:
        return ("http",)
    if not forwarded:
        return ("http", "https")
    first = forwarded[0].partition(",")[0].strip().lower()
    return ({"ws": "http", "wss": "https"}.get(first, first),)


def _origins(host: str, schemes: Collection[str]) -> set[str]:
    """Return the origins of a host's pages; browsers leave out the scheme's default port."""
    return {f"{scheme}://{host.removesuffix(_DEFAULT_PORTS.get(scheme, ''))}" for scheme in schemes}


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            names = {name.lower() for name, _ in message.get("headers", ())}
            added = [(k.encode(), v.encode()) for k, v in HEADERS.items() if k.encode() not in names]
            message["headers"] = [*message.get("headers", ()), *added]
        await send(message)

    return sending


class HttpServer:
    """An HTTP server with its own thread. Raises `RuntimeError` if it cannot listen.

    Args:
        listen: address and port.
        routes: its routes.
        access: authentication of clients.
        tls: certificate and key; None without TLS.
        what: what the server is, for errors.
        key: the configuration's key of ``listen``, for errors.
        names: further names by which browsers open the server, at any port.
        most_bytes: maximum size of a socket's message.

    Attributes:
        port: the port on which the server listens.
        address: its URL.
    """

    def __init__(
        self, listen: str, routes: Sequence[BaseRoute], access: Access, tls: ServerTls | None, *, what: str, key: str,
        names: Sequence[str] = (), most_bytes: int = 1 << 16,
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
        own_names = [bracketed(name) for name in (tls.names if tls else (address,))]
        self.address = f"{'https' if tls else 'http'}://{own_names[0]}:{self.port}{access.prefix}/"
        guarded = Prefixed(LoginGuard(Starlette(routes=routes), access), access.prefix)
        any_port = frozenset(bracketed(name).lower() for name in names)
        app = OwnOnly(guarded, hosts(own_names, self.port, tls=tls is not None), any_port)
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
        self._thread.start()

    @property
    def trouble(self) -> str:
        """Why the server is not running; "" if it is."""
        return self._trouble or ("" if self._thread.is_alive() else "the server has ended")

    def close(self) -> None:
        """Close every socket, and end the thread."""
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
    own_names = {name.lower() for name in (*_NAMES, *names)}
    return frozenset({f"{name}:{port}" for name in own_names} | (own_names if port == (443 if tls else 80) else set()))


def bracketed(name: str) -> str:
    """Return a name or an address in the form for a URL."""
    return f"[{name}]" if ":" in name else name
