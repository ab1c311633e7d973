"""The server in front of the SDK's server: it authenticates clients or, without tokens, checks the ``Origin`` of pages.

The SDK accepts every client: it checks neither tokens nor the ``Origin`` header, so that any page in this machine's
browser could drive the robot (OWASP, "Cross-site WebSocket hijacking"). So the SDK listens on an unpublished loopback
address, and this server forwards bytes after it has checked the request's head. It parses no messages.

The output buffer of each client is bounded in bytes (`MOST_UNREAD`), unlike the SDK's queue; a client whose buffer
stays full for `FULL_BUFFER_SECONDS` is disconnected.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import socket
import threading
from collections.abc import Coroutine, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

from bridge.config.sections.listen import split
from bridge.foxglove.section import FoxgloveSection
from bridge.foxglove.visitors import Visitor, Visitors
from bridge.web.section import WebSection
from bridge.web.serving.access import Access, Grant, WrongTokenError
from bridge.web.serving.scarce_log import ScarceLog

if TYPE_CHECKING:
    from bridge.web.serving.tls import ServerTls

_log = logging.getLogger("midspan.foxglove")

PROTOCOL = "foxglove.sdk.v1"
MOST_CLIENTS = 32
MOST_CONNECTIONS = 4 * MOST_CLIENTS
"""Maximum number of connections, including those that are not authenticated yet; further ones are closed."""
MOST_HEAD = 16 << 10  # bytes of a request's head
HEAD_SECONDS = 5.0
"""Time limit for each step of a handshake: TLS, the request's head, the SDK's response, and sending a refusal."""
MOST_UNREAD = 8 << 20
FULL_BUFFER_SECONDS = 20.0
_KEEPALIVE = (("TCP_KEEPIDLE", 60), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 9))
_STEP = 256 << 10  # maximum bytes that are forwarded at once
_STOP_SECONDS = 1.5  # to wait for the thread's end
_NOT_THE_APP = "this WebSocket is for the Foxglove app"
_CONTROL = re.compile(r"[\x00-\x08\n-\x1f\x7f]")
_REQUEST = re.compile(r"GET (\S+) HTTP/1\.1")


class TurnedAwayError(Exception):
    """A request is refused; the text is the reason.

    Attributes:
        headers: HTTP headers of the refusal.
        logged: whether the refusal is in the log already.
    """

    def __init__(
        self, status: HTTPStatus, reason: str, headers: Mapping[str, str] | None = None, *, logged: bool = False
    ) -> None:
        super().__init__(reason)
        self.status, self.headers, self.logged = status, headers or {"connection": "close"}, logged


@dataclass(frozen=True, slots=True)
class RequestHead:
    """The head of a request.

    Attributes:
        target: path and query.
        headers: values by lower-case name; those of repeated headers are joined with a comma.
    """

    target: str
    headers: dict[str, str]

    @classmethod
    def read(cls, head: bytes) -> RequestHead:
        """Parse a head; raises `TurnedAwayError` if it is invalid."""
        first, *lines = head.decode("latin-1").removesuffix("\r\n\r\n").split("\r\n")
        match = _REQUEST.fullmatch(first)
        if match is None:
            raise TurnedAwayError(HTTPStatus.BAD_REQUEST, _NOT_THE_APP)
        headers: dict[str, str] = {}
        for line in lines:
            name, separator, value = line.partition(":")
            if not separator or name != name.strip() or _CONTROL.search(line):
                raise TurnedAwayError(HTTPStatus.BAD_REQUEST, f"invalid header: {line[:80]!r}")
            key = name.lower()
            headers[key] = f"{headers[key]},{value.strip()}" if key in headers else value.strip()
        return cls(match[1], headers)

    @property
    def token(self) -> str:
        """The token of the header ``Authorization: Bearer``, else of ``?token=`` in the target; "" without one."""
        scheme, _, credentials = self.headers.get("authorization", "").partition(" ")
        parameter = parse_qs(self.target.partition("?")[2]).get("token", [""])[0]
        return credentials.strip() if scheme.lower() == "bearer" else parameter

    def forwarded(self) -> bytes:
        """Return the head for the SDK's server, without token, cookies, path and query."""
        names = (name for name in self.headers if name not in ("authorization", "cookie"))
        lines = ["GET / HTTP/1.1", *(f"{name}: {self.headers[name]}" for name in names)]
        return "\r\n".join([*lines, "", ""]).encode("latin-1")


class ConnectionGuard:
    """Authenticates and authorizes connections."""

    def __init__(self, section: FoxgloveSection) -> None:
        self._section = section
        log = ScarceLog("midspan.foxglove")
        web = WebSection(tokens=section.tokens)
        self._access = Access(web, b"", key="foxglove.tokens", log=log) if section.tokens else None

    def grant(self, request: RequestHead, address: str) -> Grant:
        """Return the client's name and role; raises `TurnedAwayError` if the client may not connect."""
        protocols = request.headers.get("sec-websocket-protocol", "").replace(" ", "").split(",")
        if request.headers.get("upgrade", "").lower() != "websocket" or PROTOCOL not in protocols:
            raise TurnedAwayError(HTTPStatus.BAD_REQUEST, f"{_NOT_THE_APP}, with the subprotocol {PROTOCOL}")
        if self._access is None:
            self._check_page(request.headers)  # not needed with tokens, because a foreign page has none
            return Grant("", "drive" if self._section.drive else "watch")
        hint = "use a token of foxglove.tokens: wss://robot:8765/?token=..."
        headers = {name: request.headers.get(name, "") for name in ("user-agent", "x-forwarded-for")}
        headers["authorization"] = f"Bearer {request.token}"
        try:
            grant = self._access.grant(headers, "", address)
        except WrongTokenError as err:
            status = HTTPStatus.TOO_MANY_REQUESTS if err.wait else HTTPStatus.UNAUTHORIZED
            raise TurnedAwayError(status, f"{err}; {hint}", err.headers, logged=True) from None
        if grant is None:
            raise TurnedAwayError(HTTPStatus.UNAUTHORIZED, hint)
        return grant

    def _check_page(self, headers: dict[str, str]) -> None:
        origin = headers.get("origin", "")
        if origin and origin.lower() not in {allowed.lower() for allowed in self._section.origins}:
            reason = f"pages from {origin[:80]!r} may not connect; foxglove.origins lists those that may"
            raise TurnedAwayError(HTTPStatus.FORBIDDEN, reason)
        if not origin and "mozilla" in headers.get("user-agent", "").lower():
            raise TurnedAwayError(HTTPStatus.FORBIDDEN, "a request from a browser must have an Origin header")


class Front:
    """The server that the app connects to, with its own thread. Raises `RuntimeError` if it cannot listen.

    Args:
        section: the configuration.
        inner: address of the SDK's server.
        visitors: registry of the clients.
        announces: whether a first message identifies clients to the SDK, which accepts it only if clients may publish.
        tls: certificate and key; None without TLS.

    Attributes:
        address: the URL to open in the app.
        inner: address of the SDK's server.
        port: the port on which the server listens.
    """

    def __init__(
        self, section: FoxgloveSection, inner: tuple[str, int], visitors: Visitors, *, announces: bool,
        tls: ServerTls | None,
    ) -> None:  # fmt: skip
        self.inner, self._visitors, self._announces, self._tls = inner, visitors, announces, tls
        self._guard = ConnectionGuard(section)
        self._refused = ScarceLog("midspan.foxglove")
        host, port = split(section.listen)
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((host, port))
            self._socket.listen(64)  # connections wait here until the server runs
        except OSError as err:
            self._socket.close()
            message = f"the Foxglove server cannot listen on {section.listen}: {err.strerror}; set foxglove.listen"
            raise RuntimeError(message) from None
        self.port: int = self._socket.getsockname()[1]
        self.address = f"{'wss' if tls else 'ws'}://{f'[{host}]' if ':' in host else host}:{self.port}"
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended = asyncio.Event()
        self._open: set[asyncio.Task[None]] = set()
        self._thread = threading.Thread(target=self._run, name="midspan-foxglove-front", daemon=True)

    def start(self) -> None:
        self._thread.start()

    @property
    def trouble(self) -> str:
        """Why the server is not running; "" if it is."""
        return "" if self._thread.is_alive() else "the server has ended"

    def close(self) -> None:
        """Close all connections, and end the thread. Safe to call twice."""
        if self._loop is not None and self._thread.is_alive():
            with contextlib.suppress(RuntimeError):  # the server's event loop has just ended
                self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join(_STOP_SECONDS)
        self._socket.close()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except Exception:
            _log.exception("the server for the Foxglove app failed")

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        context, seconds = (None, None) if self._tls is None else (self._tls.context, HEAD_SECONDS)
        server = await asyncio.start_server(
            self._accept, sock=self._socket, limit=MOST_HEAD, ssl=context, ssl_handshake_timeout=seconds
        )
        await self._ended.wait()
        server.close()
        for task in self._open:
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        if len(self._open) >= MOST_CONNECTIONS:
            writer.transport.abort()
            return
        self._open.add(task)
        keep_alive(writer.get_extra_info("socket"))
        address = str(writer.get_extra_info("peername")[0])
        try:
            async with asyncio.timeout(HEAD_SECONDS):
                # read the whole head even for a refusal: closing with unread bytes could lose the response
                head = await reader.readuntil(b"\r\n\r\n")
            request = RequestHead.read(head)
            visitor = Visitor(self._guard.grant(request, address), address)
            await self._join(request, visitor, reader, writer)
        except TurnedAwayError as err:
            if not err.logged:
                self._refused.warn(f"refused a client at {address}: {err}")
            await _refuse(writer, err)
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass
        finally:
            self._open.discard(task)
            writer.transport.abort()

    async def _join(
        self, request: RequestHead, visitor: Visitor, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Forward between a client and the SDK's server until either closes."""
        if len(self._visitors.all()) >= MOST_CLIENTS:
            raise TurnedAwayError(HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_CLIENTS} clients are already connected")
        first = self._visitors.expect(visitor)
        inner: asyncio.StreamWriter | None = None
        try:
            async with asyncio.timeout(HEAD_SECONDS):
                answers, inner = await asyncio.open_connection(*self.inner, limit=_STEP)
                inner.write(request.forwarded())
                head = await answers.readuntil(b"\r\n\r\n")
            writer.write(head)
            if b" 101 " not in head.partition(b"\r\n")[0]:
                writer.write(await asyncio.wait_for(answers.read(_STEP), HEAD_SECONDS))
                await writer.drain()
                return
            if self._announces:
                inner.write(_client_frame(first))
            _log.info("%s connected, role %s", visitor.who, visitor.grant.role)
            writer.transport.set_write_buffer_limits(high=MOST_UNREAD, low=MOST_UNREAD - _STEP)
            await _either(_forward(reader, inner, None), _forward(answers, writer, visitor))
        finally:
            self._visitors.disconnected(visitor)
            if inner is not None:
                inner.transport.abort()


def keep_alive(sock: Any) -> None:
    """Have the system end a connection if the client's machine has vanished, even if nothing is sent to the client."""
    with contextlib.suppress(OSError):  # the connection has just ended
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE:
            if (option := getattr(socket, name, None)) is not None:  # some systems have other options
                sock.setsockopt(socket.IPPROTO_TCP, option, value)


async def _either(*jobs: Coroutine[Any, Any, None]) -> None:
    """Run the jobs until one of them completes, and cancel the others."""
    tasks = [asyncio.create_task(job) for job in jobs]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _forward(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, visitor: Visitor | None) -> None:
    while data := await reader.read(_STEP):
        writer.write(data)
        if visitor is not None:
            visitor.sent += len(data)
        async with asyncio.timeout(FULL_BUFFER_SECONDS):
            await writer.drain()


async def _refuse(writer: asyncio.StreamWriter, err: TurnedAwayError) -> None:
    text = f"{err}\n".encode()
    head = f"HTTP/1.1 {err.status.value} {err.status.phrase}\r\ncontent-type: text/plain; charset=utf-8\r\n"
    more = "".join(f"{name}: {value}\r\n" for name, value in err.headers.items())
    writer.write(f"{head}content-length: {len(text)}\r\n{more}\r\n".encode() + text)
    with contextlib.suppress(OSError, TimeoutError):
        async with asyncio.timeout(HEAD_SECONDS):
            await writer.drain()
            writer.close()
            await writer.wait_closed()


def _client_frame(text: bytes) -> bytes:
    """Return the text frame of a WebSocket client (RFC 6455, 5.2), with a mask of zeros."""
    return bytes((0x81, 0x80 | 126)) + len(text).to_bytes(2, "big") + bytes(4) + text
