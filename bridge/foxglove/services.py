"""Offers the hub's services to the app, announces them with their definitions, and calls them with the app's CDR."""

from __future__ import annotations

import contextlib
import logging
import time
from functools import partial
from threading import BoundedSemaphore
from typing import Any, NamedTuple

import foxglove
from typing_extensions import override

from bridge.client.errors import ClientError
from bridge.client.services import WAIT_SECONDS, ServiceClient
from bridge.client.types import learn
from bridge.concurrency import SerialExecutor
from bridge.foxglove.server import FoxgloveServer
from bridge.foxglove.visitors import Visitors
from bridge.hub.errors import HubError
from bridge.hub.graph.tokens import TAPS
from bridge.messages.actions import split
from bridge.messages.definitions.schema import Schema
from bridge.messages.definitions.text import full_text
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.services import ServiceCodec
from bridge.modules.host import Host

_log = logging.getLogger("midspan.foxglove")

CALL_SECONDS = 15.0
MOST_CALLS = 16
"""Maximum number of concurrent calls of all clients; each blocks one of the SDK's threads."""

REPEAT_SECONDS = 10.0  # between two requests for the same definition
_OF_NODES = ("rcl_interfaces/", "type_description_interfaces/")
"""Prefixes of the types of services that every node has; parameters are offered separately."""


class CallRefusedError(Exception):
    """A call was not made, or has no reply; the app shows the text."""


class ServiceKey(NamedTuple):
    """A service on the hub."""

    name: str
    type_name: str
    type_hash: str


class _CdrCodec(ServiceCodec):
    """The codec of the app's calls, which checks requests and leaves replies unchanged."""

    @override
    def request(self, value: Any) -> bytes:
        return self._check_request(value)

    @override
    def response_value(self, cdr: bytes) -> Any:
        return cdr


class Services:
    """All services except those of actions and nodes. Everything but the calls runs on the worker's thread."""

    def __init__(self, host: Host, server: FoxgloveServer, visitors: Visitors) -> None:
        self._host, self._server, self._visitors = host, server, visitors
        self._registry = host.node.registry
        self._room = BoundedSemaphore(MOST_CALLS)
        self._shown: dict[str, ServiceKey] = {}
        self._requested: dict[ServiceKey, float] = {}
        self._undefined = False
        self._requests = SerialExecutor("midspan-foxglove-ask")

    @property
    def count(self) -> int:
        """Number of announced services."""
        return len(self._shown)

    def refresh(self) -> None:
        """Announce new services, and withdraw those that have disappeared."""
        services: dict[str, ServiceKey] = {}
        for end in self._host.node.hub.graph.servers():
            private = end.topic.startswith(TAPS) or end.type_name.startswith(_OF_NODES) or split(end.topic)[1]
            if not (private or end.own or end.pending):
                services.setdefault(end.topic, ServiceKey(end.topic, end.type_name, end.type_hash))
        removed = [name for name, key in self._shown.items() if services.get(name) != key]
        if removed:
            self._server.withdraw_services(removed)
        for name in removed:
            del self._shown[name]
        self._undefined = False
        added = [
            added for name, key in sorted(services.items()) if name not in self._shown and (added := self._create(key))
        ]
        if added:
            self._server.offer_services(added)

    def tick(self) -> None:
        """Request definitions again that no worker had."""
        if self._undefined:
            self.refresh()

    def _create(self, key: ServiceKey) -> foxglove.Service | None:
        try:
            request, response = self._registry.service_schemas(key.type_name, key.type_hash)
        except MessageTypeError:
            self._undefined = True
            self._request(key)
            return None
        self._shown[key.name] = key
        kind = foxglove.ServiceSchema(
            key.type_name, request=_message(f"{key.type_name}_Request", request),
            response=_message(f"{key.type_name}_Response", response),
        )  # fmt: skip
        return foxglove.Service(key.name, schema=kind, handler=partial(self._serve, key))

    def _request(self, key: ServiceKey) -> None:
        """Request a definition that is not installed from the workers; `refresh` runs again when it has arrived."""
        now = time.monotonic()
        if now - self._requested.get(key, -REPEAT_SECONDS) >= REPEAT_SECONDS:
            self._requested = {other: at for other, at in self._requested.items() if now - at < REPEAT_SECONDS}
            self._requested[key] = now
            self._requests.submit(partial(self._learn, key))

    def _learn(self, key: ServiceKey) -> None:
        try:
            if learn(self._host.node.hub, self._registry, key.type_name, key.type_hash):
                self._host.loop.post(self.refresh)
        except (HubError, MessageTypeError) as err:
            _log.warning("cannot get the definition of %s: %s", key.type_name, err)

    # -- on threads of the SDK, which may block ------------------------------------------------------------------------

    def _serve(self, key: ServiceKey, request: foxglove.ServiceRequest) -> bytes:
        """Call the service; raises `CallRefusedError` if the call is refused or has no reply."""
        visitor = self._visitors.visitor_of(request.client_id)
        if visitor is None or not visitor.grant.may_drive:
            raise CallRefusedError("you may watch, but not call services (see foxglove.drive, or your token's role)")
        if not self._room.acquire(blocking=False):
            raise CallRefusedError(f"{MOST_CALLS} calls are pending; try again")
        try:
            _log.info("%s calls %s", visitor.who, key.name)
            return self._call(key, bytes(request.payload))
        except (ClientError, ConversionError, HubError, MessageTypeError) as err:
            raise CallRefusedError(str(err)) from None
        finally:
            self._room.release()

    def _call(self, key: ServiceKey, payload: bytes) -> bytes:
        codec = _CdrCodec(self._registry, key.type_name, key.type_hash)
        client = ServiceClient(self._host.node.hub, key.name, codec)
        with contextlib.closing(client):
            if not client.wait(WAIT_SECONDS):
                raise CallRefusedError(f"the server of {key.name} is unreachable from here")
            reply: bytes = client.ask(payload, CALL_SECONDS)
        return reply

    def close(self) -> None:
        self._requests.close()


def _message(name: str, schema: Schema) -> Any:
    text = full_text(schema).encode()
    return foxglove.MessageSchema(encoding="cdr", schema=foxglove.Schema(name=name, encoding="ros2msg", data=text))
