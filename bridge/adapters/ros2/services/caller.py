"""A client that calls the native servers of one service on the DDS network."""

from __future__ import annotations

import contextlib
import logging
import time
from collections import deque
from functools import partial
from typing import Any

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.context import Closed, Ros2Context
from bridge.adapters.ros2.graph import vendors
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.participant import SERVICE
from bridge.adapters.ros2.rcl import ENCAPSULATION
from bridge.adapters.ros2.services.endpoint import ServiceEndpoint
from bridge.adapters.ros2.services.pacing import SentRequests
from bridge.adapters.ros2.services.sender import MATCH_POLL, refusal
from bridge.hub.endpoints.calls import Abandon, CallError, Done, UnsentCallError
from bridge.routing.edge import EdgeCaller

_MOST = SERVICE.depth // 2
"""Limit of pending calls; the engine allows fewer."""

_MATCH_SECONDS = 5.0
"""Seconds that a call waits for its server to match. Endpoints match within milliseconds, on a busy machine later."""

_log = logging.getLogger(__name__)


class _PendingCall:
    __slots__ = ("done", "request", "servers", "since")

    def __init__(self, request: bytes, done: Done) -> None:
        self.request, self.done = request, done
        self.since = time.monotonic()
        self.servers: frozenset[bytes] = frozenset()


class Ros2Caller(ServiceEndpoint, EdgeCaller):
    """A client. DDS delivers a request to every server of the service; the first reply counts."""

    def __init__(
        self, name: str, service_class: Any, context: Ros2Context, closed: Closed, type_id: str | None = None
    ) -> None:
        self._port = context.dds.open_client(name, service_class, context, self._replied, type_id)
        super().__init__(name, service_class, self._port, context)
        self._on_closed = closed
        self._waiting: deque[_PendingCall] = deque()
        self._sent: dict[int, _PendingCall] = {}
        self._requests = SentRequests()
        self._sender = self._port.sender
        self._settling_until = 0.0
        self._ended_prefixes: set[bytes] = set()
        self._matched = self._due = False
        self._update_ended()
        self._loop.add(self)
        self._prepare_cyclone()

    @override
    def call(self, request: bytes, done: Done) -> Abandon:
        """Begin a call; never blocks. A request that cannot be sent ends with an error at once."""
        pending = _PendingCall(request, done)
        with self._lock:
            refused = self._refused(request)
            if not refused:
                self._waiting.append(pending)
        if refused:
            done(refused)
        else:
            self._advance()
        return partial(self._abandon, pending)

    def _refused(self, request: bytes) -> CallError | None:
        obstacle = self._graph.snapshot.obstacles.get(self.name)
        if self._closed:
            return CallError(f"{self.name} is no longer bridged")
        if request[: len(ENCAPSULATION)] != ENCAPSULATION:
            return CallError(f"{self.name}: the request is not little-endian CDR")
        if obstacle is not None:
            return refusal(obstacle)
        if not self._servers():
            return CallError(f"{self.name} has no server on ROS 2")
        if len(self._sent) + len(self._waiting) >= _MOST:
            return CallError(f"{self.name} is busy: {_MOST} calls are pending")
        return None

    def _prepare_cyclone(self) -> None:
        """If all known servers are on Cyclone DDS, prepare them before the first call: see `RequestSender.prepare`."""
        servers = self._graph.snapshot.servers.get(self.name, frozenset())
        if servers and all(map(vendors.is_cyclone, servers)):
            self._settling_until = time.monotonic() + _MATCH_SECONDS
            self._later.after(0.0, self._settle, once=True)

    def _settle(self) -> None:
        wait = 0.0
        with self._lock, contextlib.suppress(UnsentCallError):  # the next call fails with the same error
            if not self._closed:
                wait = self._sender.prepare(self._servers())
        if wait and time.monotonic() < self._settling_until:
            self._later.after(wait, self._settle, once=True)

    def _servers(self) -> frozenset[bytes]:
        """Return the GIDs of the native servers whose processes are alive."""
        servers = self._graph.snapshot.servers.get(self.name, frozenset())
        if self._ended_prefixes:
            servers = frozenset(gid for gid in servers if gid[:PREFIX_BYTES] not in self._ended_prefixes)
        return servers

    def _advance(self) -> None:
        """Send the requests that may be sent now, and schedule the rest."""
        failed: list[tuple[_PendingCall, CallError]] = []
        with self._lock:
            wait = self._send_waiting(failed)
            if wait and not self._due:
                self._due = True
                self._later.after(wait, self._advance_later)
            if self._sent:
                self._check_soon()
        for pending, error in failed:
            _end(pending, error)

    def _advance_later(self) -> None:
        with self._lock:
            self._due = False
        self._advance()

    def _send_waiting(self, failed: list[tuple[_PendingCall, CallError]]) -> float:
        """Send waiting requests; return the seconds until the next may be sent, 0 if none waits. The lock is held."""
        while self._waiting and not self._closed:
            servers = self._servers()
            if not servers:
                self._fail_waiting(failed, CallError(f"{self.name} has no server on ROS 2"))
                return 0.0
            if not self._matched:
                self._matched = self._sender.has_server()
                if not self._matched and time.monotonic() < self._waiting[0].since + _MATCH_SECONDS:
                    return MATCH_POLL
            wait = self._requests.wait()
            if wait:
                return wait
            obstacle = self._sender.obstacle()
            if obstacle is not None:
                self._fail_waiting(failed, obstacle)
                return 0.0
            late = time.monotonic() >= self._waiting[0].since + _MATCH_SECONDS
            try:
                wait = self._sender.wait(servers) if self._matched else 0.0
            except UnsentCallError as err:
                self._fail_waiting(failed, err)
                return 0.0
            if wait and not late:
                return wait
            if self._sender.outdated:
                continue
            pending = self._waiting.popleft()
            if wait or not self._matched:
                failed.append((pending, CallError(f"the server of {self.name} on ROS 2 cannot be reached")))
                continue
            try:
                number = self._sender.send(pending.request)
            except rcl.RclError as err:
                failed.append((pending, CallError(f"{self.name}: {err}")))
                continue
            pending.servers, pending.request = servers | self._sender.recipients, b""
            self._sent[number] = pending
            self._requests.on_sent(number)
        return 0.0

    def _fail_waiting(self, failed: list[tuple[_PendingCall, CallError]], error: CallError) -> None:
        failed += [(pending, error) for pending in self._waiting]
        self._waiting.clear()

    @override
    def drain(self, taker: rcl.Taker, limit: int) -> None:
        for number, reply in self._port.replies(taker, limit):
            self._replied(number, reply)

    def _replied(self, number: int, payload: bytes) -> None:
        with self._lock:
            pending = self._sent.pop(number, None)
            self._requests.on_reply(number)
            waiting = bool(self._waiting)
        if pending is not None:
            _end(pending, payload)
        if waiting:
            self._advance()

    def refit(self) -> None:
        """End the calls whose servers have left the graph."""
        self._update_ended()
        self._prepare_cyclone()
        with self._lock:
            servers = self._servers()
            self._matched = False
            departed = [number for number, pending in self._sent.items() if not pending.servers & servers]
            ended = [self._sent.pop(number) for number in departed]
        for pending in ended:
            _end(pending, CallError(f"the server of {self.name} on ROS 2 left before it answered"))
        self._advance()

    @override
    def _check_processes(self) -> None:
        with self._lock:
            self._checking = False
            if self._sent and not self._closed:
                self._check_soon()
        before = self._ended_prefixes
        if self._update_ended() - before:
            self.refit()

    def _update_ended(self) -> set[bytes]:
        """Update and return the GUID prefixes of servers whose processes have ended; new servers count as alive."""
        self._ended_prefixes = self._ended_among(self._graph.snapshot.servers.get(self.name, frozenset()))
        return self._ended_prefixes

    def _abandon(self, pending: _PendingCall) -> None:
        with self._lock:
            if pending in self._waiting:
                self._waiting.remove(pending)
            for number in [number for number, other in self._sent.items() if other is pending]:
                del self._sent[number]

    @override
    def close(self) -> None:
        with self._lock:
            if self._closed:
                return
            self._closed = True
            ended = [*self._sent.values(), *self._waiting]
            self._sent.clear()
            self._waiting.clear()
            self._sender.close()
        self._loop.remove(self)
        for pending in ended:
            _end(pending, CallError(f"{self.name} is no longer bridged"))
        self._on_closed(self)


def _end(pending: _PendingCall, result: bytes | CallError) -> None:
    try:
        pending.done(result)
    except Exception:
        _log.exception("the callback of an ended call failed")
