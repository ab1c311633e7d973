"""The console's connections: how many, how many from one address, how long a request may take, and how much may wait.

uvicorn bounds the size of a head and of a message. It waits for a head or a body without end, and answers pings that
nobody reads; so these bounds are here.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.exceptions import InvalidState
from websockets.frames import Frame

from bridge.web.serving.access import common_name
from bridge.web.serving.scarce_log import ScarceLog

MOST_CONNECTIONS, MOST_OF_ADDRESS = 300, 100
REQUEST_SECONDS = 20.0
"""A request's head, its body and the answer take no longer, or the connection is cut."""
HANDSHAKE_SECONDS = 5.0
MOST_UNREAD = 2 << 20
"""Bytes that wait for a page that sends pings and reads nothing."""
MOST_PARTS = 1000
"""Frames of one message."""

_HIDDEN = (
    "Invalid UTF-8",
    "connection open",
    "connection closed",
    "connection rejected",
    "Invalid HTTP",
    "ASGI callable returned",
)


class BoundedListener(socket.socket):
    """A socket that listens; it closes at once what comes beyond the bounds."""

    def __init__(self, family: socket.AddressFamily) -> None:
        super().__init__(family, socket.SOCK_STREAM)
        self._open: dict[str, int] = {}
        self._lock = threading.Lock()
        self._refused = ScarceLog()

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection; raises `ConnectionAbortedError` where there are too many (asyncio goes on)."""
        sock, address = super().accept()
        host = str(address[0])
        with self._lock:
            of_host = self._open.get(host, 0)
            if of_host < MOST_OF_ADDRESS and sum(self._open.values()) < MOST_CONNECTIONS:
                self._open[host] = of_host + 1
                return _Counted(sock, self, host), address
        sock.close()
        self._refused.warn(f"a connection from {host} is cut: {of_host} of that address are open")
        raise ConnectionAbortedError

    def closed(self, host: str) -> None:
        """A connection of an address has ended."""
        with self._lock:
            self._open[host] -= 1
            if not self._open[host]:
                del self._open[host]


class _Counted(socket.socket):
    """A connection that tells its end."""

    def __init__(self, sock: socket.socket, listener: BoundedListener, host: str) -> None:
        super().__init__(sock.family, sock.type, sock.proto, sock.detach())
        self._listener: BoundedListener | None = listener
        self._host = host

    def close(self) -> None:
        super().close()
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.closed(self._host)


class ServerLoop(asyncio.SelectorEventLoop):
    """An event loop whose servers do not wait long for the start of TLS."""

    async def create_server(self, *args: Any, **options: Any) -> asyncio.Server:
        """As asyncio's."""
        if options.get("ssl") is not None:
            options["ssl_handshake_timeout"] = HANDSHAKE_SECONDS
        return await super().create_server(*args, **options)


class TimedHttp(H11Protocol):
    """Cuts a connection whose request takes too long, in coming or in being answered."""

    _since = 0.0
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """As uvicorn's."""
        super().connection_made(transport)
        shown = common_name(transport.get_extra_info("peercert"))
        self.app_state = {**self.app_state, "certificate": shown}
        self._since = self.loop.time()
        self._timer = self.loop.call_later(REQUEST_SECONDS, self._check_time)

    def connection_lost(self, exc: Exception | None) -> None:
        """As uvicorn's."""
        self._end_timer()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """As uvicorn's."""
        super().on_response_complete()
        self._since = self.loop.time()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """As uvicorn's; the connection is another protocol's now."""
        self._end_timer()
        super().handle_websocket_upgrade(event)

    def send_400_response(self, msg: str) -> None:
        """As uvicorn's, but the application, which may have its head already, no longer answers beside it."""
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
    """Cuts a page for which too much waits, or whose message has too many parts."""

    def handle_ping(self) -> None:
        """As uvicorn's."""
        if not self.transport.is_closing():
            super().handle_ping()
        if self.transport.get_write_buffer_size() > MOST_UNREAD:
            self.transport.abort()

    def handle_cont(self, event: Frame) -> None:
        """As uvicorn's."""
        if len(self.frames) >= MOST_PARTS:
            self.transport.abort()
        else:
            super().handle_cont(event)

    def send_receive_event_to_app(self) -> None:
        """As uvicorn's."""
        try:
            super().send_receive_event_to_app()
        except InvalidState:  # a text that is none, on a socket that the page has begun to close
            self.transport.abort()


def quiet_server_log() -> None:
    """Keep what strangers make uvicorn say out of the log; its own failures stay in it."""
    logging.getLogger("uvicorn.error").addFilter(_is_failure)


def _is_failure(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.ERROR and not str(record.msg).startswith(_HIDDEN)
