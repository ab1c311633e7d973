"""The edge of the JSON dialect: the keys that the configuration names, for programs that have no ROS.

A sample is a JSON object with the message's fields, encoding ``application/json``. Nobody announces anything here: a
configured key is a topic with one publisher. What comes from the hub latched is kept, and a plain ``get`` on its key
is answered with the newest message. A key whose type is a service's is called by a ``get`` with the request as its
payload.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import zenoh

from bridge.adapters.base import (
    Deliver,
    EdgeCaller,
    EdgePublisher,
    EdgeServer,
    EdgeSubscription,
    Endpoint,
    Kind,
    MadeBy,
)
from bridge.adapters.zenoh.edge import KeyEdge
from bridge.adapters.zenoh.json_text import cdr_to_text, text_to_cdr
from bridge.adapters.zenoh.kept_publisher import KeptPublisher
from bridge.adapters.zenoh.key_caller import KeyCaller
from bridge.adapters.zenoh.key_server import KeyServer
from bridge.adapters.zenoh.subscription import KeySubscription
from bridge.config.model import Config
from bridge.config.sections.zenoh import Dialect, DialectKey
from bridge.hub.call import Call
from bridge.hub.qos import Durability, Qos
from bridge.messages.conversion import Conversion, ServiceConversion, SideType
from bridge.messages.errors import MessageTypeError
from bridge.messages.registry import Registry

_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
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

    # -- the graph -----------------------------------------------------------------------------------------------------

    def endpoints(self) -> Sequence[Endpoint]:
        """The configured keys."""
        ways = ((self._in, Kind.PUBLISHER, Kind.SERVER), (self._out, Kind.SUBSCRIPTION, Kind.CLIENT))
        return [
            self._endpoint(service if key.is_service else topic, key)
            for keys, topic, service in ways
            for key in keys.values()
        ]

    def _endpoint(self, kind: Kind, key: DialectKey) -> Endpoint:
        qos = _LATCHED if key.latched else Qos()
        return Endpoint(str(key.key), kind, key.hub_topic, key.type, qos, MadeBy.NATIVE, f"zenoh key {key.key}")

    def why_not(self, topic: str, type_name: str) -> str:
        """Only configured keys are published on."""
        key = self._out.get(topic)
        if key is None:
            return "zenoh.dialects names no JSON key that takes it"
        if key.type != type_name:
            return f"the JSON key {key.key} takes {key.type}, not {type_name}"
        return ""

    # -- types ---------------------------------------------------------------------------------------------------------

    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """From JSON."""
        known = self.registry.ros2(endpoint.type)
        return Conversion(known, known, text_to_cdr(self.registry, endpoint.type))

    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """To JSON; JSON names the fields, so that the definition must be the publisher's own."""
        known = self.registry.ros2(type_name)
        if type_hash and type_hash != known.type_id:
            raise MessageTypeError(
                f"{type_name}: its publisher has {type_hash}, this machine's definition has {known.type_id}",
                "install the same version of the message package on both, or give its .msg folder in types.folders",
            )
        return Conversion(known, known, cdr_to_text(self.registry, type_name))

    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        """From JSON and back."""
        return self.service_from_hub(endpoint.type, "")

    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        """To JSON and back; JSON names the fields, so that the definition must be the server's own."""
        known = self.registry.service_ros2(type_name, type_hash)
        request, response = f"{known.name}_Request", f"{known.name}_Response"
        return ServiceConversion(
            known,
            known,
            request_to_side=cdr_to_text(self.registry, request),
            request_to_hub=text_to_cdr(self.registry, request),
            response_to_side=cdr_to_text(self.registry, response),
            response_to_hub=text_to_cdr(self.registry, response),
        )

    # -- endpoints of ours ---------------------------------------------------------------------------------------------

    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> EdgeSubscription:  # noqa: ARG002
        """Hear a key; of a latched one, whoever answers a ``get`` (a program, a zenoh storage) is asked first."""
        key = self._in[topic]
        name = str(key.key)
        part = KeySubscription(self.session, name, self.inbox(deliver, qos), lambda _sample: name, self.drop)
        self.keep(part)
        if key.latched and qos.latched:
            self._ask(name, part)
        return part

    def _ask(self, key: str, part: KeySubscription) -> None:
        def came(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                source = part.native(reply.ok)
                if source:
                    part.take(reply.ok, source)

        self.session.get(
            key,
            zenoh.handlers.Callback(came, indirect=False),
            timeout=_ASK_SECONDS,
            allowed_destination=zenoh.Locality.REMOTE,
        )

    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> EdgePublisher:  # noqa: ARG002
        """Publish on a key."""
        key = str(self._out[topic].key)
        publisher = KeptPublisher(self.session, key, qos, _JSON, self.drop, newest=True)
        self.keep(publisher)
        return publisher

    def caller(self, name: str, side_type: SideType) -> EdgeCaller:  # noqa: ARG002
        """Call a key by a ``get``."""
        part = KeyCaller(
            self.session, str(self._in[name].key), name, self.limit, self.errands, _nothing, self.drop, encoding=_JSON
        )
        self.keep(part)
        return part

    def serve(self, name: str, side_type: SideType, call: Call) -> EdgeServer:
        """Answer each ``get`` on a key."""
        request, _ = self.registry.service_schemas(side_type.name, side_type.type_id)
        nothing = None if request.root.fields else b"{}"
        key = str(self._out[name].key)
        part = KeyServer(
            self.session, key, name, self.limit, call, _nothing, self.drop, nothing=nothing, encoding=_JSON
        )
        self.keep(part)
        return part


def _nothing() -> None:
    """Nothing is announced."""
