"""A bounded XML-RPC server for the APIs of ROS 1 nodes and of the master.

One thread serves all connections, and a small thread pool runs the methods. Connections, bodies, nesting, threads and
time are limited, so that no slow or hostile client keeps others from being served. The server behaves like that of
``rosgraph.xmlrpc``, which is Python's own: HTTP/1.1 with persistent connections, ``system.multicall``, and a fault for
an unknown method.
"""

from __future__ import annotations

import contextlib
import http
import logging
import math
import socket
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any
from xmlrpc.client import INTERNAL_ERROR, INVALID_METHOD_PARAMS, METHOD_NOT_FOUND, Fault

from bridge.adapters.ros1.xmlrpc_request import (
    DEFAULT_LIMITS,
    SLOWEST,
    Head,
    HttpError,
    Limits,
    decode_call,
    encode_response,
    encode_responses,
    parse_head,
)
from bridge.concurrency import WorkerPool
from yarp_compat.threaded_loop import ThreadedLoop

_log = logging.getLogger(__name__)

Method = Callable[..., object]

_PIECE = 64 * 1024
_SMALL = 4096
_METHOD = slice(0, 256)
"""The part of a request body that contains the method's name in requests of ROS 1 clients."""

_BACKLOG = 512
_TICK = 1.0
_JOIN_SECONDS = 1.0
_KEEPALIVE = (("TCP_KEEPIDLE", 60), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 9))


class _Connection:
    """One client's connection.

    ``deadline``, on the monotonic clock, is when the arriving request must be complete or the response must be sent.
    ``charged`` is the number of the connection's bytes that count toward the limit of all requests. While ``served`` is
    true, a thread is handling the connection's request.
    """

    def __init__(self, sock: socket.socket, deadline: float) -> None:
        self.sock = sock
        self.received = bytearray()
        self.outgoing = memoryview(b"")
        self.head: Head | None = None
        self.deadline = deadline
        self.idle_since = time.monotonic()
        self.charged = 0
        self.served = False
        self.persistent = True

    @property
    def idle(self) -> bool:
        """Whether no request is arriving or being served."""
        return not (self.received or self.served or self.outgoing or self.head)


class XmlRpcServer:
    """An XML-RPC server that calls ``methods`` by name, with the parameters of each request.

    Methods run on threads of the pool; calls of the same connection run in order, calls of different connections
    concurrently. An `xmlrpc.client.Fault` that a method raises becomes the reply; any other exception is logged, and
    reported as a fault.

    Args:
        methods: the methods by name.
        address: the address on which to listen; "" for all IPv4 addresses, "::" for all IPv6 and IPv4 addresses.
        port: the port on which to listen; 0 for any free one.
        name: the name of the server's threads.
        limits: see `Limits`.
        quick: names of methods that never block. Their small calls run on the connections' thread, because switching
            threads twice costs more than such a call.

    Attributes:
        port: the port on which the server listens.

    Raises:
        OSError: the server cannot listen on this address and port.
    """

    def __init__(
        self, methods: Mapping[str, Method], address: str = "127.0.0.1", port: int = 0, *,
        name: str = "midspan-xmlrpc", limits: Limits = DEFAULT_LIMITS, quick: Collection[str] = (),
    ) -> None:  # fmt: skip
        self._quick = tuple(f"<methodName>{method}</methodName>".encode() for method in quick)
        self._methods, self._limits, self._name = methods, limits, name
        self._failed: set[str] = set()
        self._listener = _listen(address, port)
        self.port: int = self._listener.getsockname()[1]
        self._loop = ThreadedLoop(name, self._close_sockets, _log)
        self._accepting = self._scarce = self._check_due = False
        self._connections: set[_Connection] = set()
        self._buffered = 0
        self._pool = WorkerPool(limits.threads, f"{name}-call")
        self._stopping = False
        self._loop.call_soon(self._check)

    @property
    def connections(self) -> int:
        """Number of open connections."""
        return len(self._connections)

    def start(self) -> None:
        self._loop.start()

    def close(self) -> None:
        """Stop serving, and close all connections. Safe to call twice, and within a method that the server calls."""
        self._stopping = True
        self._pool.close()
        self._loop.stop(_JOIN_SECONDS)

    # -- the thread of the connections ---------------------------------------------------------------------------------

    def _check(self) -> None:
        self._check_due = False
        now = time.monotonic()
        for connection in [c for c in self._connections if c.deadline <= now]:
            self._close(connection)
        self._accept(enabled=not self._stopping)
        if self._connections or not self._accepting:
            self._check_later()

    def _check_later(self) -> None:
        if not self._check_due:
            self._check_due = True
            self._loop.call_later(_TICK, self._check)

    def _close_sockets(self) -> None:
        for connection in list(self._connections):
            self._close(connection)
        self._accept(enabled=False)
        self._listener.close()

    def _accept(self, *, enabled: bool) -> None:
        if enabled != self._accepting:
            with contextlib.suppress(OSError):  # the system cannot watch more sockets; the next check retries
                self._loop.watch(self._listener, self._accept_clients if enabled else None)
                self._accepting = enabled

    def _accept_clients(self) -> None:
        self._check_later()
        while len(self._connections) < self._limits.connections or self._close_idle():
            try:
                sock, _ = self._listener.accept()
            except BlockingIOError:
                return
            except OSError as err:  # out of descriptors: further clients wait in the backlog until the next check
                if not self._scarce:
                    _log.warning("%s: cannot accept a connection: %s", self._name, err.strerror)
                self._scarce = True
                break
            self._scarce = False
            _configure(sock)
            connection = _Connection(sock, time.monotonic() + self._limits.seconds)
            self._connections.add(connection)
            try:
                self._loop.watch(sock, partial(self._on_readable, connection))
            except OSError:  # the system cannot watch more sockets
                self._close(connection)
        self._accept(enabled=False)

    def _close_idle(self) -> bool:
        idle = [connection for connection in self._connections if connection.idle]
        if idle:
            self._close(min(idle, key=lambda connection: connection.idle_since))
        return bool(idle)

    def _close(self, connection: _Connection) -> None:
        self._loop.unwatch(connection.sock)
        self._connections.discard(connection)
        self._buffered -= connection.charged
        connection.charged = 0
        connection.sock.close()
        self._accept(enabled=not self._stopping and not self._scarce)

    def _on_readable(self, connection: _Connection) -> None:
        try:
            if self._receive(connection):
                self._advance(connection)
        except HttpError as err:
            self._reject(connection, err.status)
        except OSError:
            self._close(connection)

    def _on_writable(self, connection: _Connection) -> None:
        try:
            self._send(connection)
        except OSError:
            self._close(connection)

    def _receive(self, connection: _Connection) -> bool:
        """Read what has arrived; return False if there is nothing to process."""
        try:
            data = connection.sock.recv(_PIECE)
        except BlockingIOError:
            return False
        if not data:
            self._close(connection)
            return False
        if connection.idle:
            connection.deadline = time.monotonic() + self._limits.seconds
        connection.received += data
        connection.charged += len(data)
        self._buffered += len(data)
        if self._buffered > self._limits.buffered:
            largest = max((c for c in self._connections if not c.served), key=lambda c: c.charged)
            self._reject(largest, http.HTTPStatus.SERVICE_UNAVAILABLE)
            return largest is not connection
        return True

    def _advance(self, connection: _Connection) -> None:
        """Serve a request if it is complete; raises `HttpError` if it is invalid."""
        if connection.head is None:
            end = connection.received.find(b"\r\n\r\n", 0, self._limits.head)
            if end < 0:
                if len(connection.received) >= self._limits.head:
                    raise HttpError(http.HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
                return
            connection.head = parse_head(bytes(connection.received[:end]), self._limits.body)
            del connection.received[: end + 4]
            connection.deadline += connection.head.length / SLOWEST
            if connection.head.wants_continue and not connection.received:
                connection.sock.send(b"HTTP/1.1 100 Continue\r\n\r\n")
        head = connection.head
        if len(connection.received) < head.length:
            return
        body = bytes(connection.received[: head.length])
        del connection.received[: head.length]
        connection.head, connection.served, connection.persistent = None, True, head.persistent
        connection.deadline = math.inf
        quick = len(body) <= _SMALL and any(name in body[_METHOD] for name in self._quick)
        if quick and not connection.received:
            # respond before another connection's next call, which may cause calls that must not precede this response
            self._on_result(connection, self._serve(connection, body))
            return
        self._loop.watch(connection.sock)
        if quick:
            self._serve_later(connection, body)
        else:
            call = self._pool.submit(lambda: self._serve_later(connection, body))
            call.add_done_callback(lambda future: self._on_canceled(connection) if future.cancelled() else None)

    def _reject(self, connection: _Connection, status: http.HTTPStatus) -> None:
        connection.persistent = False
        connection.received.clear()
        line = f"HTTP/1.1 {status.value} {status.phrase}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
        self._respond(connection, line.encode())

    def _on_canceled(self, connection: _Connection) -> None:
        """Close a connection whose call no thread will run; called on any thread."""
        self._loop.call_soon(lambda: self._close(connection) if connection in self._connections else None)

    def _on_result(self, connection: _Connection, response: bytes) -> None:
        connection.served = False
        if connection in self._connections:
            self._respond(connection, response)

    def _respond(self, connection: _Connection, response: bytes) -> None:
        connection.outgoing = memoryview(response)
        connection.deadline = time.monotonic() + self._limits.seconds + len(response) / SLOWEST
        self._on_writable(connection)

    def _send(self, connection: _Connection) -> None:
        with contextlib.suppress(BlockingIOError):
            connection.outgoing = connection.outgoing[connection.sock.send(connection.outgoing) :]
        if connection.outgoing:
            self._loop.watch(connection.sock, None, partial(self._on_writable, connection))
            return
        if not connection.persistent:
            self._close(connection)
            return
        left = len(connection.received)
        self._buffered += left - connection.charged
        connection.charged = left
        connection.idle_since = time.monotonic()
        connection.deadline = connection.idle_since + self._limits.seconds if left else math.inf
        self._loop.watch(connection.sock, partial(self._on_readable, connection))
        try:
            self._advance(connection)  # the next request may have arrived already
        except HttpError as err:
            self._reject(connection, err.status)

    # -- on the pool's threads; for quick calls, on the connections' thread --------------------------------------------

    def _serve_later(self, connection: _Connection, body: bytes) -> None:
        response = self._serve(connection, body)
        self._loop.call_soon(lambda: self._on_result(connection, response))

    def _serve(self, connection: _Connection, body: bytes) -> bytes:
        method = ""
        try:
            method, params = decode_call(body, self._limits)
            if method == "system.multicall":
                response = encode_responses(map(self._call_one, _calls(params)), self._limits)
            else:
                response = encode_response(self._call(method, params))
        except Exception as err:
            response = encode_response(self._fault(method, err))
        option = "" if connection.persistent else "Connection: close\r\n"
        head = f"HTTP/1.1 200 OK\r\n{option}Content-Type: text/xml\r\nContent-Length: {len(response)}\r\n\r\n"
        return head.encode() + response

    def _call(self, method: str, params: Sequence[Any]) -> object:
        function = self._methods.get(method)
        if function is None:
            raise Fault(METHOD_NOT_FOUND, f'method "{method}" is not supported')
        return function(*params)

    def _call_one(self, call: dict[str, Any]) -> object:
        """Make one call of ``system.multicall``; its failure does not prevent the others."""
        method = ""
        try:
            method, params = call["methodName"], call["params"]
            if method != "system.multicall":
                return [self._call(method, params)]
            fault = Fault(INVALID_METHOD_PARAMS, "system.multicall cannot be nested")
        except Exception as err:
            fault = self._fault(method, err)
        return {"faultCode": fault.faultCode, "faultString": fault.faultString}

    def _fault(self, method: str, err: Exception) -> Fault:
        if isinstance(err, Fault):
            return err
        known = isinstance(method, str) and method in self._methods
        if known and method not in self._failed:  # log once for each method: clients can cause failures at any rate
            self._failed.add(method)
            _log.warning("%s: %s failed", self._name, method, exc_info=err)
        return Fault(INTERNAL_ERROR, f"{type(err).__name__}: {err}")


def _calls(params: Sequence[Any]) -> list[Any]:
    """Return the calls of ``system.multicall``; a string is rejected, since each character would count as a call."""
    if len(params) != 1 or not isinstance(params[0], list):
        raise Fault(INVALID_METHOD_PARAMS, "TypeError: system.multicall has one parameter, a list of calls")
    return list(params[0])


def _listen(address: str, port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if address == "::":
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        listener.bind((address, port))
        listener.listen(_BACKLOG)
        listener.setblocking(False)
    except OSError:
        listener.close()
        raise
    return listener


def _configure(sock: socket.socket) -> None:
    sock.setblocking(False)
    with contextlib.suppress(OSError):  # fails on macOS if the client has already closed the connection
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)  # so that the loss of a client's machine is noticed
        for name, value in _KEEPALIVE:
            if hasattr(socket, name):
                sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
