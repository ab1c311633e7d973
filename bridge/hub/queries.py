"""Calls as zenoh queries on one key, each ended once: by a reply, by an error, or because its server left."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from threading import Lock

import zenoh

from bridge.hub.call import Abandon, CallError, Done
from bridge.hub.errands import Errands
from bridge.hub.errors import zenoh_reason
from bridge.hub.receiving import keep_thread_state

_log = logging.getLogger(__name__)

LEFT = "the server of {name} left before it answered"
PRIORITY = zenoh.Priority.INTERACTIVE_LOW
"""Before topics, so that no call waits behind an image; the replies have their query's."""

MAX_ERROR = 4096
"""Bytes of an error's text."""

_CLOSED = "the call of {name} was ended: its client was closed"
_REFUSED = "; or a door between the machines refuses this call (hub.open.trusted)"
_AT_ONCE = 0.2
"""Seconds within which a query that no server took has ended; a longer one was with a server."""

_SETTLING = 1.0
"""Seconds from a server's coming in which zenoh's routers may not have the way to it yet, though they tell of it."""

_AGAIN = 0.02
_NO_SERVER = "no server of {name} is on {where}"
_FOR_EVER = 1e9
"""Seconds after which zenoh ends a query, ten by default: no call has a limit of ours."""


class _Asking:
    """One call that waits for its reply."""

    __slots__ = ("attached", "done", "number", "request", "sent", "token")

    def __init__(self, number: int, request: bytes, attached: bytes | None, done: Done) -> None:
        self.number = number
        self.request = request
        self.attached = attached
        self.done = done
        self.token = zenoh.CancellationToken()
        self.sent = 0.0


class Queries:
    """Calls the queryables of one key. Safe to use from any thread.

    Args:
        session: who asks.
        key: the key.
        name: the service's, for people.
        limit: bytes of a request or a reply at most.
        errands: where what may wait for zenoh is done.
        changed: called when the first server came, or the last one went.
        target: which of several queryables are asked.

    Attributes:
        name: the service's.
    """

    where = "the hub"
    encoding: zenoh.Encoding | None = None

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        name: str,
        limit: int,
        errands: Errands,
        changed: Callable[[], None] | None,
        target: zenoh.QueryTarget,
    ) -> None:
        self.name = name
        self._session, self._key, self._limit, self._errands = session, key, limit, errands
        self._changed = changed
        self._lock = Lock()
        self._number = 0
        self._waiting: dict[int, _Asking] = {}
        self._again: list[_Asking] = []
        self._since = time.monotonic()
        self._querier: zenoh.Querier | None = session.declare_querier(
            key,
            target=target,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_FOR_EVER,
            priority=PRIORITY,
            express=True,
            allowed_destination=zenoh.Locality.REMOTE,
        )
        self._listener = self._querier.declare_matching_listener(
            zenoh.handlers.Callback(self._match_changed, indirect=False)
        )

    def attached(self, number: int) -> bytes | None:  # noqa: ARG002
        """The attachment of a request."""
        return None

    def abandoned(self, attached: bytes | None) -> None:
        """Nobody waits any more for the reply to the request with this attachment."""

    def closing(self) -> None:
        """All calls were ended."""

    @property
    def ready(self) -> bool:
        """Whether there is a server to call."""
        querier = self._querier
        try:
            return querier is not None and _matching(querier.matching_status)
        except (zenoh.ZError, RuntimeError):  # it is being closed
            return False

    def call(self, request: bytes, done: Done) -> Abandon:
        """Begin a call with a request in the key's wire bytes; see `bridge.hub.call.Call`.

        A large request waits where the link to the server is congested.
        """
        if len(request) > self._limit:
            done(CallError(f"the request has {len(request)} bytes, limits.message allows {self._limit}"))
            return _nothing
        if not self.ready:
            done(CallError(_NO_SERVER.format(name=self.name, where=self.where)))
            return _nothing
        with self._lock:
            self._number += 1
            asking = _Asking(self._number, request, self.attached(self._number), done)
            self._waiting[self._number] = asking
        self._ask(asking)
        return partial(self._abandon, asking)

    def _ask(self, asking: _Asking) -> None:
        querier = self._querier
        if querier is None:
            self._end(asking.number, CallError(_CLOSED.format(name=self.name)))
            return
        over = partial(self._over, asking.number)
        handler = zenoh.handlers.Callback(partial(self._came, asking.number), over, indirect=False)
        asking.sent = time.monotonic()
        try:
            querier.get(
                handler,
                payload=asking.request,
                encoding=self.encoding,
                attachment=asking.attached,
                cancellation_token=asking.token,
            )
        except (zenoh.ZError, RuntimeError) as err:  # it is being closed
            self._end(asking.number, CallError(f"{self.name} cannot be called: {zenoh_reason(err)}"))
        if not self.ready:  # zenoh may never end a query that finds nobody
            over()

    def end(self) -> bool:
        """End every call that is under way with an error, and give the querier back; whether that was still to do."""
        with self._lock:
            querier, self._querier = self._querier, None
        if querier is None:
            return False
        self._end_all(CallError(_CLOSED.format(name=self.name)))
        self.closing()
        self._listener.undeclare()  # type: ignore[no-untyped-call]
        _undeclare(querier)
        return True

    def _match_changed(self, status: object) -> None:
        """The first server came, or the last one went; runs on a thread of zenoh."""
        keep_thread_state()
        self._since = time.monotonic()
        if not _matching(status):
            self._end_all(CallError(LEFT.format(name=self.name)))
        if self._changed is not None:
            self._changed()

    def _came(self, number: int, reply: zenoh.Reply) -> None:
        """A reply; runs on zenoh's receiving thread."""
        keep_thread_state()
        if reply.ok is None:
            error = b"" if reply.err is None else reply.err.payload.to_bytes()[:MAX_ERROR]
            text = error.decode(errors="replace") or "the server answered with an error"
            self._end(number, CallError(text))
        elif len(reply.ok.payload) > self._limit:
            size = len(reply.ok.payload)
            self._end(number, CallError(f"the reply has {size} bytes, limits.message allows {self._limit}"))
        else:
            self._end(number, reply.ok.payload.to_bytes())

    def _over(self, number: int) -> None:
        """No reply will come any more; runs on a thread of zenoh."""
        keep_thread_state()
        text, now = LEFT.format(name=self.name), time.monotonic()
        with self._lock:
            asking = self._waiting.get(number)
        if asking is None:
            return
        if self.ready and now - asking.sent < _AT_ONCE:
            if now - self._since < _SETTLING:
                self._later(asking)
                return
            text += _REFUSED
        self._end(number, CallError(text))

    def _later(self, asking: _Asking) -> None:
        """Ask again soon: nobody was asked, as there was no way to the server yet."""
        with self._lock:
            self._again.append(asking)
            first = len(self._again) == 1
        if first:
            self._errands.send(self._ask_again)

    def _ask_again(self) -> None:
        time.sleep(_AGAIN)
        with self._lock:
            again, self._again = self._again, []
            again = [asking for asking in again if asking.number in self._waiting]
        for asking in again:
            self._ask(asking)

    def _end(self, number: int, result: bytes | CallError) -> None:
        with self._lock:
            asking = self._waiting.pop(number, None)
        if asking is not None:
            asking.done(result)

    def _end_all(self, error: CallError) -> None:
        with self._lock:
            waiting, self._waiting = self._waiting, {}
        for asking in waiting.values():
            asking.done(error)

    def _abandon(self, asking: _Asking) -> None:
        with self._lock:
            waited = self._waiting.pop(asking.number, None) is not None
        if waited:
            # both may wait: the one for a callback that runs, the other for a congested link
            self._errands.send(asking.token.cancel)
            self.abandoned(asking.attached)


def reply_error(query: zenoh.Query, error: CallError) -> None:
    """Answer a query with zenoh's error reply, and end it."""
    try:
        with query:
            query.reply_err(str(error)[:MAX_ERROR].encode())
    except zenoh.ZError as err:
        _log.debug("nobody waits for the reply any more: %s", err)


def _undeclare(querier: zenoh.Querier) -> None:
    """Undeclare what another thread may be using in this moment, for which the wheel raises `RuntimeError`.

    Leaving it to the last reference would hold Python's lock, which a thread of zenoh may wait for.
    """
    for _ in range(1000):
        try:
            querier.undeclare()  # type: ignore[no-untyped-call]
        except RuntimeError:
            time.sleep(0.002)
        else:
            return


def _matching(status: object) -> bool:
    # the wheel returns a MatchingStatus (always true) where its stubs say bool
    return bool(getattr(status, "matching", status))


def _nothing() -> None:
    """The call is over."""
