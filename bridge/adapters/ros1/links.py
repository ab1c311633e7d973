"""What the Midspan nodes of one ROS 1 network tell each other, over connections between them.

The master's presence entries say who is there; everything else goes from node to node, so that a death is known at
once: the connection breaks. Each node connects to every other one's TCPROS port with the header field
``midspan_presence`` (the uri of the node that it seeks), is answered with the same field, and then hears that node's
records: a little-endian 32-bit length and so many bytes, each.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from urllib.parse import urlsplit

from bridge.adapters.base import Sighting
from bridge.adapters.ros1.deadline import DeadlineSocket
from bridge.adapters.ros1.errors import ProtocolError, Ros1Error
from bridge.adapters.ros1.handshake import Header, encode, read_exactly, read_header
from bridge.adapters.ros1.presence import Presence

_log = logging.getLogger(__name__)

FIELD = "midspan_presence"
"""Header field that asks for a node's records."""

MAX_RECORD = 1 << 18
_MAX_LINKS = 64
_CONNECT_SECONDS = 1.0
_RETRY_SECONDS = 0.3
_AGAIN_SECONDS = 0.02
_LENGTH = struct.Struct("<I")

Caller = Callable[[], str]
Changed = Callable[[], None]


class Links:
    """The connections of one node to all others and from them.

    Args:
        caller: our node's name now.
        changed: called when another node came, left, or said something.
        visited: called when another node has connected to us: it has an entry on the master by now.
    """

    def __init__(self, caller: Caller, changed: Changed, visited: Changed) -> None:
        self._caller, self._changed, self._visited = caller, changed, visited
        self._lock = threading.Lock()
        self._out: dict[str, _Link] = {}
        self._in: list[socket.socket] = []
        self._record = b""
        self._closed = False

    def follow(self, entries: Iterable[Presence]) -> None:
        """Have a connection to each of these nodes; one that is no longer named keeps its connection while it lasts."""
        with self._lock:
            if self._closed:
                return
            named = {e.uri: e for e in entries}
            for link in [k for k in self._out.values() if not k.alive and k.entry.uri not in named]:
                link.close()
                del self._out[link.entry.uri]
            for uri, entry in named.items():
                if uri not in self._out and len(self._out) < _MAX_LINKS:
                    self._out[uri] = link = _Link(entry, self._caller, self._changed)
                    link.start()

    def sightings(self) -> Sequence[Sighting]:
        """The nodes that live, or of which that is not known yet."""
        with self._lock:
            return [link.sighting() for link in self._out.values() if link.alive]

    def living(self) -> list[Presence]:
        """The entries of the nodes that live."""
        with self._lock:
            return sorted((link.entry for link in self._out.values() if link.alive), key=lambda e: e.node)

    def announce(self, record: bytes) -> None:
        """Send a record to all that are connected; one that takes nothing any more is cut off, and comes again."""
        self._record = record
        with self._lock:
            self._in = [sock for sock in self._in if _send(sock, record)]

    def admit(self, sock: DeadlineSocket, header: Header, own_uri: str) -> str:
        """Take in a node that connected to us; "" or why it is not taken."""
        if header[FIELD] != own_uri:
            return "this is another node"
        sock.sendall(encode({"callerid": self._caller(), FIELD: own_uri}))
        sock.setblocking(False)
        with self._lock:
            if self._closed or len(self._in) >= _MAX_LINKS:
                return "no more nodes are taken"
            if not self._record or _send(sock, self._record):
                self._in.append(sock)
        self._visited()
        return ""

    def close(self) -> None:
        """Cut all connections."""
        with self._lock:
            self._closed = True
            links, self._out = list(self._out.values()), {}
            visitors, self._in = self._in, []
        for sock in visitors:
            sock.close()
        for link in links:
            link.close()


class _Link:
    """The connection to one other node, and the thread that reads it."""

    def __init__(self, entry: Presence, caller: Caller, changed: Changed) -> None:
        self.entry, self._caller, self._changed = entry, caller, changed
        self.alive = True
        self._record: bytes | None = None
        self._heard = time.monotonic()
        self._sock: DeadlineSocket | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-ros1-link", daemon=True)

    def start(self) -> None:
        """Start connecting."""
        self._thread.start()

    def sighting(self) -> Sighting:
        """What is known of the node."""
        return Sighting(self.entry.uri, self._record, self._heard)

    def close(self) -> None:
        """Cut the connection."""
        self._closing.set()
        sock = self._sock
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        self._thread.join(_CONNECT_SECONDS)

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                sock = self._connect()
            except TimeoutError:
                # It neither answers nor refuses: whoever asks is told when it was last heard.
                pass
            except (OSError, OverflowError, ValueError, Ros1Error) as err:
                self._live(False, str(err))
            else:
                before = self._heard
                with contextlib.suppress(OSError, ProtocolError):
                    self._hear(sock)
                sock.close()
                if self._heard != before:
                    # A node that lives is connected again at once; a dead one refuses.
                    self._closing.wait(_AGAIN_SECONDS)
                    continue
            self._closing.wait(_RETRY_SECONDS)

    def _connect(self) -> DeadlineSocket:
        host = urlsplit(self.entry.uri).hostname or ""
        deadline = time.monotonic() + _CONNECT_SECONDS
        sock = DeadlineSocket.connected(host, self.entry.port, deadline)
        try:
            sock.sendall(encode({"callerid": self._caller(), FIELD: self.entry.uri}))
            header = read_header(sock)
        except BaseException:
            sock.close()
            raise
        if header.get(FIELD) != self.entry.uri:
            sock.close()
            msg = header.get("error", "it is another node")
            raise ProtocolError(msg)
        return sock

    def _hear(self, sock: DeadlineSocket) -> None:
        self._sock = sock
        sock.deadline = float("inf")
        while not self._closing.is_set():
            (length,) = _LENGTH.unpack(read_exactly(sock, _LENGTH.size))
            if length > MAX_RECORD:
                msg = f"a record of {length} bytes"
                raise ProtocolError(msg)
            self._record, self._heard = read_exactly(sock, length), time.monotonic()
            self._live(True)
            self._changed()

    def _live(self, alive: bool, why: str = "") -> None:
        if alive != self.alive:
            self.alive = alive
            state = "is there" if alive else f"is gone: {why}"
            _log.info("the Midspan node %s (%s) %s", self.entry.node, self.entry.daemon, state)
            self._changed()


def _send(sock: socket.socket, record: bytes) -> bool:
    """Send a record without waiting; False, and the connection is closed, where it cannot be sent whole."""
    data = _LENGTH.pack(len(record)) + record
    try:
        if socket.socket.send(sock, data) == len(data):
            return True
    except OSError:
        pass
    sock.close()
    return False
