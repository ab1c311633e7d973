"""The connections to the other Midspan nodes, some of which no longer respond."""

from __future__ import annotations

import contextlib
import socket
import threading

import pytest

from bridge.adapters.ros1.graph import presence
from bridge.adapters.ros1.graph.presence import NodeConnections, NodeEntry
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
