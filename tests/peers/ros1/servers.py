"""Misbehaving peers: loopback servers whose responses the test determines."""

from __future__ import annotations

import contextlib
import socket
import socketserver
import threading
from collections.abc import Callable, Iterator
from typing import Any
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer


@contextlib.contextmanager
def tcp_server(serve: Callable[[socket.socket], None]) -> Iterator[tuple[str, int]]:
    """Run a TCP server that passes each connection to ``serve`` on a separate thread; yield its address."""
    listener = socket.create_server(("127.0.0.1", 0), backlog=64)
    threads: list[threading.Thread] = []
    connections: list[socket.socket] = []

    def guarded(sock: socket.socket) -> None:
        with contextlib.suppress(OSError), sock:
            serve(sock)

    def accept() -> None:
        with contextlib.suppress(OSError):
            while True:
                sock, _ = listener.accept()
                connections.append(sock)
                threads.append(threading.Thread(target=guarded, args=(sock,), daemon=True))
                threads[-1].start()

    acceptor = threading.Thread(target=accept, daemon=True)
    acceptor.start()
    try:
        yield listener.getsockname()[:2]
    finally:
        with contextlib.suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        for sock in connections:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        acceptor.join(5)
        for thread in threads:
            thread.join(5)
        for sock in connections:
            sock.close()


def until_closed(sock: socket.socket) -> None:
    """Send nothing until the peer disconnects."""
    while sock.recv(65536):
        pass


class _Handler(SimpleXMLRPCRequestHandler):
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: Any) -> None:
        """Log nothing."""


class _Server(socketserver.ThreadingMixIn, SimpleXMLRPCServer):
    """Serves each connection on a separate thread, and closes all connections when it is closed."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler, allow_none=True)
        self.connections: list[socket.socket] = []

    def get_request(self) -> tuple[socket.socket, Any]:
        """Accept a connection, and record it."""
        sock, address = super().get_request()
        self.connections.append(sock)
        return sock, address

    def server_close(self) -> None:
        """Close all connections and wait for their threads."""
        for sock in self.connections:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        super().server_close()


@contextlib.contextmanager
def node(**methods: Callable[..., Any]) -> Iterator[str]:
    """Run an XML-RPC server with the given methods, like a ROS 1 node's; yield its address."""
    with _Server() as server:
        server.register_multicall_functions()
        for name, method in methods.items():
            server.register_function(method, name)
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()
            thread.join(5)


@contextlib.contextmanager
def publisher(serve: Callable[[socket.socket], None]) -> Iterator[str]:
    """Run a node whose publications are all served by ``serve``; yield its address."""
    with (
        tcp_server(serve) as (host, port),
        node(requestTopic=lambda _caller, _topic, _protocols: [1, "", ["TCPROS", host, port]]) as uri,
    ):
        yield uri
