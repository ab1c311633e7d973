"""Services that a module serves, with Python values as requests and replies."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from threading import Lock
from typing import Any

from bridge.hub.endpoints.calls import Abandon, CallError, Done, nothing
from bridge.hub.endpoints.services import HubServer
from bridge.hub.node import Hub
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter
from bridge.modules.loop import EventLoop
from bridge.routing.counters import Counters

_log = logging.getLogger(__name__)

MAX_WAITING = 1000
"""Maximum number of pending requests per server."""

Answer = Callable[[Mapping[str, Any] | CallError], None]
"""Sends the reply or an error; called once, from any thread."""

Serve = Callable[[dict[str, Any], Answer], Any]
"""``serve(request, answer)`` runs on the module's thread; ``answer`` may be called later."""


class ModuleServer:
    """A server of one service on the hub, created by `bridge.modules.host.ModuleNode.server`."""

    KIND = "server"

    def __init__(
        self,
        hub: Hub,
        registry: Registry,
        loop: EventLoop,
        name: str,
        type_name: str,
        serve: Serve,
        at_once: Callable[[dict[str, Any]], None] | None = None,
    ) -> None:
        side = registry.service_ros2(type_name)
        self.topic, self.type_name = name, type_name
        self.counters = Counters()
        self.caller = b""  # GID of the client that is being served; valid on the module's thread
        self._loop, self._serve, self._at_once = loop, serve, at_once
        self._request, self._response = registry.service_schemas(type_name)
        self._check, _ = registry.hub_service_check(type_name)
        self.waiting = 0
        self._lock = Lock()
        self._end: HubServer = hub.server(name, type_name, side.type_id, self._call)

    def close(self) -> None:
        self._end.close()

    def _call(self, payload: bytes, done: Done) -> Abandon:
        if self.waiting >= MAX_WAITING:
            self.counters.dropped("queue")
            done(CallError(f"{self.topic} is busy: {MAX_WAITING} requests are pending"))
            return nothing
        try:
            request = MessageReader(self._request, self._check(payload)).message()
        except ConversionError as err:
            self.counters.dropped("bad")
            self.counters.failed(str(err))
            done(CallError(f"{self.topic}: {err}"))
            return nothing
        self.count(1)
        self.counters.crossed(len(payload))
        pending = _Pending(self, done)
        if self._at_once is not None:
            self._at_once(request)
        self._loop.post(lambda: self._begin(request, pending))
        return pending.abandon

    def _begin(self, request: dict[str, Any], pending: _Pending) -> None:
        if pending.over:
            return
        self.caller = pending.caller
        try:
            self._serve(request, pending.answer)
        except Exception as err:
            _log.exception("%s failed", self.topic)
            pending.answer(CallError(f"{self.topic} failed: {type(err).__name__}: {err}"))

    def encode(self, reply: Mapping[str, Any]) -> bytes | CallError:
        """Encode a reply as CDR; return a `CallError` if it does not fit the type."""
        try:
            return MessageWriter(self._response).message(reply)
        except ConversionError as err:
            self.counters.failed(str(err))
            return CallError(f"{self.topic} sent a malformed reply: {err}")

    def fits(self, reply: Mapping[str, Any]) -> bool:
        """Return whether a reply fits the type."""
        try:
            MessageWriter(self._response).message(reply)
        except ConversionError:
            return False
        return True

    def count(self, step: int) -> None:
        """Add ``step`` to the number of pending requests."""
        with self._lock:
            self.waiting += step


class _Pending:
    """A pending request. Safe to use from any thread."""

    def __init__(self, server: ModuleServer, done: Done) -> None:
        self._server, self._done = server, done
        self.caller: bytes = getattr(done, "caller", b"")
        self._lock = Lock()
        self.over = False

    def answer(self, reply: Mapping[str, Any] | CallError) -> None:
        if self._end():
            self._done(reply if isinstance(reply, CallError) else self._server.encode(reply))

    def abandon(self) -> None:
        self._end()

    def _end(self) -> bool:
        with self._lock:
            over, self.over = self.over, True
        if not over:
            self._server.count(-1)
        return not over
