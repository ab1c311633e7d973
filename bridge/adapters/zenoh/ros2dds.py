"""The edge of the ros2dds dialect: the keys of zenoh-plugin-ros2dds.

A topic's or service's key is the namespace of its bridge and its ROS 2 name without the leading slash. The payload is
CDR; topics have no attachment. Transient-local publishers are zenoh's advanced publishers, and servers are queryables.
Liveliness tokens announce all endpoints, an action's as a whole (`bridge.adapters.zenoh.ros2dds_tokens`). Source:
zenoh-plugin-ros2dds of August 2026, ``src/ros2_utils.rs``, ``route_publisher.rs``, ``route_subscriber.rs``,
``route_service_srv.rs``, ``route_service_cli.rs``.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import ClassVar

import zenoh
from typing_extensions import override

from bridge.adapters.zenoh.edge import KeyEdge, configured
from bridge.adapters.zenoh.ros2dds_graph import Ros2ddsGraph, TokenAnnouncer, endpoint_id
from bridge.adapters.zenoh.ros2dds_topics import LatchedSubscription, Ros2ddsPublisher
from bridge.adapters.zenoh.services import KeyCaller, KeyServer
from bridge.adapters.zenoh.topics import Announcement, KeySubscription
from bridge.concurrency import DelayedCalls
from bridge.config.model import Config
from bridge.config.sections.zenoh import Dialect
from bridge.hub.endpoints.calls import Abandon, Call, CallError, Done
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from bridge.messages.services import refusal
from bridge.messages.transcode.conversion import SideType
from bridge.routing.edge import Deliver, Endpoint, Kind, MadeBy
from bridge.routing.limits import combined_qos
from bridge.routing.rewrites import TF_TYPE

_EMPTY = b"\0\1\0\0\0"
"""An empty message in CDR; like every empty ROS 2 structure it has one byte."""

_REQUEST_ID = b"rqh"
PLAIN = "plain program"
"""The publisher's name for a configured key that no bridge announces."""


class Ros2ddsEdge(KeyEdge):
    """Joins the bridges of the ros2dds dialect; ``json_keys`` are keys of this network that carry JSON."""

    side: ClassVar[str] = "zenoh_ros2dds"
    services: ClassVar[bool] = True

    def __init__(
        self, config: Config, dialect: Dialect, registry: Registry, state: Path, json_keys: frozenset[str] = frozenset()
    ) -> None:
        namespace = (dialect.namespace or "/").strip("/")
        super().__init__(config, dialect, registry, state, namespace)
        self._prefix = f"{namespace}/" if namespace else ""
        self._json_keys = json_keys
        self._plain = {self._prefix + str(key.topic)[1:] for key in dialect.keys}
        self._heartbeats = DelayedCalls(f"midspan-{self.side}-heartbeats")
        self._graph: Ros2ddsGraph | None = None
        self._announcer: TokenAnnouncer | None = None

    @override
    def on_open(self, session: zenoh.Session) -> None:
        self._announcer = TokenAnnouncer(session)
        self._graph = Ros2ddsGraph(session, self._prefix, self._tokens_changed)

    @override
    def on_close(self) -> None:
        self._heartbeats.close(1.0)
        if self._graph is not None and self._announcer is not None:
            self._graph.close()
            self._announcer.close()

    def _tokens_changed(self) -> None:
        graph = self._graph
        if graph is not None:
            with self._lock:
                latched = [part for part in self._endpoints if isinstance(part, LatchedSubscription)]
            for subscription in latched:
                subscription.ask_for(_announced_depth(graph, subscription.key))
        self._graph_changed()

    @override
    def endpoints(self) -> Sequence[Endpoint]:
        announced = [] if self._graph is None else self._graph.endpoints()
        return [e for e in announced if self._key(e.topic) not in self._json_keys] + self._plain_endpoints()

    def _plain_endpoints(self) -> list[Endpoint]:
        def endpoint(topic: str, known: SideType) -> Endpoint:
            id_ = endpoint_id(PLAIN, self._key(topic))
            return Endpoint(id_, Kind.PUBLISHER, topic, known.name, Qos(), MadeBy.NATIVE, PLAIN, known.type_id)

        return configured(self.dialect, self._registry.ros2, endpoint)

    @override
    def why_not(self, topic: str, type_name: str) -> str:
        """Exclude keys that carry JSON, because a key cannot carry both CDR and JSON."""
        key = self._key(topic)
        return f"the key {key} carries JSON according to zenoh.dialects" if key in self._json_keys else ""

    @override
    def warnings(self) -> list[str]:
        if self._graph is None:
            return []
        taken = {self._key(e.topic) for e in self._graph.endpoints()} & self._json_keys
        return self._graph.warnings() + [
            f"{key}: a ros2dds bridge uses this key, which zenoh.dialects assigns to JSON; rename one of the two"
            for key in sorted(taken)
        ]

    def _key(self, topic: str) -> str:
        return self._prefix + topic[1:]

    @override
    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> KeySubscription:
        """Subscribe to a key, and announce the QoS of its publishers."""
        graph, announcer = self._graph, self._announcer
        assert graph is not None
        assert announcer is not None
        key = self._key(topic)
        announced = [token.qos for token in graph.publishers(key).values() if token.type == side_type.name]
        our_qos = combined_qos(announced) if announced else Qos()
        announcement = self._announcement(Kind.SUBSCRIPTION, key, side_type, our_qos)

        def source_of(sample: zenoh.Sample) -> str:
            return self._source_of(graph, key, side_type, sample)

        if qos.latched:
            static = side_type.name == TF_TYPE

            def depth(source: str) -> int:
                token = None if static else graph.publishers(key).get(source)
                return qos.depth if static else 1 if token is None else token.qos.depth

            wanted = qos.depth if static else _announced_depth(graph, key)
            part = LatchedSubscription(self.context, key, qos, deliver, source_of, announcement, depth, wanted)
            # publishers announced while the subscription was created did not update its depth
            return self.register(part, lambda: part.ask_for(_announced_depth(graph, key)))
        return self.register(KeySubscription(self.context, key, qos, deliver, source_of, announcement))

    def _source_of(self, graph: Ros2ddsGraph, key: str, side_type: SideType, sample: zenoh.Sample) -> str:
        """Return the endpoint that published a sample.

        A bridge's time stamps have the id of the bridge's session; a plain program's time stamps have the id of the
        program or of a router. A sample of an unknown publisher is attributed to the key's first publisher of the type.
        """
        publisher, token = graph.publisher_of(key, sample)
        if token is not None:
            return publisher if token.type == side_type.name else ""
        if key in self._plain:
            return endpoint_id(PLAIN, key)
        if publisher:
            return publisher  # its token for this key has not arrived yet
        return next((id_ for id_, t in graph.publishers(key).items() if t.type == side_type.name), "")

    @override
    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> Ros2ddsPublisher:
        key = self._key(topic)
        announcement = self._announcement(Kind.PUBLISHER, key, side_type, qos)
        return self.register(Ros2ddsPublisher(self.context, key, qos, self._heartbeats, announcement))

    def _announcement(self, kind: Kind, key: str, side_type: SideType, qos: Qos) -> Announcement:
        assert self._announcer is not None
        return Announcement(partial(self._announcer.announce, kind, key, side_type, qos))

    @override
    def caller(self, name: str, side_type: SideType) -> KeyCaller:
        """Return a client of a key; each request has an id, like the requests of the plugin's clients."""
        key = self._key(name)
        client = secrets.token_bytes(8)

        def request_id(number: int) -> bytes:
            return _REQUEST_ID + client + number.to_bytes(8, "little") + b"\1"

        announcement = self._announcement(Kind.CLIENT, key, side_type, Qos())
        return self.register(KeyCaller(self.context, key, name, announcement, request_id))

    @override
    def serve(self, name: str, side_type: SideType, call: Call) -> KeyServer:
        """Serve a key, and announce it to the bridges.

        A bridge ignores zenoh's error reply, because DDS has none, and its client keeps waiting. Clients of an action
        get a rejecting response instead, if the type of the response allows it.
        """
        key = self._key(name)
        request, _ = self._registry.service_schemas(side_type.name, side_type.type_id)
        nothing = None if request.root.fields else _EMPTY
        refuse = refusal(self._registry, side_type.name, side_type.type_id)

        def ask(data: bytes, done: Done) -> Abandon:
            if refuse is None:
                return call(data, done)
            return call(data, lambda result: done(refuse() if isinstance(result, CallError) else result))

        announcement = self._announcement(Kind.SERVER, key, side_type, Qos())
        return self.register(KeyServer(self.context, key, name, ask, announcement, nothing))


def _announced_depth(graph: Ros2ddsGraph, key: str) -> int:
    return max((token.qos.depth for token in graph.publishers(key).values()), default=1)
