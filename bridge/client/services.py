"""Clients of services on the hub; a call passes its reply to a callback, or waits for it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from bridge.client.errors import ClientError
from bridge.hub.endpoints.calls import Abandon, CallError
from bridge.hub.endpoints.services import HubClient
from bridge.hub.graph import HubGraph
from bridge.hub.node import Hub
from bridge.messages.errors import ConversionError
from bridge.routing.counters import Counters
from bridge.text import clean

if TYPE_CHECKING:
    from bridge.client.session import Client
    from bridge.client.types import Types
    from bridge.messages.services import ServiceCodec

WAIT_SECONDS = 5.0
_MOST_SECONDS = 20.0
"""Longest wait for a server while the graph keeps changing, for example because a program restarts all the time."""
_POLL_SECONDS = 0.2

Replied = Callable[[Any], None]
"""Receives the reply, or a `CallError`."""

Post = Callable[[Callable[[], Any]], None]
"""Runs a callback, at once or on another thread."""


def at_once(action: Callable[[], Any]) -> None:
    """Run a callback on the calling thread."""
    action()


class ServiceClient:
    """A client of one service on the hub. Safe to use from any thread.

    Args:
        hub: the client's node.
        name: the service.
        codec: the codec of the service's type; it determines the form of requests and replies.
        post: runs the callbacks; by default they run on a thread of the hub.
    """

    KIND = "client"

    def __init__(self, hub: Hub, name: str, codec: ServiceCodec, post: Post = at_once) -> None:
        self.topic, self.type_name = name, codec.type.name
        self.counters = Counters()
        self._codec, self._post = codec, post
        self._changed = threading.Event()
        self._end: HubClient = hub.client(name, self.type_name, codec.type.type_id, self._changed.set)

    @property
    def ready(self) -> bool:
        """Whether there is a server to call."""
        return self._end.ready

    def wait(self, seconds: float) -> bool:
        """Wait for a server; return whether there is one."""
        end = time.monotonic() + seconds
        while not self.ready:
            self._changed.clear()
            if not self.ready and not self._changed.wait(max(end - time.monotonic(), 0.0)):
                return False
        return True

    def call(self, request: Mapping[str, Any], replied: Replied) -> Abandon:
        """Call the service without a timeout; ``replied`` receives the reply or an error, once.

        Raises `ConversionError` if the request has an unknown field, or a value that does not fit.
        """
        payload = self._codec.request(request)
        self.counters.crossed(len(payload))
        return self._end.call(payload, lambda result: self._post(lambda: replied(self._decode(result))))

    def ask(self, request: Any, seconds: float | None = None, check: Callable[[], None] = lambda: None) -> Any:
        """Call and wait for the reply; raises `ClientError`. ``check`` is called regularly; its error ends the call."""
        replies: SimpleQueue[Any] = SimpleQueue()
        abandon = self.call(request, replies.put)
        try:
            reply = _get(replies, seconds, check)
        except BaseException:
            abandon()
            raise
        if reply is None:
            abandon()
            raise ClientError(f"{self.topic} has not answered in {seconds:g} s")
        if isinstance(reply, CallError):
            raise ClientError(f"{self.topic}: {clean(reply)}")
        return reply

    def close(self) -> None:
        """Close the client; pending calls end with an error."""
        self._end.close()

    def _decode(self, result: bytes | CallError) -> Any:
        if isinstance(result, CallError):
            self.counters.failed(str(result))
            return result
        try:
            return self._codec.response_value(result)
        except ConversionError as err:
            self.counters.failed(str(err))
            return CallError(f"the server sent a malformed reply: {err}")


def _get(replies: SimpleQueue[Any], seconds: float | None, check: Callable[[], None]) -> Any:
    """Wait for the next reply; return None after ``seconds``. Interruptible on every system."""
    waited = 0.0
    while seconds is None or waited < seconds:
        check()
        step = _POLL_SECONDS if seconds is None else min(_POLL_SECONDS, seconds - waited)
        try:
            return replies.get(timeout=step)
        except Empty:
            waited += step
    return None


class ServiceCaller(ServiceClient):
    """A service client with JSON values; without a type it uses the type of the server.

    Raises `ClientError` if no server of the type appears within `WAIT_SECONDS`, or the type is unknown.
    """

    def __init__(self, client: Client, types: Types, name: str, type_name: str = "", post: Post = at_once) -> None:
        from bridge.messages.json import CallCodec

        kind = served(client.hub.graph, name, type_name)
        types.prepare_service(*kind)
        super().__init__(client.hub, name, CallCodec(types.registry, *kind), post)
        if not self.wait(WAIT_SECONDS):
            self.close()
            raise ClientError(f"the server of {name} does not accept calls from here")

    @override
    def call(self, request: Mapping[str, Any], replied: Replied) -> Abandon:
        """Call as `ServiceClient.call` does; raises `ClientError` if the values do not fit."""
        try:
            return super().call(request, replied)
        except ConversionError as err:
            raise ClientError(f"{self.type_name}: {err}") from None


def served(graph: HubGraph, name: str, wanted: str = "") -> tuple[str, str]:
    """Wait for a service's server on the hub; return its type and hash.

    Raises `ClientError` if no server of the type ``wanted`` ("": any type) has appeared when the graph has not changed
    for `WAIT_SECONDS`, or after `_MOST_SECONDS`, or if ``wanted`` is "" and the servers have different types.
    """
    changed = threading.Event()
    unwatch, end = graph.watch(changed.set), time.monotonic() + _MOST_SECONDS
    try:
        while True:
            kinds = {(e.type_name, e.type_hash) for e in graph.servers(name)}
            fitting = sorted(kind for kind in kinds if wanted in ("", kind[0]))
            if len(fitting) > 1 and not wanted:
                raise ClientError(f"{name} is served as several types: {', '.join(t for t, _ in fitting)}; choose one")
            if fitting:
                return fitting[0]
            if time.monotonic() > end or not changed.wait(WAIT_SECONDS):
                break
            changed.clear()
    finally:
        unwatch()
    if kinds:
        raise ClientError(f"{name} is {', '.join(sorted(t for t, _ in kinds))} on the hub, not {wanted}")
    raise ClientError(f"{name} has no server on the hub; 'midspan explain {name}' shows why")
