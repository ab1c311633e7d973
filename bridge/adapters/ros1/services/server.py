"""Servers on ROS 1: this node's services, and the connections of their clients."""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable, Iterable

from typing_extensions import override

from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.graph.probe import Ros1Context
from bridge.adapters.ros1.handshake import ORIGIN_FIELD, Header, encode
from bridge.adapters.ros1.services.connection import LENGTH, ServiceConnection
from bridge.adapters.ros1_peers import DeadlineSocket
from bridge.hub.endpoints.calls import Abandon, Call, CallError
from bridge.messages.errors import MessageTypeError
from bridge.messages.transcode.conversion import SideType

_log = logging.getLogger(__name__)

MAX_CLIENTS = 1000
"""Maximum number of connections to one service; each carries one call at a time."""

_NEEDED = ("md5sum", "callerid")
_YES = ("1", "true")


class _ClientConnection(ServiceConnection):
    head = 4

    def __init__(
        self, sock: socket.socket, server: Ros1Server, loop: ConnectionLoop, limit: int, *, persistent: bool
    ) -> None:
        super().__init__(sock, loop, limit)
        self._server, self._persistent = server, persistent
        self._state = threading.Lock()
        self._call_number = self._abandoned = 0
        self._waits = False
        self._abandon: Abandon | None = None

    @override
    def ready(self) -> None:
        """Read a request; during a call, only detect whether the client has left."""
        if self.listens:
            super().ready()
        else:
            self.read_ahead()

    def close(self, why: str) -> None:
        """End a pending call with an error, and close."""
        abandon, number = self._end_wait()
        if abandon is not None:
            abandon()
        if number:
            self._persistent = False
            self._reply(CallError(why))
        else:
            self.cut()

    @override
    def _message(self, head: bytes, body: bytes) -> None:
        self._server.traffic.add(calls=1, received=len(head) + len(body))
        with self._state:
            self._call_number += 1
            number = self._call_number
            self._waits = True
        self._loop.listen(self, data=False)
        if not self._server.is_open:
            self._done(number, CallError(self._server.closed_reason))
            return
        try:
            abandon = self._server.call(body, lambda result: self._done(number, result))
        except Exception as err:
            _log.exception("a call of %s failed unexpectedly", self._server.name)
            self._done(number, CallError(f"failed here: {type(err).__name__}: {err}"))
            return
        with self._state:
            if self._waits and self._call_number == number:
                self._abandon = abandon
            abandoned_early = self._abandoned == number
        if abandoned_early:
            abandon()

    @override
    def _too_large(self, size: int) -> bool:  # the error is sent once the request has been skipped
        return True

    @override
    def _skipped(self, size: int) -> None:
        # not earlier, because closing a connection with unread bytes would discard the error
        self._loop.listen(self, data=False)
        self._reply(CallError(f"the request has {size} bytes, limits.message allows {self._limit}"))

    def _done(self, number: int, result: bytes | CallError) -> None:
        """Send a call's reply, from any thread; drop a second reply, and a reply after the client has left."""
        if self._end_wait(number)[1]:
            self._reply(result)

    def _end_wait(self, number: int = 0) -> tuple[Abandon | None, int]:
        """End the wait for the reply of the pending call, if ``number`` is that call's or 0.

        Returns the call's abandon function and its number; None and 0 if no such call is pending.
        """
        with self._state:
            if not self._waits or number not in (0, self._call_number):
                return None, 0
            self._waits = False
            abandon, self._abandon = self._abandon, None
            if not number and abandon is None:
                self._abandoned = self._call_number  # the thread that starts the call will abandon it
            return abandon, self._call_number

    def _reply(self, result: bytes | CallError) -> None:
        if isinstance(result, bytes) and len(result) > self._limit:
            result = CallError(f"the reply has {len(result)} bytes, limits.message allows {self._limit}")
        ok, body = (b"\1", result) if isinstance(result, bytes) else (b"\0", str(result).encode(errors="replace"))
        if self.send(ok + LENGTH.pack(len(body)), body):
            self._server.traffic.add(sent=len(body) + 5)
        else:
            self.cut()

    @override
    def _sent(self) -> None:
        if self._persistent:
            self.resume()
        else:
            self.cut()

    @override
    def _ended(self, trouble: str) -> None:
        abandon, number = self._end_wait()
        if number:
            _log.debug("a client of %s %s", self._server.name, trouble)
        if abandon is not None:
            abandon()
        self._server.remove(self)


class Traffic:
    """Totals over all services: calls, bytes received and bytes sent. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._totals = (0, 0, 0)

    def add(self, calls: int = 0, received: int = 0, sent: int = 0) -> None:
        """Add to the totals."""
        with self._lock:
            before = self._totals
            self._totals = (before[0] + calls, before[1] + received, before[2] + sent)

    def totals(self) -> tuple[int, int, int]:
        """Return calls, bytes received and bytes sent."""
        return self._totals


class Ros1Server:
    """One service of this node; its calls are counted in ``traffic``."""

    def __init__(
        self, name: str, side_type: SideType, call: Call, closed: Callable[[Ros1Server], None], traffic: Traffic
    ) -> None:
        self.name, self.side_type, self.call, self.traffic = name, side_type, call, traffic
        self.closed_reason = f"{name} is no longer served"
        self._closed = closed
        self._lock = threading.Lock()
        self._clients: set[_ClientConnection] = set()
        self._open = True

    @property
    def is_open(self) -> bool:
        """Whether calls are accepted."""
        return self._open

    @property
    def clients(self) -> int:
        """Number of connected clients."""
        return len(self._clients)

    @property
    def is_full(self) -> bool:
        """Whether the service accepts no more clients."""
        return self.clients >= MAX_CLIENTS

    def add(self, client: _ClientConnection) -> bool:
        """Add a client; return False if the service is no longer served."""
        with self._lock:
            if self._open:
                self._clients.add(client)
            return self._open

    def remove(self, client: _ClientConnection) -> None:
        """Remove a client whose connection has ended."""
        with self._lock:
            self._clients.discard(client)

    def close(self) -> None:
        """End pending calls with an error, and disconnect the clients. Safe to call twice."""
        with self._lock:
            if not self._open:
                return
            self._open = False
            clients = list(self._clients)
        self._closed(self)
        for client in clients:
            client.close(self.closed_reason)


class ServiceServers:
    """The services of this node; ``changed`` is called when a service is added or removed, to update the master.

    Attributes:
        traffic: the totals of all services, including those that have ended.
    """

    def __init__(self, context: Ros1Context, changed: Callable[[], None]) -> None:
        self._context, self._changed = context, changed
        self._lock = threading.Lock()
        self._servers: dict[str, Ros1Server] = {}
        self.traffic = Traffic()

    def open(self, name: str, side_type: SideType, call: Call) -> Ros1Server:
        """Serve a service; raises `MessageTypeError`."""
        if not side_type.type_id or side_type.type_id == "*":
            raise MessageTypeError(
                f"the md5 sum of {side_type.name} is unknown, so ROS 1 clients would reject it",
                "give the type's .srv folder under types.folders",
            )
        server = Ros1Server(name, side_type, call, self._remove_server, self.traffic)
        with self._lock:
            if name in self._servers:
                raise MessageTypeError(
                    f"{name} is already served on ROS 1 as {self._servers[name].side_type.name}",
                    "rename one of the two with a rule, because a ROS 1 service has only one server",
                )
            self._servers[name] = server
        self._changed()
        return server

    def names(self) -> Iterable[str]:
        """Return the names of the served services."""
        with self._lock:
            return list(self._servers)

    def admit(self, sock: DeadlineSocket, header: Header) -> str:
        """Admit a client whose header has been read; return "" or why it is rejected. Raises `OSError`."""
        for field in _NEEDED:
            if field not in header:
                return f"the header of a service's client needs the field {field}"
        with self._lock:
            server = self._servers.get(header["service"])
        if server is None:
            return f"{self._context.node()} does not serve {header['service']}"
        ours, md5 = server.side_type, header["md5sum"]
        if md5 not in ("*", ours.type_id):
            return (
                f"{server.name}: md5 sums differ: {header['callerid']} requests {md5}, but it is {ours.name} with"
                f" {ours.type_id}; use the same version of {ours.name.split('/')[0]} on both sides"
            )
        if server.is_full:
            return f"{server.name} has {MAX_CLIENTS} clients already"
        sock.sendall(encode(self._header(server)))
        if header.get("probe") == "1":
            sock.close()
            return ""
        persistent = header.get("persistent", "").strip().lower() in _YES
        client = _ClientConnection(sock, server, self._context.loop, self._context.limit, persistent=persistent)
        if server.add(client):
            client.start()
        else:
            client.end("connected too late")
        return ""

    def close(self) -> None:
        with self._lock:
            servers = list(self._servers.values())
        for server in servers:
            server.close()

    def _remove_server(self, server: Ros1Server) -> None:
        with self._lock:
            del self._servers[server.name]
        self._changed()

    def _header(self, server: Ros1Server) -> Header:
        name = server.side_type.name
        return {
            "callerid": self._context.node(),
            "service": server.name,
            "type": name,
            "md5sum": server.side_type.type_id,
            "request_type": f"{name}Request",
            "response_type": f"{name}Response",
            ORIGIN_FIELD: self._context.origin,
        }
