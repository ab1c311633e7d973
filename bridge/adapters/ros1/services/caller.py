"""Clients of ROS 1 servers over persistent connections, one per pending call.

A connection stays open between calls, so that the crash of a server is noticed before the next call.
"""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from typing_extensions import override

from bridge import resources
from bridge.adapters.ros1.connection_loop import ConnectionLoop
from bridge.adapters.ros1.graph.probe import Ros1Context
from bridge.adapters.ros1.graph.state import Registration
from bridge.adapters.ros1.handshake import connect_service
from bridge.adapters.ros1.services.connection import LENGTH, ServiceConnection
from bridge.adapters.ros1_peers import EXHAUSTED, ExhaustedError, Ros1Error, UnreachableError, unanswered
from bridge.hub.endpoints.calls import Abandon, CallError, Done
from bridge.messages.transcode.conversion import SideType

_log = logging.getLogger(__name__)

MAX_CALLS = 1000
"""Maximum number of pending calls of one service; each uses a connection."""

_MAX_ERROR = 64 * 1024
_MAX_IDLE = 8
_CONNECT_SECONDS = 10.0
_FIRST_WAIT = 0.2
_LONGEST_WAIT = 5.0

OnOutdated = Callable[[Registration, str], None]
"""Called with a server's registration that may be outdated, and the reason."""


class _Pending:
    """One pending call; only the first result counts."""

    def __init__(self, request: bytes, done: Done, over: Callable[[_Pending], None]) -> None:
        self.request = request
        self.connection: _ServerConnection | None = None
        self._done: Done | None = done
        self._over = over
        self._lock = threading.Lock()

    @property
    def is_pending(self) -> bool:
        return self._done is not None

    def attach(self, connection: _ServerConnection) -> bool:
        """Store the connection that is to send the request; return False if the call has ended."""
        with self._lock:
            self.connection = connection
            return self._done is not None

    def finish(self, result: bytes | CallError) -> None:
        done = self._take_done()
        if done is not None:
            done(result)

    def abandon(self) -> None:
        """End the call of a client that left; closing the connection is ROS 1's only signal for that."""
        if self._take_done() is not None:
            self.cut()

    def cut(self) -> None:
        """Close the call's connection, so that a request that has not been sent yet will not be sent."""
        if self.connection is not None:
            self.connection.cut()

    def _take_done(self) -> Done | None:
        with self._lock:
            done, self._done = self._done, None
        if done is not None:
            self._over(self)
        return done


class _ServerConnection(ServiceConnection):
    """One connection to a server, ready for one call at a time."""

    head = 5

    def __init__(
        self, sock: socket.socket, server: Registration, owner: Ros1Caller, loop: ConnectionLoop, limit: int
    ) -> None:
        super().__init__(sock, loop, limit)
        self.server = server
        self._owner = owner
        self._pending: _Pending | None = None

    def begin(self, pending: _Pending) -> bool:
        """Send a call's request; return False if it was not sent because the connection or the call has ended."""
        with self._lock:
            if self._over or not pending.attach(self):
                return False
            self._pending = pending
        request = pending.request
        if self.send(LENGTH.pack(len(request)), request):
            return True
        with self._lock:
            unsent, self._pending = self._pending is pending, None
        self.cut()
        return not unsent

    @override
    def _message(self, head: bytes, body: bytes) -> None:
        pending, self._pending = self._pending, None
        if pending is None:
            self.end("sent data without a request")
            return
        if head[0]:
            pending.finish(body)
        else:
            reason = body[:_MAX_ERROR].decode(errors="replace")
            pending.finish(CallError(reason or "the server reported a failure and gave no reason"))
        # the server may have replied before receiving the whole request, or may send data or close after its reply
        if self.is_at_rest():
            self._owner.freed(self, served=True)
        else:
            self.cut()

    @override
    def _too_large(self, size: int) -> bool:
        pending, self._pending = self._pending, None
        trouble = f"announced a reply of {size} bytes, limits.message allows {self._limit}"
        if pending is not None:
            pending.finish(CallError(f"the server {self.server.node} {trouble}"))
        self.end(trouble)
        return False

    @override
    def _ended(self, trouble: str) -> None:
        with self._lock:
            pending, self._pending = self._pending, None
        if pending is not None:
            pending.finish(CallError(f"the server {self.server.node} {trouble} before it answered"))
        self._owner.lost(self, trouble)


class CallerLoad(NamedTuple):
    """The numbers of a caller's pending calls, of its connections, and of the idle connections among these."""

    calls: int
    connections: int
    idle: int


class Ros1Caller:
    """Calls the server of one name and type."""

    def __init__(
        self,
        context: Ros1Context,
        name: str,
        side_type: SideType,
        on_outdated: OnOutdated,
        closed: Callable[[Ros1Caller], None],
    ) -> None:
        self.name, self.md5 = name, side_type.type_id
        self._context, self._pool, self._on_outdated, self._on_closed = context, context.pool, on_outdated, closed
        self._lock = threading.Lock()
        self._server: Registration | None = None
        self._connections: set[_ServerConnection] = set()
        self._free: list[_ServerConnection] = []
        self._calls: set[_Pending] = set()
        self._warming = False
        self._due, self._wait = 0.0, _FIRST_WAIT
        self._closed = False

    @property
    def needs_connection(self) -> bool:
        """Whether there is a server, but no connection to it, nor an attempt to connect in advance."""
        return self._server is not None and not self._connections and not self._warming

    @property
    def connected(self) -> frozenset[Registration]:
        """The registrations to which connections are open."""
        with self._lock:
            return frozenset(connection.server for connection in self._connections)

    @property
    def load(self) -> CallerLoad:
        with self._lock:
            return CallerLoad(len(self._calls), len(self._connections), len(self._free))

    def follow(self, server: Registration | None) -> None:
        """Adopt the server's registration; None without a server."""
        with self._lock:
            if self._closed:
                return
            moved = server != self._server
            if moved:
                self._server, self._due, self._wait = server, 0.0, _FIRST_WAIT
            old, self._free = (self._free, []) if moved else ([], self._free)
        for connection in old:
            connection.cut()
        self._warm()

    def call(self, request: bytes, done: Done) -> Abandon:
        """Begin a call; never blocks."""
        pending = _Pending(request, done, self._over)
        with self._lock:
            trouble = self._obstacle()
            if not trouble:
                self._calls.add(pending)
        if trouble:
            pending.finish(CallError(trouble))
        else:
            self._begin(pending)
        return pending.abandon

    def close(self) -> None:
        """End all pending calls with an error, and disconnect. Safe to call twice."""
        self._on_closed(self)
        with self._lock:
            self._closed, self._server = True, None
            calls, connections = list(self._calls), list(self._connections)
        for pending in calls:
            pending.finish(CallError(f"{self.name} is no longer bridged"))
            pending.cut()  # its connection may be newer than the list
        for connection in connections:
            connection.cut()

    def freed(self, connection: _ServerConnection, *, served: bool) -> None:
        """Reuse or close an idle connection; ``served``: the connection has carried a call."""
        with self._lock:
            keep = not self._closed and connection.server == self._server and len(self._free) < _MAX_IDLE
            if keep:
                self._free.append(connection)
            if served:
                self._due, self._wait = 0.0, _FIRST_WAIT
        if not keep:
            connection.cut()

    def lost(self, connection: _ServerConnection, trouble: str) -> None:
        """Handle the loss of a connection."""
        _log.debug("%s: the server %s %s", self.name, connection.server.node, trouble)
        with self._lock:
            self._connections.discard(connection)
            if connection in self._free:
                self._free.remove(connection)
        self._warm()

    def _obstacle(self) -> str:
        """Return why a call cannot begin now, "" if it can. The lock is held."""
        if self._closed:
            return f"{self.name} is no longer bridged"
        if self._server is None:
            return f"{self.name} has no server on ROS 1 now"
        if len(self._calls) >= MAX_CALLS:
            return f"{self.name} is busy: {MAX_CALLS} calls are pending"
        return ""

    def _over(self, pending: _Pending) -> None:
        with self._lock:
            self._calls.discard(pending)

    def _begin(self, pending: _Pending) -> None:
        while (connection := self._take_connection()) is not None:
            if connection.begin(pending):
                return
            if not pending.is_pending:
                connection.cut()
                return
        threading.Thread(target=self._connect_and_begin, args=(pending,), name="midspan-ros1-call", daemon=True).start()

    def _take_connection(self) -> _ServerConnection | None:
        with self._lock:
            return self._free.pop() if self._free else None

    def _connect_and_begin(self, pending: _Pending) -> None:
        server = self._server
        if server is None:
            pending.finish(CallError(f"{self.name} no longer has a server on ROS 1"))
            return
        try:
            connection = self._connect(server)
        except Ros1Error as err:
            pending.finish(CallError(f"the server {server.node} of {self.name} cannot be called: {err}"))
            self._suspect(server, err)
            return
        if not pending.is_pending:
            connection.start()
            self.freed(connection, served=False)
        elif connection.begin(pending):
            connection.start()
        else:
            exhausted = not resources.has_descriptor()
            connection.end("closed the connection")
            reason = f"cannot be called: {EXHAUSTED}" if exhausted else "closed the connection at once"
            pending.finish(CallError(f"the server {server.node} of {self.name} {reason}"))

    def _connect(self, server: Registration) -> _ServerConnection:
        """Open a connection; raises `Ros1Error`. Blocks up to `_CONNECT_SECONDS`."""
        fields = {"md5sum": self.md5, "persistent": "1"}
        sock, _ = connect_service(self._context.node(), server.uri, server.topic, _CONNECT_SECONDS, **fields)
        with sock:  # closes the socket unless the connection has taken it over
            try:
                connection = _ServerConnection(sock, server, self, self._context.loop, self._context.limit)
            except OSError as err:
                raise unanswered(f"{server.topic} broke off", err) from None
        with self._lock:
            self._connections.add(connection)
        return connection

    def _suspect(self, server: Registration, err: Ros1Error) -> None:
        """Have a server's registration checked, which ends its pending calls, unless the server is only busy."""
        if isinstance(err, ExhaustedError):
            return
        if isinstance(err, UnreachableError):
            self._pool.failed(server.uri)
            # a program that computes for long, for example in one of the calls, accepts no connection meanwhile
            if err.silent and server in self.connected:
                return
        self._on_outdated(server, str(err))

    # -- the persistent connection -------------------------------------------------------------------------------------

    def _warm(self) -> None:
        """Connect in advance, so that the next call is fast and a crash of the server is noticed.

        Failed attempts are repeated with growing delays.
        """
        now = time.monotonic()
        with self._lock:
            server = self._server
            if server is None or self._connections or self._warming or self._due > now:
                return
            self._warming = True
            self._due, self._wait = now + self._wait, min(2 * self._wait, _LONGEST_WAIT)
        self._pool.submit(server.uri, lambda: self._connect_in_advance(server))

    def _connect_in_advance(self, server: Registration) -> None:
        try:
            connection = self._connect(server)
        except Ros1Error as err:
            self._suspect(server, err)
            return
        finally:
            self._warming = False
        self._pool.answered(server.uri)
        connection.start()
        self.freed(connection, served=False)
