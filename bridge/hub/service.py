"""Servers and clients of services on the hub, in rmw_zenoh's form; the three services of an action are such too.

A server is a queryable, a call is a query on the same key (`bridge.hub.keyexpr.topic_key` with the service's type and
hash): CDR request with an attachment whose number and GID the reply carries again (rmw_zenoh_cpp, rmw_service_data.cpp
and rmw_client_data.cpp). Two things are Midspan's own, and rmw_zenoh's programs pass over them:

- A call that fails is answered with zenoh's error reply, whose text says why. An rmw_zenoh client writes that to its
  log and goes on waiting, as it has no other way to tell its program.
- zenoh tells no server that its caller is gone. A caller of Midspan's says so on ``<key>/@abandon``, with the call's
  attachment; any other has gone when its liveliness token has.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from threading import Lock

import zenoh

from bridge.hub import attachment
from bridge.hub.call import Abandon, Call, CallError, Done
from bridge.hub.errands import Errands
from bridge.hub.errors import WireError, zenoh_reason
from bridge.hub.graph import HubGraph
from bridge.hub.liveliness import gid_of
from bridge.hub.receiving import keep_thread_state

_log = logging.getLogger(__name__)

LEFT = "the server of {name} left before it answered"
_CLOSED = "the call of {name} was ended: its client was closed"
_REFUSED = "; or a door between the machines refuses this call, see 'midspan explain {name}'"
_AT_ONCE = 0.2
"""Seconds within which a query that no server took has ended; a longer one was with a server."""

_SETTLING = 1.0
"""Seconds from a server's coming in which zenoh's routers may not have the way to it yet, though they tell of it."""

_AGAIN = 0.02
_NO_SERVER = "no server of {name} is on the hub"
_FOR_EVER = 1e9
"""Seconds after which zenoh ends a query, ten by default: no call has a limit of ours."""

_PRIORITY = zenoh.Priority.INTERACTIVE_LOW
"""Before topics, so that no call waits behind an image; the replies have their query's."""

_MAX_ERROR = 4096
_MAX_CALLERS = 10_000


class _Asked:
    """One request that waits for its reply."""

    def __init__(self, query: zenoh.Query, caller: tuple[bytes, int] | None, *, seen: bool) -> None:
        self.query = query
        self.caller = caller
        self.seen = seen
        self.abandon: Abandon | None = None
        self.left = False


class HubServer:
    """Serves one service on the hub; made by `bridge.hub.session.Hub.server`.

    Attributes:
        name: the service's.
        gid: the 16 bytes that name the server.
    """

    def __init__(
        self,
        session: zenoh.Session,
        graph: HubGraph,
        token: str,
        key: str,
        name: str,
        limit: int,
        call: Call,
        on_close: Callable[[HubServer], None],
    ) -> None:
        self.name = name
        self.gid = gid_of(token)
        self._key, self._limit, self._call, self._graph, self._on_close = key, limit, call, graph, on_close
        self._lock = Lock()
        self._waiting: dict[_Asked, None] = {}
        self._callers: dict[tuple[bytes, int], _Asked] = {}
        self._unwatch: Callable[[], None] | None = None
        self._closed = False
        remote = zenoh.Locality.REMOTE
        self._leaving = session.declare_subscriber(
            abandon_key(key), zenoh.handlers.Callback(self._heard_leaving, indirect=False), allowed_origin=remote
        )
        self._queryable = session.declare_queryable(
            key, zenoh.handlers.Callback(self._asked, indirect=False), complete=True, allowed_origin=remote
        )
        self._withdraw = graph.announce(token)

    def close(self) -> None:
        """Tell all who wait that the server left, and leave the graph. Safe to call twice."""
        with self._lock:
            closed, self._closed = self._closed, True
            waiting = list(self._waiting)
        if closed:
            return
        self._withdraw()
        for asked in waiting:
            self._leave(asked)
            self._answer(asked, CallError(LEFT.format(name=self.name)))
        self._queryable.undeclare()  # type: ignore[no-untyped-call]
        self._leaving.undeclare()  # type: ignore[no-untyped-call]
        self._on_close(self)

    def _asked(self, query: zenoh.Query) -> None:
        """Begin a call; runs on zenoh's receiving thread."""
        keep_thread_state()
        asked = _Asked(query, None, seen=False)
        try:
            request = self._read(asked)
        except CallError as err:
            _reply_error(query, err)
            return
        with self._lock:
            closed = self._closed
            if not closed:
                self._remember(asked)
        if closed:
            _reply_error(query, CallError(LEFT.format(name=self.name)))
            return
        abandon = self._call(request, partial(self._answer, asked))
        with self._lock:
            asked.abandon = abandon
            left = asked.left
        if left:
            abandon()

    def _read(self, asked: _Asked) -> bytes:
        """The request's bytes; raises `CallError` where it cannot be taken."""
        payload, attached = asked.query.payload, asked.query.attachment
        if payload is not None and len(payload) > self._limit:
            msg = f"the request has {len(payload)} bytes, limits.message allows {self._limit}"
            raise CallError(msg)
        if attached is not None:  # a plain zenoh program needs none
            try:
                number, _time, gid = attachment.unpack(attached.to_bytes())
            except WireError as err:
                raise CallError(str(err)) from None
            asked.caller = (gid, number)
            asked.seen = bool(self._graph.zid_of(gid))
        return b"" if payload is None else payload.to_bytes()

    def _remember(self, asked: _Asked) -> None:
        self._waiting[asked] = None
        if asked.caller is not None and len(self._callers) < _MAX_CALLERS:
            self._callers[asked.caller] = asked
        if self._unwatch is None:
            self._unwatch = self._graph.watch(self._look_for_callers)

    def _forget(self, asked: _Asked) -> bool:
        """Whether the request was still waiting."""
        with self._lock:
            waited = asked in self._waiting
            self._waiting.pop(asked, None)
            if asked.caller is not None and self._callers.get(asked.caller) is asked:
                del self._callers[asked.caller]
            unwatch = None
            if not self._waiting:
                unwatch, self._unwatch = self._unwatch, None
        if unwatch is not None:
            unwatch()
        return waited

    def _answer(self, asked: _Asked, result: bytes | CallError) -> None:
        if not self._forget(asked):
            return
        if isinstance(result, bytes) and len(result) > self._limit:
            result = CallError(f"the reply has {len(result)} bytes, limits.message allows {self._limit}")
        if isinstance(result, CallError):
            _reply_error(asked.query, result)
            return
        attached = None
        if asked.caller is not None:
            gid, number = asked.caller
            attached = attachment.pack(number, time.time_ns(), gid)
        try:
            with asked.query as query:
                query.reply(self._key, result, attachment=attached)
        except zenoh.ZError as err:
            _log.debug("%s: nobody waits for the reply any more: %s", self.name, err)

    # -- callers that leave --------------------------------------------------------------------------------------------

    def _heard_leaving(self, sample: zenoh.Sample) -> None:
        keep_thread_state()
        try:
            number, _time, gid = attachment.unpack(sample.payload.to_bytes())
        except WireError:
            return
        with self._lock:
            asked = self._callers.get((gid, number))
        if asked is not None:
            self._abandon(asked)

    def _look_for_callers(self) -> None:
        """The graph changed: those whose token was there, and is no more, have gone."""
        with self._lock:
            waiting = [asked for asked in self._waiting if asked.caller is not None]
        for asked in waiting:
            assert asked.caller is not None
            here = bool(self._graph.zid_of(asked.caller[0]))
            if asked.seen and not here:
                self._abandon(asked)
            asked.seen = here

    def _abandon(self, asked: _Asked) -> None:
        if self._forget(asked):
            asked.query.drop()  # type: ignore[no-untyped-call]
            self._leave(asked)

    def _leave(self, asked: _Asked) -> None:
        with self._lock:
            asked.left = True
            abandon = asked.abandon
        if abandon is not None:
            abandon()


class _Asking:
    """One call that waits for its reply."""

    __slots__ = ("attached", "done", "number", "request", "sent", "token")

    def __init__(self, number: int, request: bytes, attached: bytes, done: Done) -> None:
        self.number = number
        self.request = request
        self.attached = attached
        self.done = done
        self.token = zenoh.CancellationToken()
        self.sent = 0.0


class HubClient:
    """Calls one service on the hub; made by `bridge.hub.session.Hub.client`. Safe to use from any thread.

    Attributes:
        name: the service's.
        gid: the 16 bytes that name the client in its requests.
    """

    def __init__(
        self,
        session: zenoh.Session,
        graph: HubGraph,
        token: str,
        key: str,
        name: str,
        limit: int,
        errands: Errands,
        changed: Callable[[], None] | None,
        on_close: Callable[[HubClient], None],
    ) -> None:
        self.name = name
        self.gid = gid_of(token)
        self._session, self._key, self._limit, self._errands = session, key, limit, errands
        self._changed, self._on_close = changed, on_close
        self._lock = Lock()
        self._number = 0
        self._waiting: dict[int, _Asking] = {}
        self._again: list[_Asking] = []
        self._since = time.monotonic()
        self._querier: zenoh.Querier | None = session.declare_querier(
            key,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_FOR_EVER,
            priority=_PRIORITY,
            express=True,
            allowed_destination=zenoh.Locality.REMOTE,
        )
        self._listener = self._querier.declare_matching_listener(
            zenoh.handlers.Callback(self._match_changed, indirect=False)
        )
        self._withdraw = graph.announce(token)

    @property
    def ready(self) -> bool:
        """Whether there is a server to call."""
        querier = self._querier
        try:
            return querier is not None and _matching(querier.matching_status)
        except (zenoh.ZError, RuntimeError):  # it is being closed
            return False

    def call(self, request: bytes, done: Done) -> Abandon:
        """Begin a call with a CDR request; see `bridge.hub.call.Call`. Of several servers' replies the first counts.

        A large request waits where the link to the server is congested.
        """
        if len(request) > self._limit:
            done(CallError(f"the request has {len(request)} bytes, limits.message allows {self._limit}"))
            return _nothing
        if not self.ready:
            done(CallError(_NO_SERVER.format(name=self.name)))
            return _nothing
        with self._lock:
            self._number += 1
            attached = attachment.pack(self._number, time.time_ns(), self.gid)
            asking = self._waiting[self._number] = _Asking(self._number, request, attached, done)
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
            querier.get(handler, payload=asking.request, attachment=asking.attached, cancellation_token=asking.token)
        except (zenoh.ZError, RuntimeError) as err:  # it is being closed
            self._end(asking.number, CallError(f"{self.name} cannot be called: {zenoh_reason(err)}"))
        if not self.ready:  # zenoh may never end a query that finds nobody
            over()

    def close(self) -> None:
        """End every call that is under way with an error, and leave the graph. Safe to call twice."""
        with self._lock:
            querier, self._querier = self._querier, None
        if querier is None:
            return
        self._end_all(CallError(_CLOSED.format(name=self.name)))
        self._withdraw()
        self._listener.undeclare()  # type: ignore[no-untyped-call]
        _undeclare(querier)
        self._on_close(self)

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
            error = b"" if reply.err is None else reply.err.payload.to_bytes()[:_MAX_ERROR]
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
            text += _REFUSED.format(name=self.name)
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
            self._errands.send(partial(self._tell_leaving, asking.attached))

    def _tell_leaving(self, attached: bytes) -> None:
        self._session.put(
            abandon_key(self._key),
            attached,
            priority=_PRIORITY,
            congestion_control=zenoh.CongestionControl.BLOCK,
            allowed_destination=zenoh.Locality.REMOTE,
        )


def abandon_key(key: str) -> str:
    """Where callers of a service tell that they wait no more; ``**`` does not match it."""
    return f"{key}/@abandon"


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


def _reply_error(query: zenoh.Query, error: CallError) -> None:
    try:
        with query:
            query.reply_err(str(error)[:_MAX_ERROR].encode())
    except zenoh.ZError as err:
        _log.debug("nobody waits for the reply any more: %s", err)


def _nothing() -> None:
    """The call is over."""
