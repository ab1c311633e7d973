"""Calls of the servers of one name on the DDS network."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

from bridge.adapters.base import EdgeCaller
from bridge.adapters.ros2 import rcl, service_rcl
from bridge.adapters.ros2.loop import Reader
from bridge.adapters.ros2.mark import PREFIX_BYTES
from bridge.adapters.ros2.qos import SERVICE
from bridge.adapters.ros2.service_bytes import ENCAPSULATION
from bridge.adapters.ros2.service_parts import Parts
from bridge.adapters.ros2.service_window import Requests
from bridge.hub.call import Abandon, CallError, Done

_MOST = SERVICE.depth // 2
"""Calls of one caller under way; the engine allows less."""

_LOOK = 0.5
_MATCH = 0.01
_MATCH_SECONDS = 5.0
"""DDS endpoints that are on the graph find each other within milliseconds; on a machine that is busy, later."""

_log = logging.getLogger(__name__)


class _Calling:
    """One call under way."""

    __slots__ = ("done", "request", "servers", "since")

    def __init__(self, request: bytes, done: Done) -> None:
        self.request, self.done = request, done
        self.since = time.monotonic()
        self.servers: frozenset[bytes] = frozenset()


class Ros2Caller(Reader, EdgeCaller):
    """An rcl client. A request goes to every server of the name, and the first reply counts, as always on DDS."""

    kind: ClassVar[str] = "client"

    def __init__(
        self,
        name: str,
        service_class: Any,
        parts: Parts,
        closed: Callable[[Ros2Caller], None],
    ) -> None:
        self.name, self.type_name = name, str(service_class.type_name)
        self._participant, self._loop, self._graph = parts.participant, parts.loop, parts.graph
        self._later, self._lives, self._on_closed = parts.later, parts.lives, closed
        self._taker = service_rcl.CallTaker()
        self._lock = threading.Lock()
        self._waiting: deque[_Calling] = deque()
        self._sent: dict[int, _Calling] = {}
        self._requests = Requests()
        self._gone: set[bytes] = set()
        self._matched = self._due = self._looking = self._closed = False
        self._handle = parts.participant.make_client(service_class, name, SERVICE)
        # Held until `destroy`, so that the pointer stays good whatever thread closes the caller.
        self._handle.__enter__()
        self._pointer = int(self._handle.pointer)
        self._find_gone()
        self._loop.add(self)

    @property
    def handle(self) -> Any:
        """See `Reader`."""
        return self._handle

    @property
    def pointer(self) -> int:
        """See `Reader`."""
        return self._pointer

    def call(self, request: bytes, done: Done) -> Abandon:
        """See `EdgeCaller`."""
        calling = _Calling(request, done)
        with self._lock:
            refused = self._refused(request)
            if not refused:
                self._waiting.append(calling)
        if refused:
            done(CallError(refused))
        else:
            self._advance()
        return partial(self._abandon, calling)

    def _refused(self, request: bytes) -> str:
        if self._closed:
            return f"{self.name} is not bridged any more"
        if request[: len(ENCAPSULATION)] != ENCAPSULATION:
            return f"{self.name}: the request is no little-endian CDR"
        if not self._servers():
            return f"{self.name} has no server on ROS 2"
        if len(self._sent) + len(self._waiting) >= _MOST:
            return f"{self.name} is busy: {_MOST} calls are under way"
        return ""

    def _servers(self) -> frozenset[bytes]:
        """GIDs of the native servers that live."""
        servers = self._graph.snapshot.servers.get(self.name, frozenset())
        if self._gone:
            servers = frozenset(gid for gid in servers if gid[:PREFIX_BYTES] not in self._gone)
        return servers

    def _advance(self) -> None:
        """Send what may be sent now, and come again for the rest."""
        failed: list[tuple[_Calling, str]] = []
        with self._lock:
            wait = self._send_waiting(failed)
            if wait and not self._due:
                self._due = True
                self._later.after(wait, self._advance_later)
            if self._sent:
                self._look_soon(_LOOK)
        for calling, why in failed:
            _end(calling, CallError(why))

    def _advance_later(self) -> None:
        with self._lock:
            self._due = False
        self._advance()

    def _send_waiting(self, failed: list[tuple[_Calling, str]]) -> float:
        """Send under the lock; seconds until the next can go, 0 where none waits."""
        while self._waiting and not self._closed:
            servers = self._servers()
            if not servers:
                failed += [(calling, f"{self.name} has no server on ROS 2") for calling in self._waiting]
                self._waiting.clear()
                return 0.0
            if not self._matched:
                self._matched = service_rcl.has_server(self._participant.pointer, self._pointer)
                if not self._matched and time.monotonic() < self._waiting[0].since + _MATCH_SECONDS:
                    return _MATCH
            wait = self._requests.wait()
            if wait:
                return wait
            calling = self._waiting.popleft()
            if not self._matched:
                failed.append((calling, f"the server of {self.name} on ROS 2 cannot be reached"))
                continue
            try:
                number = service_rcl.send_request(self._pointer, calling.request)
            except rcl.RclError as err:
                failed.append((calling, f"{self.name}: {err}"))
                continue
            calling.servers, calling.request = servers, b""
            self._sent[number] = calling
            self._requests.sent(number)
        return 0.0

    def wake(self, descriptor: int | None) -> None:
        """See `Reader`."""
        service_rcl.wake_by_responses(self._pointer, descriptor)

    def drain(self, _taker: rcl.Taker, limit: int) -> bool:
        """See `Reader`."""
        for _ in range(limit):
            taken = self._taker.response(self._pointer)
            if taken is None:
                continue  # a reply to another client: every client of a name is given all
            request, payload = taken
            with self._lock:
                calling = self._sent.pop(request.number, None)
                self._requests.answered(request.number)
                waiting = bool(self._waiting)
            if calling is not None:
                _end(calling, payload)
            if waiting:
                self._advance()
        return True

    def refit(self) -> None:
        """End the calls whose servers have left."""
        self._find_gone()
        with self._lock:
            servers = self._servers()
            self._matched = False
            left = [number for number, calling in self._sent.items() if not calling.servers & servers]
            ended = [self._sent.pop(number) for number in left]
        for calling in ended:
            _end(calling, CallError(f"the server of {self.name} on ROS 2 left before it answered"))
        self._advance()

    def _look_soon(self, seconds: float) -> None:
        if not self._looking:
            self._looking = True
            self._later.after(seconds, self._look)

    def _look(self) -> None:
        """Find servers whose processes have ended, while a call waits for them."""
        with self._lock:
            self._looking = False
            if self._sent and not self._closed:
                self._look_soon(_LOOK)
        before = self._gone
        if self._find_gone() - before:
            self.refit()

    def _find_gone(self) -> set[bytes]:
        """Look which servers' processes have ended; one that is new is then remembered as living."""
        servers = self._graph.snapshot.servers.get(self.name, frozenset())
        prefixes = {gid[:PREFIX_BYTES] for gid in servers}
        self._gone = {prefix for prefix in prefixes if self._lives.is_gone(prefix)}
        return self._gone

    def _abandon(self, calling: _Calling) -> None:
        with self._lock:
            if calling in self._waiting:
                self._waiting.remove(calling)
            for number in [number for number, other in self._sent.items() if other is calling]:
                del self._sent[number]

    def close(self) -> None:
        """See `EdgeCaller`."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            ended = [*self._sent.values(), *self._waiting]
            self._sent.clear()
            self._waiting.clear()
        self._loop.remove(self)
        for calling in ended:
            _end(calling, CallError(f"{self.name} is not bridged any more"))
        self._on_closed(self)

    def destroy(self) -> None:
        """See `Reader`."""
        self._taker.close()
        self._handle.__exit__(None, None, None)
        self._participant.destroy(self._handle)


def _end(calling: _Calling, result: bytes | CallError) -> None:
    try:
        calling.done(result)
    except Exception:
        _log.exception("telling of a call's end failed")
