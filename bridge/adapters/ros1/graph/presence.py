"""The Midspan nodes on a ROS 1 network: a master parameter per node, and this daemon's dead predecessors.

Each Midspan node has an entry below ``/midspan/nodes`` on the master: ``{owner, daemon, node, uri, pid, port,
simulated}``. Its key depends only on the node's address, so that two nodes with the same name never overwrite each
other's entry. ``owner`` is a random identity in the state folder, by which a daemon recognizes its dead predecessors.
The daemon removes only their registrations from the master.

The nodes exchange everything else over direct connections, so that a crash, which breaks the connection, is noticed at
once. Each node connects to every other node's TCPROS port with the header field ``midspan_presence`` (the URI of the
target node), receives the same field, and then that node's records, each as a little-endian 32-bit length and the
bytes.
"""

from __future__ import annotations

import contextlib
import json
import logging
import socket
import struct
import threading
import time
import uuid
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from bridge.adapters.ros1.graph.state import PRESENCE, MasterState
from bridge.adapters.ros1.handshake import Header, encode, read_exactly, read_header
from bridge.adapters.ros1_peers import (
    Call,
    DeadlineSocket,
    RefusedError,
    Ros1Error,
    Ros1ProtocolError,
    UnreachableError,
    ask,
)
from bridge.concurrency import WorkerPool
from bridge.routing.edge import Sighting
from bridge.state_file import keep

_LIVENESS_SECONDS = 1.0
_ATTEMPTS = 2
"""Calls in a row without an answer after which a node counts as dead, because this process may have been suspended
during one of them. If the node's host refuses the connection, one call suffices."""


@dataclass(frozen=True, slots=True)
class NodeEntry:
    """One Midspan node on a ROS 1 network.

    ``owner`` is the random identity of the daemon's state folder; ``uri`` is for XML-RPC, ``port`` for TCPROS;
    ``simulated`` is whether the node runs on ``/clock``.
    """

    owner: str
    daemon: str
    node: str
    uri: str
    pid: int
    port: int = 0
    simulated: bool = False

    @property
    def key(self) -> str:
        """The last part of the entry's parameter name."""
        return "node_" + sha256(self.uri.encode()).hexdigest()[:12]

    @property
    def parameter(self) -> str:
        """Name of the ROS 1 parameter that holds the entry."""
        return f"{PRESENCE}/{self.key}"

    def as_dict(self) -> dict[str, Any]:
        """Return the entry as stored on the master."""
        return asdict(self)

    @classmethod
    def parse(cls, entry: Any) -> NodeEntry | None:
        """Parse an entry of a master or the state folder; None if it is malformed."""
        match entry:
            case {
                "owner": str(owner), "daemon": str(daemon), "node": str(node), "uri": str(uri), "pid": int(pid),
            } if (owner + daemon + node + uri).isprintable():  # fmt: skip
                port = entry.get("port")
                port = port if isinstance(port, int) else 0
                return cls(owner, daemon, node, uri, pid, port, entry.get("simulated") is True)
        return None


def others(state: MasterState, own: NodeEntry) -> list[NodeEntry]:
    """Return the entries of all other Midspan nodes, including dead ones."""
    entries = [NodeEntry.parse(entry) for entry in state.presence.values()]
    return [e for e in entries if e is not None and e.uri != own.uri]


def is_alive(caller: str, entry: NodeEntry) -> bool:
    """Return whether an entry's node responds, and is the process that created the entry; see `pid_of`."""
    return pid_of(caller, entry.uri) == entry.pid


def any_alive(caller: str, entries: Iterable[NodeEntry], seconds: float) -> bool:
    """Return whether any of these nodes is alive; those that do not respond within ``seconds`` count as dead.

    All are called at the same time, because their hosts may be off. Raises `ExhaustedError` like `is_alive`.
    """
    pool = WorkerPool(_MAX_LINKS, "midspan-ros1-alive")
    calls = [pool.submit(partial(is_alive, caller, entry)) for entry in entries]
    try:
        return any(not call.cancelled() and call.result() for call in as_completed(calls, seconds))
    except TimeoutError:
        return False
    finally:
        pool.close()


def pids_of(caller: str, uris: Collection[str]) -> dict[str, int | None]:
    """Return `pid_of` for each URI. All nodes are called at the same time, because their hosts may be off."""
    if len(uris) < 2:
        return {uri: pid_of(caller, uri) for uri in uris}
    pool = WorkerPool(_MAX_LINKS, "midspan-ros1-alive")
    try:
        calls = {uri: pool.submit(partial(pid_of, caller, uri)) for uri in uris}
        # a call is cancelled if the system is out of threads
        return {uri: pid_of(caller, uri) if call.cancelled() else call.result() for uri, call in calls.items()}
    finally:
        pool.close()


def pid_of(caller: str, uri: str) -> int | None:
    """Return the process id of the node at a URI, None if no node responds there. Blocks up to two seconds.

    It is 0 for a node that does not report its id. Raises `ExhaustedError`, which says nothing about the node.
    """
    for _ in range(_ATTEMPTS):
        try:
            pid = ask(uri, _LIVENESS_SECONDS, "getPid", caller)
        except RefusedError:  # an error is an answer, too
            return 0
        except UnreachableError as err:
            if err.refused:
                return None
        except Ros1ProtocolError:  # another program has the port
            return None
        else:
            return pid if isinstance(pid, int) else 0
    return None


def removal_calls(state: MasterState, dead: Iterable[NodeEntry]) -> list[Call]:
    """Return the calls to the master that remove the registrations of dead nodes."""
    calls: list[Call] = []
    for entry in dead:
        node, uri = entry.node, entry.uri
        # The master ignores these calls if another process has the node's name by now, because its address differs.
        for method, links in (("unregisterPublisher", state.publishers), ("unregisterSubscriber", state.subscribers)):
            calls += [(method, (node, k.topic, uri)) for k in links if k.node == node and k.uri == uri]
        calls += [
            ("unregisterService", (node, k.topic, k.uri))
            for k in state.servers
            if k.node == node and k.uri.endswith(f":{entry.port}")
        ]
        if NodeEntry.parse(state.presence.get(entry.key)) == entry:
            calls.append(("deleteParam", (node, entry.parameter)))
    return calls


class Ledger:
    """The record of this daemon's ROS 1 nodes in the state folder."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "ros1.json"
        saved = self._load()
        owner = saved.get("owner")
        self.owner = owner if isinstance(owner, str) and owner else uuid.uuid4().hex
        self.last = NodeEntry.parse(saved.get("last"))

    def remember(self, entry: NodeEntry | None) -> None:
        """Store the current node, None once it has stopped cleanly."""
        if entry == self.last and self._path.exists():
            return
        self.last = entry
        document = {"owner": self.owner, "last": entry.as_dict() if entry else None}
        keep(self._path, json.dumps(document), "registrations of a killed worker will stay on the master")

    def predecessors(self, state: MasterState, own: NodeEntry) -> list[NodeEntry]:
        """Return the entries of this daemon's earlier nodes, from the master and from the state folder."""
        entries = {e.uri: e for e in others(state, own) if e.owner == self.owner}
        if self.last is not None and self.last.uri != own.uri:
            entries.setdefault(self.last.uri, self.last)
        return list(entries.values())

    def _load(self) -> Mapping[str, Any]:
        try:
            document = json.loads(self._path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return {}
        return document if isinstance(document, dict) else {}


# -- the connections between the nodes ---------------------------------------------------------------------------------

_log = logging.getLogger(__name__)

FIELD = "midspan_presence"
"""Header field that requests a node's records."""

MAX_RECORD = 1 << 18
_MAX_LINKS = 64
_CONNECT_SECONDS = 1.0
_RETRY_SECONDS = 0.3
_RECONNECT_SECONDS = 0.02
_SILENT_SECONDS = 3.0
"""Seconds without a record after which a connection is replaced. Each node sends several records per second, but when
a suspended machine or a network returns, TCP may resend the next one only after a minute, or the connection may have
ended without this machine's knowledge."""

_LENGTH = struct.Struct("<I")

Caller = Callable[[], str]
Changed = Callable[[], None]


class NodeConnections:
    """The connections between one node and all others, in both directions.

    ``changed`` is called when another node has joined, left or sent a record; ``visited`` when another node has
    connected to this one, and therefore has an entry on the master by now.
    """

    def __init__(self, caller: Caller, changed: Changed, visited: Changed) -> None:
        self._caller, self._changed, self._visited = caller, changed, visited
        self._lock = threading.Lock()
        self._out: dict[str, _NodeConnection] = {}
        self._in: list[socket.socket] = []
        self._record = b""
        self._closed = False

    def follow(self, entries: Iterable[NodeEntry]) -> None:
        """Connect to each of these nodes; the connection to a node that is no longer listed stays while it lasts."""
        with self._lock:
            if self._closed:
                return
            named = {e.uri: e for e in entries}
            departed = [k for k in self._out.values() if not k.alive and k.entry.uri not in named]
            for link in departed:
                del self._out[link.entry.uri]
            for uri, entry in named.items():
                if uri not in self._out and len(self._out) < _MAX_LINKS:
                    self._out[uri] = link = _NodeConnection(entry, self._caller, self._changed)
                    link.start()
        _close(departed)  # without the lock, since this may take a second, and the lease needs `announce`

    def sightings(self) -> Sequence[Sighting]:
        """Return the nodes that are alive, or may be."""
        with self._lock:
            return [link.sighting() for link in self._out.values() if link.alive]

    def living(self) -> list[NodeEntry]:
        """Return the entries of the nodes that are alive, by name."""
        with self._lock:
            return sorted((link.entry for link in self._out.values() if link.alive), key=lambda e: e.node)

    def announce(self, record: bytes) -> None:
        """Send a record to all connected nodes; a node that does not read it is disconnected, and will reconnect."""
        self._record = record
        with self._lock:
            self._in = [sock for sock in self._in if _send(sock, record)]

    def admit(self, sock: DeadlineSocket, header: Header, own_uri: str) -> str:
        """Admit a node that has connected; return "" or why it is rejected."""
        if header[FIELD] != own_uri:
            return "this is another node"
        sock.sendall(encode({"callerid": self._caller(), FIELD: own_uri}))
        sock.setblocking(False)
        with self._lock:
            if self._closed or len(self._in) >= _MAX_LINKS:
                return "too many nodes are connected"
            if not self._record or _send(sock, self._record):
                self._in.append(sock)
        self._visited()
        return ""

    def close(self) -> None:
        with self._lock:
            self._closed = True
            links, self._out = list(self._out.values()), {}
            visitors, self._in = self._in, []
        for sock in visitors:
            sock.close()
        _close(links)


class _NodeConnection:
    """The connection to one other node, and the thread that reads it."""

    def __init__(self, entry: NodeEntry, caller: Caller, changed: Changed) -> None:
        self.entry, self._caller, self._changed = entry, caller, changed
        self.alive = True
        self._record: bytes | None = None
        self._received_at = time.monotonic()
        self._sock: DeadlineSocket | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="midspan-ros1-link", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def sighting(self) -> Sighting:
        return Sighting(self.entry.uri, self._record, self._received_at)

    def end(self) -> None:
        """Have the thread end soon."""
        self._closing.set()
        sock = self._sock
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)

    def join(self) -> None:
        self._thread.join(_CONNECT_SECONDS)

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                sock = self._connect()
            except TimeoutError:
                # the node neither responds nor refuses; its sighting keeps the time of its last record
                pass
            except (OSError, OverflowError, ValueError, Ros1Error) as err:
                self._set_alive(False, str(err))
            else:
                before = self._received_at
                with sock, contextlib.suppress(OSError, Ros1ProtocolError):
                    self._receive(sock)
                if self._received_at != before:
                    # reconnect at once, because the node may be alive; a dead node refuses the connection
                    self._closing.wait(_RECONNECT_SECONDS)
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
            raise Ros1ProtocolError(header.get("error", "it is another node"))
        return sock

    def _receive(self, sock: DeadlineSocket) -> None:
        self._sock = sock
        resent = self._record  # a node that hangs sends its last record again on a new connection
        while not self._closing.is_set():
            sock.deadline = time.monotonic() + _SILENT_SECONDS
            (length,) = _LENGTH.unpack(read_exactly(sock, _LENGTH.size))
            if length > MAX_RECORD:
                raise Ros1ProtocolError(f"a record of {length} bytes")
            record = read_exactly(sock, length)
            if record != resent:
                self._received_at = time.monotonic()
            self._record, resent = record, None
            self._set_alive(True)
            self._changed()

    def _set_alive(self, alive: bool, why: str = "") -> None:
        if alive != self.alive:
            self.alive = alive
            state = "is connected" if alive else f"is disconnected: {why}"
            _log.info("the Midspan node %s (%s) %s", self.entry.node, self.entry.daemon, state)
            self._changed()


def _close(links: Sequence[_NodeConnection]) -> None:
    """Close connections at the same time, because each may take a second, and a worker has few seconds to stop."""
    for link in links:
        link.end()
    for link in links:
        link.join()


def _send(sock: socket.socket, record: bytes) -> bool:
    """Send a record without blocking; if it cannot be sent whole, close the connection and return False."""
    data = _LENGTH.pack(len(record)) + record
    try:
        if socket.socket.send(sock, data) == len(data):
            return True
    except OSError:
        pass
    sock.close()
    return False
