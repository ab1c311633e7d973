"""The edge of the JSON dialect: configured keys, for programs without ROS.

A sample is a JSON object with the message's fields, and has the encoding ``application/json``. Endpoints are not
announced; each configured key is a topic with one publisher. Latched messages from the hub are cached, and a plain
``get`` on the key returns the newest of them. A key with a service type is called with a ``get`` whose payload is the
request.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

import zenoh
from typing_extensions import override

from bridge.adapters.zenoh.edge import KeyEdge
from bridge.adapters.zenoh.neighbors import ticks
from bridge.adapters.zenoh.services import KeyCaller, KeyServer
from bridge.adapters.zenoh.topics import Announcement, KeyContext, KeyPublisher, KeySubscription, SourceOf
from bridge.config.model import Config
from bridge.config.sections.zenoh import Dialect, DialectKey
from bridge.hub.endpoints.calls import Call
from bridge.hub.endpoints.latched import AGAIN_SECONDS
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.hub.zenoh_compat import undeclare
from bridge.messages.errors import ConversionError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, ServiceConversion, SideType
from bridge.routing.edge import Deliver, Endpoint, Kind, MadeBy

_QUERY_SECONDS = 5.0
_JSON = zenoh.Encoding.APPLICATION_JSON


class JsonKeysEdge(KeyEdge):
    """Joins programs that exchange JSON on configured keys."""

    side: ClassVar[str] = "zenoh_json"
    services: ClassVar[bool] = True

    def __init__(self, config: Config, dialect: Dialect, registry: Registry, state: Path) -> None:
        self._in = {key.hub_topic: key for key in dialect.keys if key.direction in ("in", "both")}
        self._out = {key.hub_topic: key for key in dialect.keys if key.direction in ("out", "both")}
        keys = "\n".join(sorted(str(key.key) for key in dialect.keys))
        super().__init__(config, dialect, registry, state, hashlib.sha256(keys.encode()).hexdigest()[:16])

    @override
    def on_open(self, session: zenoh.Session) -> None:
        """Do nothing, because programs do not announce keys; the configuration lists them."""

    @override
    def endpoints(self) -> Sequence[Endpoint]:
        directions = ((self._in, Kind.PUBLISHER, Kind.SERVER), (self._out, Kind.SUBSCRIPTION, Kind.CLIENT))
        return [
            self._endpoint(service if key.is_service else topic, key)
            for keys, topic, service in directions
            for key in keys.values()
        ]

    def _endpoint(self, kind: Kind, key: DialectKey) -> Endpoint:
        qos = LATCHED if key.latched else Qos()
        return Endpoint(str(key.key), kind, key.hub_topic, key.type, qos, MadeBy.NATIVE, f"zenoh key {key.key}")

    @override
    def why_not(self, topic: str, type_name: str) -> str:
        """Return why a topic has no JSON key of its type; "" if it has one."""
        key = self._out.get(topic)
        if key is None:
            return "zenoh.dialects lists no JSON key for it"
        if key.type != type_name:
            return f"the JSON key {key.key} carries {key.type}, not {type_name}"
        return ""

    @override
    def to_hub(self, endpoint: Endpoint) -> Conversion:
        known = self._registry.ros2(endpoint.type)
        return Conversion(known, known, text_to_cdr(self._registry, endpoint.type))

    @override
    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """Return the conversion to JSON; the definition must be the publisher's, because JSON has field names."""
        known = self._own_type(type_name, type_hash)
        return Conversion(known, known, cdr_to_text(self._registry, type_name))

    @override
    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        """Return the conversion to JSON and back; the definition must be the server's, because JSON has field names."""
        known = self._registry.service_ros2(type_name, type_hash)
        request, response = f"{known.name}_Request", f"{known.name}_Response"
        to_side, to_hub = partial(cdr_to_text, self._registry), partial(text_to_cdr, self._registry)
        return ServiceConversion(
            known, known, request_to_side=to_side(request), request_to_hub=to_hub(request),
            response_to_side=to_side(response), response_to_hub=to_hub(response),
        )  # fmt: skip

    @override
    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> KeySubscription:
        """Subscribe to a key; if it is latched, also query programs and zenoh storages with a ``get``."""
        key = self._in[topic]
        name = str(key.key)
        kind = LatchedKeySubscription if key.latched and qos.latched else KeySubscription
        return self.register(kind(self.context, name, qos, deliver, lambda _: name, Announcement()))

    @override
    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> KeyPublisher:
        """Publish JSON on a key; a ``get`` on a latched key returns the newest message."""
        key = str(self._out[topic].key)
        return self.register(KeyPublisher(self.context, key, qos, Announcement(), encoding=_JSON, newest=True))

    @override
    def caller(self, name: str, side_type: SideType) -> KeyCaller:
        return self.register(KeyCaller(self.context, str(self._in[name].key), name, Announcement(), encoding=_JSON))

    @override
    def serve(self, name: str, side_type: SideType, call: Call) -> KeyServer:
        request, _ = self._registry.service_schemas(side_type.name, side_type.type_id)
        nothing = None if request.root.fields else b"{}"
        key = str(self._out[name].key)
        return self.register(KeyServer(self.context, key, name, call, Announcement(), nothing, _JSON))


class LatchedKeySubscription(KeySubscription):
    """A subscription to a latched key, which also queries the programs and storages that store its value.

    It queries them when the first of them appears, for example with the router or after a link was lost, and repeats
    the query while nothing replies, since a reply may be lost.

    A stored value never follows a newer one, since the hub retains the last. A published value is newer than a stored
    one unless the time stamps show otherwise, and of two stored values the later reply counts unless they do.
    """

    def __init__(
        self, context: KeyContext, key: str, qos: Qos, deliver: Deliver, source_of: SourceOf, announcement: Announcement
    ) -> None:
        self._order = threading.Lock()
        self._published = False
        self._newest = 0
        self._context = context
        super().__init__(context, key, qos, deliver, source_of, announcement)
        self._querier = context.session.declare_querier(key, allowed_destination=zenoh.Locality.REMOTE)
        handler = zenoh.handlers.Callback(self._on_match_changed, indirect=False)
        self._listener = self._querier.declare_matching_listener(handler)

    @override
    def close(self) -> None:
        if self._open:
            undeclare(self._listener, self._querier)
        super().close()

    def _on_match_changed(self, status: zenoh.MatchingStatus) -> None:
        """Query the stored value if there is now a program or storage to query; runs on a zenoh thread."""
        if status.matching:
            with self._order:
                self._published = False  # newer values may have been missed while the link was lost
            self._context.executor.submit(partial(self._query, AGAIN_SECONDS))

    def _query(self, pauses: tuple[float, ...]) -> None:
        """Query the stored value, and again after each of the ``pauses`` in seconds until there is a reply."""
        if not self._open:
            return
        replied = threading.Event()

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None and self.on_stored(reply.ok):
                replied.set()

        def on_done() -> None:
            if pauses and not replied.is_set():
                again = partial(self._query, pauses[1:])
                self._context.delays.after(pauses[0], partial(self._context.executor.submit, again))

        handler, remote = zenoh.handlers.Callback(on_reply, on_done, indirect=False), zenoh.Locality.REMOTE
        with contextlib.suppress(zenoh.ZError):  # the session is being closed
            self._context.session.get(self.key, handler, timeout=_QUERY_SECONDS, allowed_destination=remote)

    @override
    def accept(self, sample: zenoh.Sample, source: str) -> None:
        with self._order:
            self._published, self._newest = True, ticks(sample)
            super().accept(sample, source)

    def on_stored(self, sample: zenoh.Sample) -> bool:
        """Queue a stored value, unless it is older than the last one; return whether it is not from a Midspan."""
        source, stamp = self.native(sample), ticks(sample)
        if not source:
            return False
        with self._order:
            is_older = stamp <= self._newest if stamp and self._newest else self._published
            if not is_older:
                self._newest = stamp
                super().accept(sample, source)
        return True


def text_to_cdr(registry: Registry, type_name: str) -> Callable[[bytes], bytes]:
    """Return a function that converts JSON text to CDR; it raises `ConversionError`."""

    def convert(text: bytes) -> bytes:
        try:
            value = json.loads(text)
        except (ValueError, RecursionError) as err:
            raise ConversionError(f"invalid JSON: {err}") from None
        if not isinstance(value, dict):
            raise ConversionError(f"{type_name} has to be a JSON object with its fields, not {type(value).__name__}")
        return from_json(registry, type_name, value)

    return convert


def cdr_to_text(registry: Registry, type_name: str) -> Callable[[bytes], bytes]:
    """Return a function that converts CDR to JSON text in UTF-8."""

    def convert(cdr: bytes) -> bytes:
        value = to_json(registry, type_name, cdr)
        return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()

    return convert
