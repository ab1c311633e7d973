"""The edge of the JSON dialect: the keys that the configuration names, for programs that have no ROS.

A sample is a JSON object with the message's fields, encoding ``application/json``. Nobody announces anything here: a
configured key is a topic with one publisher. What comes from the hub latched is kept, and a plain ``get`` on its key
is answered with the newest message. A key whose type is a service's is called by a ``get`` with the request as its
payload.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

import zenoh

from bridge.adapters.zenoh.edge import KeyEdge
from bridge.adapters.zenoh.services import KeyCaller, KeyServer
from bridge.adapters.zenoh.topics import Announcement, KeyPublisher, KeySubscription
from bridge.config.model import Config
from bridge.config.sections.zenoh import Dialect, DialectKey
from bridge.hub.endpoints.calls import Call
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.errors import ConversionError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, ServiceConversion, SideType
from bridge.routing.edge import Deliver, Endpoint, Kind, MadeBy

_ASK_SECONDS = 5.0
_JSON = zenoh.Encoding.APPLICATION_JSON


class JsonKeysEdge(KeyEdge):
    """Joins the programs that speak JSON on configured keys."""

    side: ClassVar[str] = "zenoh_json"
    services: ClassVar[bool] = True

    def __init__(self, config: Config, dialect: Dialect, registry: Registry, state: Path) -> None:
        self._in = {key.hub_topic: key for key in dialect.keys if key.direction in ("in", "both")}
        self._out = {key.hub_topic: key for key in dialect.keys if key.direction in ("out", "both")}
        keys = "\n".join(sorted(str(key.key) for key in dialect.keys))
        super().__init__(config, dialect, registry, state, hashlib.sha256(keys.encode()).hexdigest()[:16])

    def opened(self, session: zenoh.Session) -> None:
        """Nothing is announced; the keys are those of the configuration."""

    def endpoints(self) -> Sequence[Endpoint]:
        """The configured keys."""
        ways = ((self._in, Kind.PUBLISHER, Kind.SERVER), (self._out, Kind.SUBSCRIPTION, Kind.CLIENT))
        return [
            self._endpoint(service if key.is_service else topic, key)
            for keys, topic, service in ways
            for key in keys.values()
        ]

    def _endpoint(self, kind: Kind, key: DialectKey) -> Endpoint:
        qos = LATCHED if key.latched else Qos()
        return Endpoint(str(key.key), kind, key.hub_topic, key.type, qos, MadeBy.NATIVE, f"zenoh key {key.key}")

    def why_not(self, topic: str, type_name: str) -> str:
        """Only configured keys are published on."""
        key = self._out.get(topic)
        if key is None:
            return "zenoh.dialects names no JSON key that takes it"
        if key.type != type_name:
            return f"the JSON key {key.key} takes {key.type}, not {type_name}"
        return ""

    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """From JSON."""
        known = self._registry.ros2(endpoint.type)
        return Conversion(known, known, text_to_cdr(self._registry, endpoint.type))

    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """To JSON; JSON names the fields, so that the definition must be the publisher's own."""
        known = self._own_type(type_name, type_hash)
        return Conversion(known, known, cdr_to_text(self._registry, type_name))

    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        """To JSON and back; JSON names the fields, so that the definition must be the server's own."""
        known = self._registry.service_ros2(type_name, type_hash)
        request, response = f"{known.name}_Request", f"{known.name}_Response"
        to_side, to_hub = partial(cdr_to_text, self._registry), partial(text_to_cdr, self._registry)
        return ServiceConversion(
            known, known, request_to_side=to_side(request), request_to_hub=to_hub(request),
            response_to_side=to_side(response), response_to_hub=to_hub(response),
        )  # fmt: skip

    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> KeySubscription:  # noqa: ARG002
        """Subscribe to a key; of a latched one, a program or zenoh storage that answers a ``get`` is asked first."""
        key = self._in[topic]
        name = str(key.key)
        part = self.register(KeySubscription(self.context, name, qos, deliver, lambda _: name, Announcement()))
        if key.latched and qos.latched:
            self._ask(name, part)
        return part

    def _ask(self, key: str, part: KeySubscription) -> None:
        def came(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                source = part.native(reply.ok)
                if source:
                    part.take(reply.ok, source)

        handler, remote = zenoh.handlers.Callback(came, indirect=False), zenoh.Locality.REMOTE
        self.context.session.get(key, handler, timeout=_ASK_SECONDS, allowed_destination=remote)

    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> KeyPublisher:  # noqa: ARG002
        """Publish on a key."""
        key = str(self._out[topic].key)
        return self.register(KeyPublisher(self.context, key, qos, Announcement(), encoding=_JSON, newest=True))

    def caller(self, name: str, side_type: SideType) -> KeyCaller:  # noqa: ARG002
        """Call a key by a ``get``."""
        return self.register(KeyCaller(self.context, str(self._in[name].key), name, Announcement(), encoding=_JSON))

    def serve(self, name: str, side_type: SideType, call: Call) -> KeyServer:
        """Answer each ``get`` on a key."""
        request, _ = self._registry.service_schemas(side_type.name, side_type.type_id)
        nothing = None if request.root.fields else b"{}"
        key = str(self._out[name].key)
        return self.register(KeyServer(self.context, key, name, call, Announcement(), nothing, _JSON))


def text_to_cdr(registry: Registry, type_name: str) -> Callable[[bytes], bytes]:
    """The converter of JSON texts to CDR."""

    def convert(text: bytes) -> bytes:
        try:
            value = json.loads(text)
        except (ValueError, RecursionError) as err:
            raise ConversionError(f"no JSON: {err}") from None
        if not isinstance(value, dict):
            raise ConversionError(f"a {type_name} is a JSON object with its fields, not {type(value).__name__}")
        return from_json(registry, type_name, value)

    return convert


def cdr_to_text(registry: Registry, type_name: str) -> Callable[[bytes], bytes]:
    """The converter of CDR to JSON texts in UTF-8."""

    def convert(cdr: bytes) -> bytes:
        value = to_json(registry, type_name, cdr)
        return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()

    return convert
