"""The connections to the other Midspan nodes, some of which no longer respond."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading

import pytest

from bridge.adapters.ros1.connection_loop import is_readable
from bridge.adapters.ros1.graph import presence
from bridge.adapters.ros1.graph.presence import FIELD, NodeConnections, NodeEntry
from bridge.adapters.ros1.handshake import encode
from tests.support.wait import until


def test_departed_node_that_does_not_respond_delays_no_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that extends the lease sends the records; closing a departed node's connection takes it a second."""
    monkeypatch.setattr(presence, "_CONNECT_SECONDS", 30.0)  # the attempts must not end by themselves meanwhile
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        port = server.getsockname()[1]
        entry = NodeEntry("owner", "daemon", "/midspan", f"http://127.0.0.1:{port}/", 1, port)
        links = NodeConnections(lambda: "/caller", lambda: None, lambda: None)
        stack.callback(links.close)
        links.follow([entry])
        (link,) = links._out.values()
        with server.accept()[0] as refused:
            refused.recv(4096)
            refused.sendall(encode({"error": "this is another node"}))
        until(lambda: not link.alive, "the node counts as dead")
        with server.accept()[0]:  # the next attempt to connect gets no response
            following = threading.Thread(target=links.follow, args=([],))
            following.start()
            until(link._closing.is_set, "the connection is being closed")
            links.announce(b"record")
            assert not links.sightings()
            assert following.is_alive(), "the record was sent before the connection has ended"
        following.join()


def test_a_silent_connection_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a suspension of either machine, the connection may stay silent for a minute, or forever."""
    monkeypatch.setattr(presence, "_CONNECT_SECONDS", 30.0)
    monkeypatch.setattr(presence, "_SILENT_SECONDS", 0.1)
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        server.settimeout(40)
        port = server.getsockname()[1]
        entry = NodeEntry("owner", "daemon", "/midspan", f"http://127.0.0.1:{port}/", 1, port)

        def accept() -> socket.socket:
            return stack.enter_context(server.accept()[0])

        def send(sock: socket.socket, *records: bytes) -> None:
            sock.sendall(encode({FIELD: entry.uri}) + b"".join(struct.pack("<I", len(r)) + r for r in records))

        def deliver(record: bytes, *before: bytes) -> None:
            """Send records until the last one arrives: a connection whose thread runs too late is replaced unread."""
            while True:
                send(accept(), *before, record)
                until(lambda: link.sighting().record == record or is_readable(server), "the record arrives")
                if link.sighting().record == record:
                    return

        links = NodeConnections(lambda: "/caller", lambda: None, lambda: None)
        stack.callback(links.close)
        stack.callback(server.close)  # before it, so that an attempt to connect does not last
        links.follow([entry])
        (link,) = links._out.values()
        deliver(b"first")
        received = link.sighting().received
        send(accept(), b"first")
        until(lambda: is_readable(server), "the silent connection is replaced")
        assert link.sighting().received == received, "a node that hangs sends its last record again"
        deliver(b"second", b"first")
        assert link.sighting().received > received


def test_connections_to_nodes_that_do_not_respond_end_at_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker that is stopped unregisters only afterwards, and is killed after a few seconds."""
    monkeypatch.setattr(presence, "_CONNECT_SECONDS", 600.0)
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        server.settimeout(40)
        port = server.getsockname()[1]
        links = NodeConnections(lambda: "/caller", lambda: None, lambda: None)
        links.follow(NodeEntry("owner", "daemon", f"/n{n}", f"http://127.0.0.1:{port}/{n}", n, port) for n in range(2))
        both = list(links._out.values())
        closing = threading.Thread(target=links.close, daemon=True)
        for _ in both:
            stack.enter_context(server.accept()[0])
        closing.start()
        until(lambda: all(link._closing.is_set() for link in both), "both end")
    closing.join()
