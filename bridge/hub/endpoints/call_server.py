"""Servers for service calls, which are zenoh queries on one key."""

from __future__ import annotations

import logging
from collections.abc import Callable
from threading import Lock
from typing import Any

import zenoh

from bridge.hub.endpoints.calls import LEFT, MAX_ERROR, REFUSED_ENCODING, Abandon, Call, CallError, UnsentCallError
from bridge.hub.opening import prepare_to_send
from bridge.hub.zenoh_compat import answer, keep_thread_state, undeclare

_log = logging.getLogger(__name__)

Refuse = Callable[[zenoh.Query, bytes], None]


def reply_error(query: zenoh.Query, error: CallError, refuse: Refuse | None = None) -> None:
    """End a query with a zenoh error reply; if the error has a ``reply`` of the service's type, ``refuse`` sends it."""
    refused = isinstance(error, UnsentCallError)
    try:
        with query:
            query.reply_err(str(error)[:MAX_ERROR].encode(), encoding=REFUSED_ENCODING if refused else None)
            if error.reply and refuse is not None:
                refuse(query, error.reply)
    except zenoh.ZError as err:
        _log.debug("the client no longer waits for the reply: %s", err)


class PendingRequest:
    """A request that waits for its reply.

    Attributes:
        caller: GID of the service client; empty if unknown.
    """

    caller = b""

    def __init__(self, query: zenoh.Query, answer: Callable[[Any, bytes | CallError], None]) -> None:
        self.query, self._answer = query, answer
        self.abandon: Abandon | None = None
        self.left = False

    def __call__(self, result: bytes | CallError) -> None:
        """Reply, unless the request has ended."""
        self._answer(self, result)


class CallServer:
    """A server with a queryable on one key. Safe to use from any thread.

    Args:
        limit: maximum size of a request or reply, in bytes.
        closed: called once with the server when it has closed.
        complete: whether the queryable is declared complete.
        reach: which sessions' calls are accepted, by default those of other sessions.
    """

    encoding: zenoh.Encoding | None = None
    _withdraw: Callable[[], None]

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        name: str,
        limit: int,
        call: Call,
        closed: Callable[[Any], None],
        *,
        complete: bool = False,
        reach: zenoh.Locality = zenoh.Locality.REMOTE,
    ) -> None:
        self.name = name
        self._key, self._limit, self._call, self._on_close = key, limit, call, closed
        self._lock = Lock()
        self._waiting: dict[PendingRequest, None] = {}
        self._closed = False
        self._declared: list[Any] = self._declare_additional(session, reach)
        self._declared.append(answer(session, key, self._on_query, complete=complete, origin=reach))

    def _declare_additional(self, session: zenoh.Session, reach: zenoh.Locality) -> list[Any]:  # noqa: ARG002
        """Declare additional endpoints; called before the queryable exists, so that its clients can use them."""
        return []

    def _is_call(self, query: zenoh.Query) -> bool:  # noqa: ARG002
        """Return whether a query is a call; other queries end without a reply."""
        return True

    def _pending(self, query: zenoh.Query) -> PendingRequest:
        """Return the pending request of a query; raises `CallError` if it is malformed."""
        return PendingRequest(query, self._answer)

    def _request(self, payload: bytes) -> bytes:
        """Return the request in the payload of a query, which may be empty; raises `CallError`."""
        return payload

    def _attached(self, pending: PendingRequest) -> bytes | None:  # noqa: ARG002
        return None

    def _outgoing(self, query: zenoh.Query, reply: bytes) -> bytes | CallError:  # noqa: ARG002
        """Convert a reply to the form that the query's client expects."""
        return reply

    def _reply_key(self, query: zenoh.Query) -> str:  # noqa: ARG002
        return self._key

    def _on_pending(self, pending: PendingRequest) -> None:
        """Handle a new pending request; called with the lock held."""

    def _on_removed(self, pending: PendingRequest) -> None:
        """Handle a request that is no longer pending."""

    def close(self) -> None:
        """Answer all pending requests with an error, and undeclare the server. Safe to call twice."""
        with self._lock:
            closed, self._closed = self._closed, True
            waiting = list(self._waiting)
        if not closed:
            self._withdraw()
            for pending in waiting:
                self._abandon(pending)
                self._answer(pending, CallError(LEFT.format(name=self.name)))
            undeclare(*self._declared)
            self._on_close(self)

    def _on_query(self, query: zenoh.Query) -> None:
        """Start a call; runs on zenoh's receiving thread."""
        keep_thread_state()
        if not self._is_call(query):
            query.drop()  # type: ignore[no-untyped-call]
            return
        try:
            request = self._read(query)
            pending = self._pending(query)
        except CallError as err:
            reply_error(query, err)
            return
        with self._lock:
            closed = self._closed
            if not closed:
                self._waiting[pending] = None
                self._on_pending(pending)
        if closed:
            reply_error(query, CallError(LEFT.format(name=self.name)))
            return
        abandon = self._call(request, pending)
        with self._lock:
            pending.abandon = abandon
            left = pending.left
        if left:
            abandon()

    def _read(self, query: zenoh.Query) -> bytes:
        payload = query.payload
        if payload is not None and len(payload) > self._limit:
            raise CallError(f"the request has {len(payload)} bytes, limits.message allows {self._limit}")
        return self._request(b"" if payload is None else payload.to_bytes())

    def _remove(self, pending: PendingRequest) -> bool:
        """Drop a request; return whether it was still pending."""
        with self._lock:
            waited = pending in self._waiting
            self._waiting.pop(pending, None)
        if waited:
            self._on_removed(pending)
        return waited

    def _answer(self, pending: PendingRequest, result: bytes | CallError) -> None:
        if not self._remove(pending):
            return
        if isinstance(result, bytes):
            result = self._outgoing(pending.query, result)
        if isinstance(result, bytes) and len(result) > self._limit:
            result = CallError(f"the reply has {len(result)} bytes, limits.message allows {self._limit}")

        def reply(query: zenoh.Query, payload: bytes) -> None:
            prepare_to_send(len(payload))
            query.reply(self._reply_key(query), payload, encoding=self.encoding, attachment=self._attached(pending))

        if isinstance(result, CallError):
            if result.reply:
                refused = self._outgoing(pending.query, result.reply)
                result.reply = refused if isinstance(refused, bytes) else b""
            reply_error(pending.query, result, reply)
            return
        try:
            with pending.query as query:
                reply(query, result)
        except zenoh.ZError as err:
            _log.debug("%s: the client no longer waits for the reply: %s", self.name, err)

    def _abandoned(self, pending: PendingRequest) -> None:
        """Handle a request that its client has canceled, or whose client has left."""
        if self._remove(pending):
            pending.query.drop()  # type: ignore[no-untyped-call]
            self._abandon(pending)

    def _abandon(self, pending: PendingRequest) -> None:
        with self._lock:
            pending.left = True
            abandon = pending.abandon
        if abandon is not None:
            abandon()
