"""Servers on the DDS network that forward requests and return the replies."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from typing_extensions import override

from bridge.adapters.ros2 import rcl
from bridge.adapters.ros2.context import Closed, Ros2Context
from bridge.adapters.ros2.graph.origins import PREFIX_BYTES
from bridge.adapters.ros2.rcl import ENCAPSULATION, RequestId
from bridge.adapters.ros2.services import cyclone
from bridge.adapters.ros2.services.endpoint import ServiceEndpoint
from bridge.adapters.ros2.services.pacing import ClientReplies
from bridge.hub.endpoints.calls import Abandon, Call, CallError
from bridge.messages.errors import MessageError, MessageTypeError
from bridge.messages.transcode.conversion import Convert
from bridge.messages.unchanged import same
from bridge.routing.edge import EdgeServer

_LINGER = 1.0
"""Seconds that a server stays after its last reply, because a client that first notices the server's exit drops the
reply. A server that can refuse calls stays that long after `close`, because a client that has not noticed the close may
still call, for example for the result of a goal that was accepted just before.
"""

_CLOSED = "{} is no longer bridged"
_MOST_CLIENTS = 1000
_LOG_SECONDS = 10.0
_NO_REPLY = "ROS 2 has no error replies, so its client keeps waiting"

_log = logging.getLogger(__name__)

Refusal = Callable[[], bytes]
"""Returns the rejecting response of a service type."""

ClientConverters = Callable[[str], tuple[Convert, Convert] | None]
"""Returns the converters of requests and replies for a client's hash of the type; None if its version is unknown."""


class _PendingRequest:
    """A request that has no reply yet.

    ``header`` is Cyclone DDS's, b"" for a client on Fast DDS. From ``listed_by`` on (monotonic clock) the graph lists
    the client unless it has left. ``seen``: the graph has listed it; ``left``: the call is to be abandoned.
    """

    __slots__ = ("abandon", "header", "id", "left", "listed_by", "seen")

    def __init__(self, request: RequestId, header: bytes, listed_by: float) -> None:
        self.id, self.header, self.listed_by = request, header, listed_by
        self.abandon: Abandon | None = None
        self.seen = self.left = False


class Ros2Server(ServiceEndpoint, EdgeServer):
    """A server.

    DDS has no error replies. A client whose call failed gets the rejecting response of the service's type
    (``refusal``), or no reply if the type has none; the reason is logged. ``replaced`` returns whether another server
    of the name is open, which gets the requests that arrive after `close`.
    """

    def __init__(
        self, name: str, service_class: Any, call: Call, refusal: Refusal | None, replaced: Callable[[], bool],
        context: Ros2Context, closed: Closed, converters: ClientConverters = lambda _hash: (same, same),
    ) -> None:  # fmt: skip
        self._port = context.dds.open_server(name, service_class, context)
        super().__init__(name, service_class, self._port, context)
        self._call, self._refusal, self._replaced, self._on_closed = call, refusal, replaced, closed
        self._pending: dict[RequestId, _PendingRequest] = {}
        self._clients: dict[bytes, ClientReplies] = {}
        self._converters, self._client_types = converters, dict[bytes, str]()
        self._held = context.held
        self._logged_at = self._replied_at = float("-inf")
        self._alive = threading.Lock()
        self._destroyed = False
        self._loop.add(self)

    @override
    def drain(self, taker: rcl.Taker, limit: int) -> None:
        """Begin a call for each request of a native client."""
        for request, payload in self._port.requests(taker, limit):
            self._held.receive(self, request, payload, limit)

    def execute(self, request: RequestId, payload: bytes, backlog: int) -> None:
        """Begin a call for a request; up to ``backlog`` more may still be taken."""
        try:
            header, payload = self._port.unwrap(request, payload)
            payload = self._for_client(request.gid)[0](payload)
        except MessageError as err:
            self.drop(str(err))
            return
        listed_by = time.monotonic() + self._port.listed_after
        self._begin(_PendingRequest(request, header, listed_by), payload, backlog)

    def _for_client(self, gid: bytes) -> tuple[Convert, Convert]:
        """Return the converters for a client; raises `MessageTypeError` if its version of the type is unknown."""
        type_id = self._client_type(gid)
        converters = (same, same) if type_id is None else self._converters(type_id)
        if converters is None:
            raise MessageTypeError(f"its client has an unknown version of {self.type_name} ({type_id})")
        return converters

    def _client_type(self, gid: bytes) -> str | None:
        """Return the hash of a client's version of the type, "" if it announces none; None before it is discovered."""
        prefix = gid[:PREFIX_BYTES]
        if prefix not in self._client_types:
            if len(self._client_types) >= _MOST_CLIENTS:
                self._client_types.clear()
            self._client_types |= self._graph.client_types(self.name)
        return self._client_types.get(prefix)

    def _begin(self, pending: _PendingRequest, payload: bytes, backlog: int) -> None:
        with self._lock:
            closed = self._closed
            if closed and (self._refusal is None or self._replaced()):
                return
            self._pending[pending.id] = pending
            self._client(pending.id.gid).on_request(backlog)
            if not closed:
                self._check_soon()
        if closed:
            self._answer(pending, CallError(_CLOSED.format(self.name)))
            return
        try:
            abandon = self._call(payload, partial(self._answer, pending))
        except Exception:
            _log.exception("%s: beginning a call failed", self.name)
            self._answer(pending, CallError("the bridge failed"))
            return
        with self._lock:
            pending.abandon, left = abandon, pending.left
        if left:
            abandon()

    def _answer(self, pending: _PendingRequest, result: bytes | CallError) -> None:
        with self._lock:
            if self._pending.pop(pending.id, None) is None:
                return
            client = self._client(pending.id.gid)
        if isinstance(result, CallError) or result[: len(ENCAPSULATION)] != ENCAPSULATION:
            reason = str(result) if isinstance(result, CallError) else "the reply is not little-endian CDR"
            refusal = self._refuse(reason)
            if refusal is None:
                client.on_no_reply()
                return
            result = refusal
        try:
            result = self._for_client(pending.id.gid)[1](result)
        except MessageError as err:
            self._log_failure(str(err))
            client.on_no_reply()
            return
        self._replied_at = time.monotonic()
        client.send(pending.id, cyclone.wrap(pending.header, result) if pending.header else result)

    def _client(self, gid: bytes) -> ClientReplies:
        client = self._clients.get(gid)
        if client is None:
            if len(self._clients) >= _MOST_CLIENTS:
                self._clients = {gid: entry for gid, entry in self._clients.items() if entry.busy}
                self._port.retain(set(self._clients))
            client = self._clients[gid] = ClientReplies(self._write, self._later)
            self._later.after(0.0, partial(self._processes.has_ended, gid[:PREFIX_BYTES]))
        return client

    def _refuse(self, reason: str) -> bytes | None:
        response = self._refusal() if self._refusal is not None else None
        self._log_failure(reason, _NO_REPLY if response is None else "its client received a rejection")
        return response

    def drop(self, reason: str) -> None:
        """Report a request that is not executed."""
        self._log_failure(reason)

    def _log_failure(self, reason: str, outcome: str = _NO_REPLY) -> None:
        if time.monotonic() - self._logged_at > _LOG_SECONDS:
            self._logged_at = time.monotonic()
            _log.warning("a call of %s failed: %s; %s", self.name, reason, outcome)

    def _write(self, request: RequestId, payload: bytes) -> bool:
        """Send a reply; return False if its client is unreachable."""
        with self._alive:
            if self._destroyed:
                return True
            try:
                return self._port.send(request, payload)
            except rcl.RclError as err:
                _log.warning("%s: a reply could not be sent: %s", self.name, err)
                return True

    def refit(self) -> None:
        """Abandon the calls whose clients have left the graph."""
        with self._lock:
            waiting = list(self._pending.values())
        if not waiting:
            return
        clients = self._graph.clients(self.name)
        ended, now = self._ended_among(clients), time.monotonic()
        for pending in waiting:
            if pending.id.gid in clients and pending.id.gid[:PREFIX_BYTES] not in ended:
                pending.seen = True
            elif pending.seen or pending.id.gid[:PREFIX_BYTES] in ended or now > pending.listed_by:
                self._abandon(pending)

    def _abandon(self, pending: _PendingRequest) -> None:
        with self._lock:
            if self._pending.pop(pending.id, None) is None:
                return
            pending.left, abandon = True, pending.abandon
            self._clients.pop(pending.id.gid, None)
            self._port.discard(pending.id.gid)
        if abandon is not None:
            abandon()

    @override
    def _check_processes(self) -> None:
        with self._lock:
            self._checking = False
            if self._closed or not self._pending:
                return
            self._check_soon()
        self.refit()

    @override
    def close(self) -> None:
        """Abandon pending calls with an error, and stop serving. Safe to call twice."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            waiting = [(pending, pending.abandon) for pending in self._pending.values()]
            for pending, _ in waiting:
                pending.left = True  # `_begin` abandons a call that it is just starting
        for pending, abandon in waiting:
            if abandon is not None:
                abandon()
            self._answer(pending, CallError(_CLOSED.format(self.name)))
        with self._lock:
            clients = list(self._clients.values())
        for client in clients:
            client.flush()
        if self._refusal is not None or self._replied_at > time.monotonic() - _LINGER:
            self._later.after(_LINGER, partial(self._loop.remove, self))
        else:
            self._loop.remove(self)
        self._on_closed(self)

    @override
    def destroy(self) -> None:
        """Destroy the service, even while a reply is being sent."""
        with self._alive:
            self._destroyed = True
            super().destroy()
