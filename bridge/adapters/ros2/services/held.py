"""Requests of clients whose origin is unknown yet: they are served once a native program is known to have sent them."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from bridge.adapters.ros2.context import Ros2Context
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.rcl import RequestId
from bridge.routing.edge import MadeBy

RETRY_SECONDS = 0.05
PATIENCE_SECONDS = 5.0
"""A client's origin is known once its participant has announced its nodes, which takes milliseconds."""
MOST_HELD = 1000
_MOST_NATIVE = 1000

_UNKNOWN = "the origin of its client is still unknown"


class _Held(NamedTuple):
    request: RequestId
    payload: bytes
    backlog: int
    since: float


class HeldRequests:
    """Decides who created the clients of a service, and holds requests until that is known; thread-safe.

    Args:
        service: its name.
        context: the edge's shared state.
        accept: called with a request of a native client, its payload and its backlog.
        failed: called with the reason why a request is dropped.
    """

    def __init__(
        self, service: str, context: Ros2Context, accept: Callable[[RequestId, bytes, int], None],
        failed: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._service, self._graph, self._later = service, context.graph, context.later
        self._made_by = context.participant.marks.made_by
        self._accept, self._failed = accept, failed
        self._lock = threading.Lock()
        self._held: deque[_Held] = deque()
        self._native: set[bytes] = set()

    def made_by(self, gid: bytes) -> MadeBy:
        """Return who created a client; reads the graph if its participant is unknown."""
        made_by = self._made_by(gid)
        if made_by is not MadeBy.UNKNOWN:
            return made_by
        prefix = gid[:PREFIX_BYTES]
        if prefix in self._native:
            return MadeBy.NATIVE
        made_by = self._graph.client_made_by(self._service, prefix)
        if made_by is MadeBy.NATIVE:  # without type hashes, which the marks do not remember
            with self._lock:
                if len(self._native) >= _MOST_NATIVE:
                    self._native.clear()
                self._native.add(prefix)
        return made_by

    def hold(self, request: RequestId, payload: bytes, backlog: int) -> None:
        """Hold a request of an unknown client, for up to `PATIENCE_SECONDS`."""
        with self._lock:
            full = len(self._held) >= MOST_HELD
            if not full:
                self._held.append(_Held(request, payload, backlog, time.monotonic()))
        if full:
            self._failed(f"{_UNKNOWN}, and {MOST_HELD} requests already wait for that")
        else:
            self._later.after(RETRY_SECONDS, self._retry, once=True)

    def _retry(self) -> None:
        with self._lock:
            held, self._held = self._held, deque()
        unknown: deque[_Held] = deque()
        for entry in held:
            made_by = self.made_by(entry.request.gid)
            if made_by is MadeBy.NATIVE:
                self._accept(entry.request, entry.payload, entry.backlog)
            elif made_by is MadeBy.UNKNOWN and time.monotonic() < entry.since + PATIENCE_SECONDS:
                unknown.append(entry)
            elif made_by is MadeBy.UNKNOWN:
                self._failed(_UNKNOWN)
        if unknown:
            with self._lock:
                self._held.extendleft(reversed(unknown))
            self._later.after(RETRY_SECONDS, self._retry, once=True)
