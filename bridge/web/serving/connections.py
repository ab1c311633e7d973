"""Limits of the console's connections: total number, number per address, duration of a request, unread data.

uvicorn itself limits only the size of a request's head and of a message, and the number of all connections. It waits
for a head or a body without a time limit, and answers pings even if the replies are not read.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from typing import Any

import h11
from typing_extensions import override
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.exceptions import InvalidState
from websockets.frames import Frame

from bridge.web.serving.access import common_name
from bridge.web.serving.scarce_log import ScarceLog

MOST_CONNECTIONS, MOST_OF_ADDRESS = 300, 100
REQUEST_SECONDS = 20.0
"""Time limit of a request with its response, after which the connection is closed."""
HANDSHAKE_SECONDS = 5.0  # time limit of the TLS handshake
MOST_UNREAD = 2 << 20
"""Bytes that may be queued for a page that sends pings and reads nothing."""
MOST_PARTS = 1000
"""Maximum number of frames of one message."""

_HIDDEN = (
    "Invalid UTF-8",
    "connection open",
    "connection closed",
    "connection rejected",
    "Invalid HTTP",
    "ASGI callable returned",
)


class BoundedListener(socket.socket):
    """A listening socket that immediately closes connections beyond the limits."""

    def __init__(self, family: socket.AddressFamily) -> None:
        super().__init__(family, socket.SOCK_STREAM)
        self._open: dict[str, int] = {}
        self._lock = threading.Lock()
        self._refused = ScarceLog()

    @override
    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection; raises `ConnectionAbortedError`, which asyncio handles, if there are too many."""
        sock, address = super().accept()
        host = str(address[0])
        with self._lock:
            of_host = self._open.get(host, 0)
            if of_host < MOST_OF_ADDRESS and sum(self._open.values()) < MOST_CONNECTIONS:
                self._open[host] = of_host + 1
                return _Counted(sock, self, host), address
        sock.close()
        self._refused.warn(f"closed a connection from {host}: {of_host} of that address are open")
        raise ConnectionAbortedError

    def closed(self, host: str) -> None:
        """Record the end of a connection from this host."""
        with self._lock:
            self._open[host] -= 1
            if not self._open[host]:
                del self._open[host]


class _Counted(socket.socket):
    """A connection that reports its end to its listener."""

    def __init__(self, sock: socket.socket, listener: BoundedListener, host: str) -> None:
        super().__init__(sock.family, sock.type, sock.proto, sock.detach())
        self._listener: BoundedListener | None = listener
        self._host = host

    @override
    def close(self) -> None:
        super().close()
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.closed(self._host)


class ServerLoop(asyncio.SelectorEventLoop):
    """An event loop whose servers limit the time of the TLS handshake."""

    @override
    async def create_server(self, *args: Any, **options: Any) -> asyncio.Server:
        if options.get("ssl") is not None:
            options["ssl_handshake_timeout"] = HANDSHAKE_SECONDS
        return await super().create_server(*args, **options)


class TimedHttp(H11Protocol):
    """Closes a connection whose request or response takes too long."""

    _since = 0.0
    _timer: asyncio.TimerHandle | None = None

    @override
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        shown = common_name(transport.get_extra_info("peercert"))
        self.app_state = {**self.app_state, "certificate": shown}
        self._since = self.loop.time()
        self._timer = self.loop.call_later(REQUEST_SECONDS, self._check_time)

    @override
    def connection_lost(self, exc: Exception | None) -> None:
        self._end_timer()
        super().connection_lost(exc)

    @override
    def on_response_complete(self) -> None:
        """Restart the time limit for the next request; see uvicorn."""
        super().on_response_complete()
        self._since = self.loop.time()

    @override
    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Stop the timer, because another protocol takes over the connection; see uvicorn."""
        self._end_timer()
        super().handle_websocket_upgrade(event)

    @override
    def send_400_response(self, msg: str) -> None:
        """Refuse a request as uvicorn does; the application, which may have the head already, must not respond too."""
        if self.cycle is not None and not self.cycle.response_complete:
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            super().send_400_response(msg)
        else:
            self.transport.abort()

    def _end_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _check_time(self) -> None:
        left = self._since + REQUEST_SECONDS - self.loop.time()
        if left > 0.0:
            self._timer = self.loop.call_later(left, self._check_time)
        else:
            self.transport.abort()


class BoundedWebSocket(WebSocketsSansIOProtocol):
    """Closes the connection of a page with too much unread data, too many parts in a message, or without pongs."""

    @override
    def handle_ping(self) -> None:
        """Answer a ping unless the connection is closing, and abort it if too much is unread; see uvicorn."""
        if not self.transport.is_closing():
            super().handle_ping()
        if self.transport.get_write_buffer_size() > MOST_UNREAD:
            self.transport.abort()

    @override
    def keepalive_timeout(self) -> None:
        """Abort the connection of a page that has not answered a ping; see uvicorn, which would send all data first."""
        super().keepalive_timeout()
        self.transport.abort()

    @override
    def handle_cont(self, event: Frame) -> None:
        """Accept a further part of a message, up to `MOST_PARTS`; see uvicorn."""
        if len(self.frames) >= MOST_PARTS:
            self.transport.abort()
        else:
            super().handle_cont(event)

    @override
    def send_receive_event_to_app(self) -> None:
        """Pass on a message; see uvicorn."""
        try:
            super().send_receive_event_to_app()
        except InvalidState:  # invalid text on a socket that the page is closing
            self.transport.abort()


def quiet_server_log() -> None:
    """Remove uvicorn's messages about clients' errors from the log; its own failures remain."""
    logging.getLogger("uvicorn.error").addFilter(_is_failure)


def _is_failure(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.ERROR and not str(record.msg).startswith(_HIDDEN)
