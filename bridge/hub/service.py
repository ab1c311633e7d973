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

import zenoh

from bridge.hub import attachment
from bridge.hub.answers import Answers, Asked
from bridge.hub.call import Call, CallError, Done
from bridge.hub.errands import Errands
from bridge.hub.errors import WireError
from bridge.hub.graph import HubGraph
from bridge.hub.liveliness import gid_of
from bridge.hub.queries import PRIORITY, Queries
from bridge.hub.receiving import keep_thread_state

_log = logging.getLogger(__name__)

_MAX_CALLERS = 10_000


class Replying:
    """Takes the reply to one request.

    Attributes:
        caller: GID of who asks; empty where it does not say.
    """

    def __init__(self, done: Done, caller: bytes) -> None:
        self._done, self.caller = done, caller

    def __call__(self, result: bytes | CallError) -> None:
        """End the call."""
        self._done(result)


class _Asked(Asked):
    """One request, and who waits for its reply."""

    def __init__(self, query: zenoh.Query, caller: tuple[bytes, int] | None, *, seen: bool) -> None:
        super().__init__(query)
        self.caller = caller
        self.seen = seen


class HubServer(Answers):
    """Serves one service on the hub; made by `bridge.hub.session.Hub.server`.

    Attributes:
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
        self.gid = gid_of(token)
        self._graph, self._on_close = graph, on_close
        self._callers: dict[tuple[bytes, int], _Asked] = {}
        self._unwatch: Callable[[], None] | None = None
        super().__init__(session, key, name, limit, call, complete=True)
        self._leaving = session.declare_subscriber(
            abandon_key(key),
            zenoh.handlers.Callback(self._heard_leaving, indirect=False),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        self._withdraw = graph.announce(token)

    def close(self) -> None:
        """Tell all who wait that the server left, and leave the graph. Safe to call twice."""
        if self.end():
            self._leaving.undeclare()  # type: ignore[no-untyped-call]
            self._on_close(self)

    def closing(self) -> None:
        """Leave the graph."""
        self._withdraw()

    def asked(self, query: zenoh.Query) -> _Asked:
        """See `Answers.asked`; a plain zenoh program needs no attachment."""
        attached = query.attachment
        if attached is None:
            return _Asked(query, None, seen=False)
        try:
            number, _time, gid = attachment.unpack(attached.to_bytes())
        except WireError as err:
            raise CallError(str(err)) from None
        return _Asked(query, (gid, number), seen=bool(self._graph.zid_of(gid)))

    def attached(self, asked: Asked) -> bytes | None:
        """The request's number and GID again."""
        assert isinstance(asked, _Asked)
        if asked.caller is None:
            return None
        gid, number = asked.caller
        return attachment.pack(number, time.time_ns(), gid)

    def done(self, asked: Asked) -> Replying:
        """See `Answers.done`; it knows who asks."""
        assert isinstance(asked, _Asked)
        return Replying(super().done(asked), asked.caller[0] if asked.caller else b"")

    # -- callers that leave --------------------------------------------------------------------------------------------

    def remembered(self, asked: Asked) -> None:
        """See `Answers.remembered`."""
        assert isinstance(asked, _Asked)
        if asked.caller is not None and len(self._callers) < _MAX_CALLERS:
            self._callers[asked.caller] = asked
        if self._unwatch is None:
            self._unwatch = self._graph.watch(self._look_for_callers)

    def forgotten(self, asked: Asked) -> None:
        """See `Answers.forgotten`."""
        assert isinstance(asked, _Asked)
        with self._lock:
            if asked.caller is not None and self._callers.get(asked.caller) is asked:
                del self._callers[asked.caller]
            unwatch = None
            if not self._waiting:
                unwatch, self._unwatch = self._unwatch, None
        if unwatch is not None:
            unwatch()

    def _heard_leaving(self, sample: zenoh.Sample) -> None:
        keep_thread_state()
        try:
            number, _time, gid = attachment.unpack(sample.payload.to_bytes())
        except WireError:
            return
        with self._lock:
            asked = self._callers.get((gid, number))
        if asked is not None:
            self.abandoned(asked)

    def _look_for_callers(self) -> None:
        """The graph changed: those whose token was there, and is no more, have gone."""
        with self._lock:
            waiting = [asked for asked in self._waiting if isinstance(asked, _Asked)]
        for asked in waiting:
            if asked.caller is None:
                continue
            here = bool(self._graph.zid_of(asked.caller[0]))
            if asked.seen and not here:
                self.abandoned(asked)
            asked.seen = here


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
