"""A service that is relayed from the clients of one type hash to servers of another."""

from __future__ import annotations

import time
from functools import partial
from threading import Event

from bridge.concurrency import BoundedQueue
from bridge.hub.endpoints.calls import Abandon, CallError, Done, UnsentCallError, nothing
from bridge.hub.endpoints.services import HubClient
from bridge.hub.endpoints.variants import REQUEST, RESPONSE, Convert
from bridge.messages.errors import ConversionError
from bridge.messages.unchanged import same
from bridge.routing.counters import Counters
from bridge.routing.limits import QUEUE_BYTES
from bridge.routing.relay.pairs import RelayKey, ServicePair
from bridge.routing.relay.topic import RelayContext

_MAX_WAITING = 1000
_CROWDED = "more than {} calls of {} wait to be relayed; call again later"
_UNREACHED = "no server of {} could be reached within {:g} s"

_PATIENCE = 1.0
"""Seconds for which a call waits until its server, whose token has arrived, can be called."""

_RECHECK = 0.05
"""Seconds after which a waiting call looks again, because the client does not report every change."""


class _WaitingCall:
    """A call that waits to be sent, or for its reply."""

    def __init__(self, request: bytes, done: Done) -> None:
        self.request, self.done = request, done
        self.since = time.monotonic()
        self.left = False
        self.end: Abandon = nothing

    def abandon(self) -> None:
        """Abandon the call; safe to call while another thread sends it."""
        self.left = True
        self.end()


class RelayedService:
    """Answers the clients of one hash, and forwards their calls to servers of another hash.

    Its server is hidden, because rmw_zenoh's clients already see the other servers, whose hashes they ignore. Such a
    client may call as soon as it sees a server, and never repeats a call. So the hidden server exists as soon as a
    client waits for the service, and calls wait for a moment until the other server is known and can be called. The
    receiving threads only queue the calls, because sending may wait for a congested link.
    """

    def __init__(self, key: RelayKey, pair: ServicePair, context: RelayContext) -> None:
        self.key, self.pair = key, pair
        self.counters = Counters()
        self._to_server: Convert = same
        self._to_client: Convert = same
        self._queue = BoundedQueue[_WaitingCall]("midspan-relay", _MAX_WAITING, QUEUE_BYTES, self._send, nothing)
        self._changed = Event()
        self._context = context
        self._server = context.node.server(*key[:3], self._call, hidden=True)
        self._client: HubClient | None = None

    def fits(self, pair: ServicePair) -> bool:
        """Return whether `update` can follow a pair: its servers have the same hash as before, if there were any."""
        return self._client is None or bool(pair.servers and pair.type_hash == self.pair.type_hash)

    def update(self, pair: ServicePair) -> None:
        """Follow clients and servers; the first servers get the waiting calls."""
        self.pair = pair
        if self._client is None and pair.servers:
            (name, type_name, own, _), other = self.key, pair.type_hash
            self._to_server = self._converter(type_name, own, other, REQUEST)
            self._to_client = self._converter(type_name, other, own, RESPONSE)
            self._client = self._context.node.client(name, type_name, other, self._changed.set)
            self._changed.set()

    def _converter(self, type_name: str, source: str, target: str, part: str) -> Convert:
        return self._context.versions.converter(type_name, source, target, part) or same

    def _call(self, request: bytes, done: Done) -> Abandon:
        """Queue a call; called on the receiving threads."""
        call = _WaitingCall(request, done)
        if self._queue.offer(call, len(request)):
            return call.abandon
        done(UnsentCallError(_CROWDED.format(_MAX_WAITING, self.key.topic)))
        return nothing

    def _reachable(self, call: _WaitingCall) -> HubClient | None:
        """Wait until the server can be called; return None if a call has waited too long, or was abandoned."""
        while not call.left:
            self._changed.clear()
            client, left = self._client, call.since + _PATIENCE - time.monotonic()
            if client is not None and client.ready:
                return client
            if left <= 0:
                return None
            self._changed.wait(min(left, _RECHECK))
        return None

    def _send(self, call: _WaitingCall) -> None:
        client = self._reachable(call)
        if client is None:
            call.done(UnsentCallError(_UNREACHED.format(self.key.topic, _PATIENCE)))
            return
        try:
            request = self._to_server(call.request)
        except ConversionError as err:
            call.done(UnsentCallError(str(err)))
            return
        self.counters.crossed(len(request))
        call.end = client.call(request, partial(self._reply, call.done))
        if call.left:
            call.end()

    def _reply(self, done: Done, result: bytes | CallError) -> None:
        if isinstance(result, bytes):
            try:
                result = self._to_client(result)
            except ConversionError as err:
                result = CallError(str(err))
        if isinstance(result, CallError):
            self.counters.failed(str(result))
        done(result)

    def close(self) -> None:
        """Stop relaying; pending calls fail."""
        self._server.close()
        self._changed.set()
        if self._client is not None:
            self._client.close()
        self._context.closing.submit(self._queue.close)
