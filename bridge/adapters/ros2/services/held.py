"""Requests from clients whose origin is not known yet, which are served if the clients prove to be native programs."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol

from bridge.adapters.ros2.graph.graph import Ros2Graph
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.rcl import RequestId
from bridge.concurrency import DelayedCalls
from bridge.routing.edge import MadeBy

RETRY_SECONDS = 0.05
PATIENCE_SECONDS = 5.0
"""A client's origin is known once its participant has announced its nodes, which takes milliseconds."""
MOST_HELD = 1000
_MOST_NATIVE = 1000

_UNKNOWN = "the origin of its client is still unknown"


class RequestHandler(Protocol):
    """A server that receives requests of native clients."""

    name: str

    def execute(self, request: RequestId, payload: bytes, backlog: int) -> None:
        """Begin a call for a request; up to ``backlog`` more may still be taken."""

    def drop(self, reason: str) -> None:
        """Report a request that is not executed."""


class _Held(NamedTuple):
    server: RequestHandler
    request: RequestId
    payload: bytes
    backlog: int
    since: float


class HeldRequests:
    """Decides who created the clients of all servers, and holds their requests until that is known; thread-safe.

    The requests of one participant are executed in the order in which they were read, even if they are for several
    servers, because a cancel request must not overtake the goal that it cancels.

    Args:
        graph: the ROS 2 graph.
        later: makes delayed calls.
        made_by: returns who created an endpoint with a GID, according to the marks of its participant.
    """

    def __init__(self, graph: Ros2Graph, later: DelayedCalls, made_by: Callable[[bytes], MadeBy]) -> None:
        self._graph, self._later, self._made_by = graph, later, made_by
        self._lock = threading.Lock()
        self._held: dict[bytes, deque[_Held]] = {}  # by the GUID prefix of the client's participant
        self._native: set[bytes] = set()

    def receive(self, server: RequestHandler, request: RequestId, payload: bytes, backlog: int) -> None:
        """Let a server execute a native client's request; hold an unknown client's, and all that follow it."""
        if self._held and request.gid[:PREFIX_BYTES] in self._held:
            made_by = MadeBy.UNKNOWN
        else:
            made_by = self._created_by(server.name, request.gid)
        if made_by is MadeBy.NATIVE:
            server.execute(request, payload, backlog)
        elif made_by is MadeBy.UNKNOWN:
            self._hold(_Held(server, request, payload, backlog, time.monotonic()))
        # Requests of Midspan's own clients are for the native server; DDS delivers them to all servers of the service.

    def _created_by(self, service: str, gid: bytes) -> MadeBy:
        """Return who created a client; reads the graph if its participant is unknown."""
        made_by = self._made_by(gid)
        if made_by is not MadeBy.UNKNOWN:
            return made_by
        prefix = gid[:PREFIX_BYTES]
        if prefix in self._native:
            return MadeBy.NATIVE
        made_by = self._graph.client_made_by(service, prefix)
        if made_by is MadeBy.NATIVE:  # a client without type hashes; the marks do not remember its participant
            with self._lock:
                if len(self._native) >= _MOST_NATIVE:
                    self._native.clear()
                self._native.add(prefix)
        return made_by

    def _hold(self, entry: _Held) -> None:
        with self._lock:
            full = sum(map(len, self._held.values())) >= MOST_HELD
            if not full:
                self._held.setdefault(entry.request.gid[:PREFIX_BYTES], deque()).append(entry)
        if full:
            entry.server.drop(f"{_UNKNOWN}, and {MOST_HELD} requests already wait for that")
        else:
            self._later.after(RETRY_SECONDS, self._retry, once=True)

    def _retry(self) -> None:
        try:
            for prefix in tuple(self._held):
                self._release(prefix)
        finally:  # also after an error, since nothing else releases the requests
            if self._held:
                self._later.after(RETRY_SECONDS, self._retry, once=True)

    def _release(self, prefix: bytes) -> None:
        """Execute a participant's requests, until none is left or its origin is still unknown."""
        while True:
            with self._lock:
                queue = self._held[prefix]
                if not queue:
                    del self._held[prefix]  # only now, so that newer requests do not overtake the last one
                    return
                entry = queue[0]
            made_by = self._created_by(entry.server.name, entry.request.gid)
            if made_by is MadeBy.UNKNOWN and time.monotonic() < entry.since + PATIENCE_SECONDS:
                return
            with self._lock:
                queue.popleft()
            if made_by is MadeBy.NATIVE:
                entry.server.execute(entry.request, entry.payload, entry.backlog)
            elif made_by is MadeBy.UNKNOWN:
                entry.server.drop(_UNKNOWN)
