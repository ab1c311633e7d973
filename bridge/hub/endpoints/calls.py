"""Service calls as zenoh queries on one key: the client, and what it shares with the server.

Each call that is not abandoned ends exactly once: with a reply or with a `CallError`, such as a server's error reply or
the loss of the last server.
"""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Callable
from functools import partial
from threading import Lock
from typing import Any

import zenoh

from bridge.concurrency import DelayedCalls, SerialExecutor
from bridge.hub.errors import zenoh_reason
from bridge.hub.opening import prepare_to_send
from bridge.hub.zenoh_compat import keep_thread_state, undeclare


class CallError(Exception):
    """A call failed; the text is the reason that the client receives.

    ``reply`` is a reply of the service's type that means the failure, for clients of rmw_zenoh, which cannot report
    errors; b"" if it has none.
    """

    reply = b""


class UnsentCallError(CallError):
    """A call was refused before any server received it."""


class ClosedCallError(CallError):
    """The client of a call was closed before the reply."""


Done = Callable[[bytes | CallError], None]
"""Receives the result of a call, once and on any thread; it may only append and wake, or send."""

Abandon = Callable[[], None]
"""Cancels a call whose client has left. Safe to call twice, and after the call has ended."""

Call = Callable[[bytes, Done], Abandon]
"""``call(request, done)``: starts a call and returns at once; there is no timeout."""


def nothing() -> None:
    """Do nothing: the `Abandon` of a call that has ended or never started."""


_log = logging.getLogger(__name__)

LEFT = "the server of {name} left before it answered"
PRIORITY = zenoh.Priority.INTERACTIVE_LOW
"""The priority of calls: higher than that of topics, so that calls do not wait for images. Replies inherit it."""

MAX_ERROR = 4096
"""Maximum size of an error text, in bytes."""

_CLOSED = "the call of {name} was ended: its client was closed"
_REFUSED = "; or an external listener between the machines refuses this call (hub.open.trusted)"
_AT_ONCE = 0.2
"""Seconds within which zenoh ends a query that no server received, so that a query that lasts longer reached a server.

A query that ends within this time may have reached a server too, if the server then crashed or dropped the query. So
no call is repeated.
"""

_LEAVING = 1.0
"""Seconds within which a crashed server's queryable disappears; if the queryable remains, the server did not crash."""

_NO_SERVER = "no server of {name} is on {where}"
REFUSED_ENCODING = zenoh.Encoding("text/plain;refused")
"""Encoding of the text of an `UnsentCallError`."""

_FOR_EVER = 1e9
"""Timeout of zenoh queries in seconds, because calls have no timeout; zenoh's default is ten seconds."""


class _PendingCall:
    """A call that waits for its reply."""

    __slots__ = ("attachment", "done", "number", "request", "sent", "token")

    def __init__(self, number: int, request: bytes, attachment: bytes | None, done: Done) -> None:
        self.number = number
        self.request = request
        self.attachment = attachment
        self.done = done
        self.token = zenoh.CancellationToken()
        self.sent = 0.0


class CallClient:
    """A client of the queryables on one key. Safe to use from any thread.

    Args:
        limit: maximum size of a request or reply, in bytes.
        executor: runs operations that may block in zenoh.
        ends: handles the ends of queries; see `bridge.hub.zenoh_compat`.
        delays: makes delayed calls.
        target: which of several queryables receive the query.
        closed: called once with the client when it has closed.
        changed: called when the first server appears or the last one leaves.
        reach: which sessions' queryables receive the query, by default those of other sessions.
    """

    where = "the hub"
    first_server = 0.0
    """Seconds after its creation for which a client's calls wait for the first server."""
    encoding: zenoh.Encoding | None = None
    _withdraw: Callable[[], None]

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        name: str,
        limit: int,
        executor: SerialExecutor,
        ends: SerialExecutor,
        delays: DelayedCalls,
        target: zenoh.QueryTarget,
        closed: Callable[[Any], None],
        changed: Callable[[], None] | None = None,
        reach: zenoh.Locality = zenoh.Locality.REMOTE,
    ) -> None:
        self.name = name
        self._session, self._key, self._limit, self._executor = session, key, limit, executor
        self._ends, self._delays, self._on_close, self._changed = ends, delays, closed, changed
        self._lock = Lock()
        self._numbers = itertools.count(1)
        self._waiting: dict[int, _PendingCall] = {}
        self._early: list[_PendingCall] = []  # calls that wait for the first server
        self._early_until = time.monotonic() + self.first_server
        self._querier: zenoh.Querier | None = session.declare_querier(
            key,
            target=target,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_FOR_EVER,
            priority=PRIORITY,
            express=True,
            allowed_destination=reach,
        )
        self._listener = self._querier.declare_matching_listener(
            zenoh.handlers.Callback(self._on_match_changed, indirect=False)
        )

    def _attached(self, number: int) -> bytes | None:  # noqa: ARG002
        return None

    def _abandoned(self, attachment: bytes | None) -> None:
        """Handle the cancellation of the call whose request has this attachment."""

    @property
    def ready(self) -> bool:
        """Whether there is a server to call."""
        return self._reachable

    @property
    def _reachable(self) -> bool:
        """Whether there is a server on the key."""
        querier = self._querier
        try:
            return querier is not None and _matching(querier.matching_status)
        except (zenoh.ZError, RuntimeError):  # the client is being closed
            return False

    def call(self, request: bytes, done: Done) -> Abandon:
        """Start a call with a serialized request; see `bridge.hub.endpoints.calls.Call`.

        A large request blocks while the link to the server is congested.
        """
        if len(request) > self._limit:
            done(CallError(f"the request has {len(request)} bytes, limits.message allows {self._limit}"))
            return nothing
        reachable, left = self._reachable, self._early_until - time.monotonic()
        if not reachable and (left <= 0.0 or self._querier is None):
            done(CallError(_NO_SERVER.format(name=self.name, where=self.where)))
            return nothing
        with self._lock:
            number = next(self._numbers)
            pending = _PendingCall(number, request, self._attached(number), done)
            self._waiting[number] = pending
            if not reachable:
                self._early.append(pending)
        if reachable:
            self._ask(pending)
        else:
            self._delays.after(left, self._end_early, once=True)
            self._begin_early()  # a server may have come meanwhile
        return partial(self._abandon, pending)

    def _begin_early(self) -> None:
        """Begin the calls that wait for the first server, if there is one; on another thread, because it may block."""
        if not self._reachable:
            return
        with self._lock:
            early, self._early = self._early, []
            begun = [pending for pending in early if pending.number in self._waiting]
        for pending in begun:
            self._executor.submit(partial(self._ask, pending))

    def _end_early(self) -> None:
        """End the calls that wait for the first server."""
        with self._lock:
            early, self._early = self._early, []
        for pending in early:
            self._end(pending.number, CallError(_NO_SERVER.format(name=self.name, where=self.where)))

    def _ask(self, pending: _PendingCall) -> None:
        querier = self._querier
        if querier is None:
            self._end(pending.number, ClosedCallError(_CLOSED.format(name=self.name)))
            return
        number = pending.number
        replied, over = partial(self._on_reply, number), partial(self._on_over, number)
        handler = zenoh.handlers.Callback(replied, over, indirect=False)
        pending.sent = time.monotonic()
        prepare_to_send(len(pending.request))
        try:
            querier.get(
                handler,
                payload=pending.request,
                encoding=self.encoding,
                attachment=pending.attachment,
                cancellation_token=pending.token,
            )
        except (zenoh.ZError, RuntimeError) as err:  # the client is being closed
            self._end(pending.number, CallError(f"{self.name} cannot be called: {zenoh_reason(err)}"))
        if not self._reachable:  # zenoh may never end a query that has no server
            self._over(number, time.monotonic())

    def close(self) -> None:
        """End every pending call with an error, and undeclare the client. Safe to call twice."""
        with self._lock:
            querier, self._querier = self._querier, None
        if querier is not None:
            self._end_all(ClosedCallError(_CLOSED.format(name=self.name)))
            self._withdraw()
            undeclare(self._listener)
            _undeclare_querier(querier)
            self._on_close(self)

    def _on_match_changed(self, status: object) -> None:
        """Handle the first server or the loss of the last server; runs on a zenoh thread."""
        keep_thread_state()
        self._early_until = 0.0
        if not _matching(status):
            self._end_all(CallError(LEFT.format(name=self.name)))
        elif self._early:
            self._ends.submit(self._begin_early)
        if self._changed is not None:
            self._changed()

    def _on_reply(self, number: int, reply: zenoh.Reply) -> None:
        """Handle a reply; runs on zenoh's receiving thread."""
        keep_thread_state()
        if reply.ok is None:
            error = b"" if reply.err is None else reply.err.payload.to_bytes()[:MAX_ERROR]
            text = error.decode(errors="replace") or "the server answered with an error"
            refused = reply.err is not None and reply.err.encoding == REFUSED_ENCODING
            self._end(number, (UnsentCallError if refused else CallError)(text))
        elif len(reply.ok.payload) > self._limit:
            size = len(reply.ok.payload)
            self._end(number, CallError(f"the reply has {size} bytes, limits.message allows {self._limit}"))
        else:
            self._end(number, reply.ok.payload.to_bytes())

    def _on_over(self, number: int) -> None:
        """Handle the end of a query; runs on a zenoh thread, which must not use zenoh."""
        keep_thread_state()
        if number in self._waiting:
            self._ends.submit(partial(self._over, number, time.monotonic()))

    def _over(self, number: int, now: float) -> None:
        """Handle a query that ended at the time ``now`` (monotonic seconds); do nothing if it had a reply."""
        with self._lock:
            pending = self._waiting.get(number)
        if pending is None:
            return
        if self._reachable and now - pending.sent < _AT_ONCE:
            self._delays.after(_LEAVING, partial(self._fail, number))
        else:
            self._fail(number)

    def _fail(self, number: int) -> None:
        """End a call that got no reply; if its server is still present, an external listener may be the reason."""
        text = LEFT.format(name=self.name)
        self._end(number, CallError(text + _REFUSED if self._reachable else text))

    def _end(self, number: int, result: bytes | CallError) -> None:
        with self._lock:
            pending = self._waiting.pop(number, None)
        if pending is not None:
            pending.done(result)

    def _end_all(self, error: CallError) -> None:
        with self._lock:
            waiting, self._waiting = self._waiting, {}
        for pending in waiting.values():
            pending.done(error)

    def _abandon(self, pending: _PendingCall) -> None:
        with self._lock:
            waited = self._waiting.pop(pending.number, None) is not None
        if waited:
            # both may block: the former on a running callback, the latter on a congested link
            self._executor.submit(pending.token.cancel)
            self._abandoned(pending.attachment)


def _undeclare_querier(querier: zenoh.Querier) -> None:
    """Undeclare a querier; zenoh-python raises `RuntimeError` while another thread is using it."""
    # dropping the last reference instead would hold the GIL, for which a zenoh thread may be waiting
    for _ in range(1000):
        try:
            querier.undeclare()  # type: ignore[no-untyped-call]
        except RuntimeError:
            time.sleep(0.002)
        else:
            return


def _matching(status: object) -> bool:
    # zenoh-python returns a MatchingStatus (always truthy) although its stubs declare bool
    return bool(getattr(status, "matching", status))
