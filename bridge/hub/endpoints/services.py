"""Servers and clients of services on the hub, in rmw_zenoh's format, including the three services of an action.

A server is a queryable, and a call is a query on the same key (`bridge.hub.wire.keys.topic_key` with the service's type
and hash), with a CDR request and an attachment whose number and GID the reply repeats (rmw_zenoh_cpp,
rmw_service_data.cpp and rmw_client_data.cpp). Midspan adds two extensions, which rmw_zenoh's programs ignore:

- A failed call gets a zenoh error reply with the reason as text. An rmw_zenoh client logs the error and continues to
  wait, because it cannot report the error to its program.
- zenoh does not notify a server when a client leaves. So Midspan's clients publish the call's attachment on
  ``<key>/@abandon``; other clients are known to have left when their liveliness tokens disappear.

A server also answers calls under the hashes of the other known versions of its type, and calls without a hash, as
Humble's clients make them. These queryables always exist, because a client may call as soon as it sees the server's
token, before the server sees the client's token, and a lost query is not repeated.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import zenoh
from typing_extensions import override

from bridge.hub.endpoints.call_server import CallServer, PendingRequest
from bridge.hub.endpoints.calls import PRIORITY, Abandon, Call, CallClient, CallError, Done, UnsentCallError, nothing
from bridge.hub.endpoints.context import EndpointContext
from bridge.hub.endpoints.variants import REQUEST, RESPONSE, Convert, Variants
from bridge.hub.errors import HubWireError
from bridge.hub.graph import HubEndpoint
from bridge.hub.graph.tokens import gid_of
from bridge.hub.wire.keys import GID_SIZE, NO_HASH, key_type, key_variant, pack_attachment, unpack_attachment
from bridge.hub.zenoh_compat import answer, keep_thread_state, subscribe
from bridge.messages.errors import ConversionError

_MAX_CALLERS = 10_000


class _HubRequest(PendingRequest):
    """A pending request and its client."""

    number: int | None = None
    seen = False


class HubServer(CallServer):
    """Serves one service on the hub; created by `bridge.hub.node.Hub.server`.

    A ``hidden`` server has no token, and accepts only calls under its own hash.

    Attributes:
        gid: the server's 16-byte id.
    """

    def __init__(
        self,
        context: EndpointContext,
        token: str,
        key: str,
        name: str,
        call: Call,
        *,
        hidden: bool = False,
    ) -> None:
        self.gid = gid_of(token)
        self._graph, self._own = context.graph, context.own
        self._callers: dict[tuple[bytes, int | None], _HubRequest] = {}
        self._unwatch: Callable[[], None] | None = None
        self._type, self._variants = key_type(key), context.variants
        hashes = dict.fromkeys((*context.variants.versions.hashes(self._type[0]), NO_HASH))
        others = () if hidden else (other for other in hashes if other != self._type[1])
        self._others = {key_variant(key, other): other for other in others}
        super().__init__(
            context.session, key, name, context.limit, call, context.closed, complete=True, reach=context.reach
        )
        self._withdraw = nothing if hidden else context.graph.announce(token)

    @override
    def _declare_additional(self, session: zenoh.Session, reach: zenoh.Locality) -> list[Any]:
        declared: list[Any] = [subscribe(session, abandon_key(self._key), self._on_abandoned, reach)]
        declared += [answer(session, key, self._on_query, complete=True, origin=reach) for key in self._others]
        return declared

    @override
    def _reply_key(self, query: zenoh.Query) -> str:
        key = str(query.key_expr)
        return key if key in self._others else self._key

    @override
    def _read(self, query: zenoh.Query) -> bytes:
        request, other = super()._read(query), self._others.get(str(query.key_expr))
        if other is None:
            return request
        name, own = self._type
        try:
            return self._variants.converter(name, other, own, REQUEST)(request)
        except ConversionError as err:
            raise CallError(str(err)) from None

    @override
    def _outgoing(self, query: zenoh.Query, reply: bytes) -> bytes | CallError:
        other, (name, own) = self._others.get(str(query.key_expr)), self._type
        try:
            return reply if other is None else self._variants.converter(name, own, other, RESPONSE)(reply)
        except ConversionError as err:
            return CallError(str(err))

    @override
    def _is_call(self, query: zenoh.Query) -> bool:
        """Return whether to accept a call: the node's own calls are ignored."""
        attachment = query.attachment
        return attachment is None or attachment.to_bytes()[-GID_SIZE:] not in self._own

    @override
    def _pending(self, query: zenoh.Query) -> _HubRequest:
        request, attachment = _HubRequest(query, self._answer), query.attachment
        if attachment is not None:  # optional for a plain zenoh program
            try:
                request.number, _time, request.caller = unpack_attachment(attachment.to_bytes())
            except HubWireError as err:
                raise CallError(str(err)) from None
            request.seen = bool(self._graph.zid_of(request.caller))
        return request

    @override
    def _attached(self, pending: PendingRequest) -> bytes | None:
        """Return the reply's attachment: the request's number and GID."""
        assert isinstance(pending, _HubRequest)
        return None if pending.number is None else pack_attachment(pending.number, time.time_ns(), pending.caller)

    # -- clients that leave --------------------------------------------------------------------------------------------

    @override
    def _on_pending(self, pending: PendingRequest) -> None:
        assert isinstance(pending, _HubRequest)
        if pending.number is not None and len(self._callers) < _MAX_CALLERS:
            self._callers[pending.caller, pending.number] = pending
        if self._unwatch is None:
            self._unwatch = self._graph.watch(self._abandon_absent_clients)

    @override
    def _on_removed(self, pending: PendingRequest) -> None:
        assert isinstance(pending, _HubRequest)
        with self._lock:
            if self._callers.get((pending.caller, pending.number)) is pending:
                del self._callers[pending.caller, pending.number]
            unwatch = None
            if not self._waiting:
                unwatch, self._unwatch = self._unwatch, None
        if unwatch is not None:
            unwatch()

    def _on_abandoned(self, sample: zenoh.Sample) -> None:
        keep_thread_state()
        try:
            number, _time, gid = unpack_attachment(sample.payload.to_bytes())
        except HubWireError:
            return
        with self._lock:
            request = self._callers.get((gid, number))
        if request is not None:
            self._abandoned(request)

    def _abandon_absent_clients(self) -> None:
        """Abandon the calls of clients whose tokens have disappeared; called after changes of the graph."""
        with self._lock:
            waiting = [
                request for request in self._waiting if isinstance(request, _HubRequest) and request.number is not None
            ]
        for request in waiting:
            present = bool(self._graph.zid_of(request.caller))
            if request.seen and not present:
                self._abandoned(request)
            request.seen = present


class _VariantClient(CallClient):
    """Makes the calls of a client under another type hash, with the client's GID and numbers.

    The numbers are shared, because a Midspan server answers under several hashes, and distinguishes the calls only by
    GID and number.

    Args:
        key: key of the calls.
        client: the client that makes the calls.
        context: context of the client's node.
        changed: called when the first server under this hash appears or the last one leaves.
        converters: convert requests to the other version, and replies from it.
    """

    def __init__(
        self, key: str, client: HubClient, context: EndpointContext, changed: Callable[[], None],
        converters: tuple[Convert, Convert],
    ) -> None:  # fmt: skip
        self._client = client
        self._to_server, self._to_client = converters
        super().__init__(
            context.session, key, client.name, context.limit, context.executor, context.ends, context.delays,
            zenoh.QueryTarget.ALL_COMPLETE, lambda _self: None, changed, context.reach,
        )  # fmt: skip
        self._withdraw, self._numbers = nothing, client._numbers

    @override
    def call(self, request: bytes, done: Done) -> Abandon:
        try:
            request = self._to_server(request)
        except ConversionError as err:
            done(UnsentCallError(str(err)))
            return nothing
        return super().call(request, partial(self._replied, done))

    def _replied(self, done: Done, result: bytes | CallError) -> None:
        if isinstance(result, bytes):
            try:
                result = self._to_client(result)
            except ConversionError as err:
                result = CallError(str(err))
        done(result)

    @override
    def _attached(self, number: int) -> bytes:
        return pack_attachment(number, time.time_ns(), self._client.gid)

    @override
    def _abandoned(self, attachment: bytes | None) -> None:
        # a server of either hash may have the call, and it listens for abandoned calls only under its own hash
        for key in (self._key, self._client._key):
            self._client._announce_abandoned(key, attachment)


class HubClient(CallClient):
    """Calls one service on the hub; created by `bridge.hub.node.Hub.client`. Safe to use from any thread.

    If several servers reply, the first reply is used. Servers that announce another type hash are called only while
    no server has the client's hash; they are called directly, and not by a relay (`bridge.routing.relay`).

    Attributes:
        gid: the client's 16-byte id in its requests.
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
        self._context, self._more = context, dict[str, _VariantClient]()  # by type hash
        super().__init__(
            context.session,
            key,
            name,
            context.limit,
            context.executor,
            context.ends,
            context.delays,
            zenoh.QueryTarget.ALL_COMPLETE,
            context.closed,
            changed,
            context.reach,
        )
        context.variants.add(self, token)
        self._withdraw = context.graph.announce(token)

    def follow_variants(self, variants: Variants) -> None:
        """Prepare calls under the other hashes that servers announce; the clients for them close with this client."""
        for type_hash in variants.keys() - self._more.keys():
            (name, own), convert = key_type(self._key), self._context.variants.converter
            converters = convert(name, own, type_hash, REQUEST), convert(name, type_hash, own, RESPONSE)
            key = key_variant(self._key, type_hash)
            self._more[type_hash] = _VariantClient(key, self, self._context, self._changed or nothing, converters)
        if self._querier is None:
            self._end_variants()

    def _end_variants(self) -> None:
        for type_hash in tuple(self._more):  # another thread may end them too
            variant = self._more.pop(type_hash, None)
            if variant is not None:
                variant.close()

    @override
    def call(self, request: bytes, done: Done) -> Abandon:
        if not self._reachable:
            for variant in tuple(self._more.values()):
                if variant.ready:
                    return variant.call(request, done)
        return super().call(request, done)

    @override
    def close(self) -> None:
        self._context.variants.remove(self)
        super().close()
        self._end_variants()

    @property
    @override
    def ready(self) -> bool:
        """Whether there is a server that does not belong to the node itself."""
        return self._reachable or any(variant.ready for variant in tuple(self._more.values()))

    @property
    @override
    def _reachable(self) -> bool:
        if not super()._reachable:
            return False
        servers = self._graph.servers(self.name)
        return not servers or any(self._answers(server) for server in servers)

    def _answers(self, server: HubEndpoint) -> bool:
        """Return whether a server answers under the client's hash: Midspan's servers do under every hash."""
        if server.gid in self._own:
            return False
        midspan = server.origin or server.pending or self._graph.is_midspan(server.zid)
        return bool(midspan) or server.key_hash == key_type(self._key)[1]

    @override
    def _attached(self, number: int) -> bytes:
        """Return the request's attachment: number, time and GID, as in rmw_zenoh."""
        return pack_attachment(number, time.time_ns(), self.gid)

    @override
    def _abandoned(self, attachment: bytes | None) -> None:
        self._announce_abandoned(self._key, attachment)

    def _announce_abandoned(self, key: str, attachment: bytes | None) -> None:
        assert attachment is not None
        self._executor.submit(partial(self._put_abandoned, key, attachment))

    def _put_abandoned(self, key: str, attachment: bytes) -> None:
        self._session.put(
            abandon_key(key),
            attachment,
            priority=PRIORITY,
            congestion_control=zenoh.CongestionControl.BLOCK,
            allowed_destination=self._reach,
        )


def abandon_key(key: str) -> str:
    """Return the key on which clients of a service announce abandoned calls; ``**`` does not match it."""
    return f"{key}/@abandon"
