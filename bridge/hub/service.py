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
from bridge.hub.call import Abandon, Call, CallError
from bridge.hub.errands import Errands
from bridge.hub.errors import WireError
from bridge.hub.graph import HubGraph
from bridge.hub.liveliness import gid_of
from bridge.hub.queries import LEFT, PRIORITY, Queries, reply_error
from bridge.hub.receiving import keep_thread_state

_log = logging.getLogger(__name__)

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
            reply_error(query, err)
            return
        with self._lock:
            closed = self._closed
            if not closed:
                self._remember(asked)
        if closed:
            reply_error(query, CallError(LEFT.format(name=self.name)))
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
            reply_error(asked.query, result)
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


class HubClient(Queries):
    """Calls one service on the hub; made by `bridge.hub.session.Hub.client`. Safe to use from any thread.

    Of several servers' replies the first counts.

    Attributes:
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
        self.gid = gid_of(token)
        self._on_close = on_close
        super().__init__(session, key, name, limit, errands, changed, zenoh.QueryTarget.ALL_COMPLETE)
        self._withdraw = graph.announce(token)

    def attached(self, number: int) -> bytes:
        """Number, time and GID, as rmw_zenoh's."""
        return attachment.pack(number, time.time_ns(), self.gid)

    def closing(self) -> None:
        """Leave the graph."""
        self._withdraw()

    def close(self) -> None:
        """End every call that is under way with an error, and leave the graph. Safe to call twice."""
        if self.end():
            self._on_close(self)

    def abandoned(self, attached: bytes | None) -> None:
        """Tell the server."""
        assert attached is not None
        self._errands.send(partial(self._tell_leaving, attached))

    def _tell_leaving(self, attached: bytes) -> None:
        self._session.put(
            abandon_key(self._key),
            attached,
            priority=PRIORITY,
            congestion_control=zenoh.CongestionControl.BLOCK,
            allowed_destination=zenoh.Locality.REMOTE,
        )


def abandon_key(key: str) -> str:
    """Where callers of a service tell that they wait no more; ``**`` does not match it."""
    return f"{key}/@abandon"
