"""Servers and clients of services on the hub, in rmw_zenoh's form; the three services of an action are such too.

A server is a queryable, a call is a query on the same key (`bridge.hub.wire.keys.topic_key` with the service's type and
hash): CDR request with an attachment whose number and GID the reply carries again (rmw_zenoh_cpp, rmw_service_data.cpp
and rmw_client_data.cpp). Two things are Midspan's own, and rmw_zenoh's programs pass over them:

- A call that fails is answered with zenoh's error reply, whose text says why. An rmw_zenoh client writes that to its
  log and goes on waiting, as it cannot report it to its program.
- zenoh notifies no server that its caller is gone. A caller of Midspan's does so on ``<key>/@abandon``, with the call's
  attachment; any other has gone when its liveliness token has.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import zenoh

from bridge.hub.endpoints.calls import PRIORITY, Call, CallClient, CallError, CallServer, PendingRequest
from bridge.hub.endpoints.publisher import EndpointContext
from bridge.hub.errors import HubWireError
from bridge.hub.graph.tokens import gid_of
from bridge.hub.wire.keys import GID_SIZE, pack_attachment, unpack_attachment
from bridge.hub.zenoh_compat import keep_thread_state, subscribe

_log = logging.getLogger(__name__)

_MAX_CALLERS = 10_000


class _HubRequest(PendingRequest):
    """One request, and who waits for its reply."""

    number: int | None = None
    seen = False


class HubServer(CallServer):
    """Serves one service on the hub; made by `bridge.hub.session.Hub.server`.

    Attributes:
        gid: the 16 bytes that name the server.
    """

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        name: str,
        call: Call,
    ) -> None:
        self.gid = gid_of(token)
        self._graph, self._own = context.graph, context.own
        self._callers: dict[tuple[bytes, int | None], _HubRequest] = {}
        self._unwatch: Callable[[], None] | None = None
        super().__init__(
            context.session, key, name, context.limit, call, context.closed, complete=True, reach=context.reach
        )
        self._withdraw = context.graph.announce(token)

    def _heard_beside(self, session: zenoh.Session, reach: zenoh.Locality) -> list[Any]:
        return [subscribe(session, abandon_key(self._key), self._heard_leaving, reach)]

    def _takes(self, query: zenoh.Query) -> bool:
        """Calls of the node itself are no calls."""
        attached = query.attachment
        return attached is None or attached.to_bytes()[-GID_SIZE:] not in self._own

    def _pending(self, query: zenoh.Query) -> _HubRequest:
        asked, attached = _HubRequest(query, self._answer), query.attachment
        if attached is not None:  # a plain zenoh program needs none
            try:
                asked.number, _time, asked.caller = unpack_attachment(attached.to_bytes())
            except HubWireError as err:
                raise CallError(str(err)) from None
            asked.seen = bool(self._graph.zid_of(asked.caller))
        return asked

    def _attached(self, asked: PendingRequest) -> bytes | None:
        """The request's number and GID again."""
        assert isinstance(asked, _HubRequest)
        return None if asked.number is None else pack_attachment(asked.number, time.time_ns(), asked.caller)

    # -- callers that leave --------------------------------------------------------------------------------------------

    def _remembered(self, asked: PendingRequest) -> None:
        assert isinstance(asked, _HubRequest)
        if asked.number is not None and len(self._callers) < _MAX_CALLERS:
            self._callers[asked.caller, asked.number] = asked
        if self._unwatch is None:
            self._unwatch = self._graph.watch(self._look_for_callers)

    def _forgotten(self, asked: PendingRequest) -> None:
        assert isinstance(asked, _HubRequest)
        with self._lock:
            if self._callers.get((asked.caller, asked.number)) is asked:
                del self._callers[asked.caller, asked.number]
            unwatch = None
            if not self._waiting:
                unwatch, self._unwatch = self._unwatch, None
        if unwatch is not None:
            unwatch()

    def _heard_leaving(self, sample: zenoh.Sample) -> None:
        keep_thread_state()
        try:
            number, _time, gid = unpack_attachment(sample.payload.to_bytes())
        except HubWireError:
            return
        with self._lock:
            asked = self._callers.get((gid, number))
        if asked is not None:
            self._abandoned(asked)

    def _look_for_callers(self) -> None:
        """The graph changed: callers whose token has gone have left."""
        with self._lock:
            waiting = [asked for asked in self._waiting if isinstance(asked, _HubRequest) and asked.number is not None]
        for asked in waiting:
            here = bool(self._graph.zid_of(asked.caller))
            if asked.seen and not here:
                self._abandoned(asked)
            asked.seen = here


class HubClient(CallClient):
    """Calls one service on the hub; made by `bridge.hub.session.Hub.client`. Safe to use from any thread.

    Of several servers' replies the first counts.

    Attributes:
        gid: the 16 bytes that name the client in its requests.
    """

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        name: str,
        changed: Callable[[], None] | None,
    ) -> None:
        self.gid = gid_of(token)
        self._graph, self._own, self._reach = context.graph, context.own, context.reach
        super().__init__(
            context.session,
            key,
            name,
            context.limit,
            context.executor,
            zenoh.QueryTarget.ALL_COMPLETE,
            context.closed,
            changed,
            context.reach,
        )
        self._withdraw = context.graph.announce(token)

    @property
    def ready(self) -> bool:
        """Whether there is a server to call; one of the node itself is none."""
        if not super().ready:
            return False
        servers = [server.gid in self._own for server in self._graph.servers(self.name)]
        return not servers or not all(servers)

    def _attached(self, number: int) -> bytes:
        """Number, time and GID, as rmw_zenoh's."""
        return pack_attachment(number, time.time_ns(), self.gid)

    def _abandoned(self, attached: bytes | None) -> None:
        """Tell the server."""
        assert attached is not None
        self._executor.submit(partial(self._tell_leaving, attached))

    def _tell_leaving(self, attached: bytes) -> None:
        self._session.put(
            abandon_key(self._key),
            attached,
            priority=PRIORITY,
            congestion_control=zenoh.CongestionControl.BLOCK,
            allowed_destination=self._reach,
        )


def abandon_key(key: str) -> str:
    """Where callers of a service announce that they wait no more; ``**`` does not match it."""
    return f"{key}/@abandon"
