"""The edge of the ros1 dialect: the keys of zenoh-plugin-ros1; see `ros1_discovery`.

Samples do not identify their publisher, so all native bridges of one key count as one publisher. Latching is not
announced, so the configuration's ``latched`` lists the topics whose last message the hub retains. ROS 1 actions are
bridged as topics.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import zenoh
from typing_extensions import override

from bridge.adapters.ros1 import names
from bridge.adapters.zenoh.edge import KeyEdge, configured
from bridge.adapters.zenoh.ros1_discovery import Aloha, AnnouncedTopic, data_key
from bridge.adapters.zenoh.services import KeyCaller, KeyServer
from bridge.adapters.zenoh.topics import Announcement, KeyContext, KeyPublisher, KeySubscription
from bridge.config.model import Config
from bridge.config.sections.zenoh import Dialect
from bridge.hub.endpoints.calls import Call
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.actions import split
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, ServiceConversion, SideType
from bridge.routing.edge import Deliver, Endpoint, Kind, MadeBy
from bridge.routing.rules import glob_regex

_NODE = "zenoh-bridge-ros1"
_SERVICES = (Kind.SERVER, Kind.CLIENT)
_MAX_ERROR = 4096


class Ros1KeysEdge(KeyEdge):
    """Joins the bridges of the ros1 dialect."""

    side: ClassVar[str] = "zenoh_ros1"
    services: ClassVar[bool] = True

    def __init__(self, config: Config, dialect: Dialect, registry: Registry, state: Path) -> None:
        self._namespace = dialect.namespace or "*"
        super().__init__(config, dialect, registry, state, self._namespace)
        self._latched = [glob_regex(glob) for glob in dialect.latched]
        self._names = names.NameTable()
        self._aloha: Aloha | None = None

    @override
    def on_open(self, session: zenoh.Session) -> None:
        self._aloha = Aloha(session, self._namespace, self._graph_changed, self._on_new_bridge)

    @override
    def on_close(self) -> None:
        if self._aloha is not None:
            self._aloha.close()

    @override
    def tick(self, now: float) -> None:
        if self._aloha is not None:
            self._aloha.tick(now)
        for publisher in self._publishers():
            publisher.tick(now)

    def _publishers(self) -> list[Ros1KeyPublisher]:
        with self._lock:
            return [part for part in self._endpoints if isinstance(part, Ros1KeyPublisher)]

    def _on_new_bridge(self, topic: str, first: bool) -> None:
        for publisher in self._publishers():
            if publisher.topic == topic:
                publisher.on_new_bridge(first=first)

    @override
    def endpoints(self) -> Sequence[Endpoint]:
        announced = [] if self._aloha is None else self._aloha.topics()

        def plain(topic: str, known: SideType) -> Endpoint:
            return self._endpoint(Kind.PUBLISHER, AnnouncedTopic(topic, known.name, known.type_id))

        endpoints = [self._endpoint(kind, topic) for kind, topic in announced]
        endpoints += configured(self.dialect, lambda ros2_name: self._registry.hub_to_ros1(ros2_name).target, plain)
        with self._lock:
            self._names.learn(e.topic for e in endpoints)
        return list({(e.kind, e.id): e for e in endpoints}.values())

    def _endpoint(self, kind: Kind, topic: AnnouncedTopic) -> Endpoint:
        if topic.md5 == "*":  # the bridge accepts any definition, so use this machine's
            with contextlib.suppress(MessageTypeError):
                topic = replace(topic, md5=self._md5(kind, topic.type))
        latched = kind is Kind.PUBLISHER and any(glob.fullmatch(topic.name) for glob in self._latched)
        qos = LATCHED if latched else Qos()
        key = data_key(topic, self._namespace)
        return Endpoint(key, kind, topic.name, topic.type, qos, MadeBy.NATIVE, _NODE, topic.md5)

    def _md5(self, kind: Kind, type_name: str) -> str:
        if kind in _SERVICES:
            return self._registry.service_ros1_to_hub(type_name).side.type_id
        return self._registry.ros1(type_name).type_id

    @override
    def why_not(self, topic: str, type_name: str) -> str:
        """Exclude the parts of ROS 2 actions, because ROS 1 has no such services and topics."""
        action = split(topic)[1] and ("/action/" in type_name or type_name.startswith("action_msgs/"))
        return "ROS 2 actions are not bridged to the ros1 dialect" if action else ""

    @override
    def warnings(self) -> list[str]:
        return [] if self._aloha is None else self._aloha.warnings()

    @override
    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """Return the conversion to the hub; the type must be known here, because keys have no definition."""
        return self._registry.ros1_to_hub(endpoint.type, endpoint.type_id)

    @override
    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        return self._registry.hub_to_ros1(type_name, type_hash)

    @override
    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        """Return a server's conversion; a reply with an error text becomes an error."""
        known = self._registry.service_ros1_to_hub(endpoint.type, endpoint.type_id)
        return replace(known, response_to_hub=_with_error_texts(known.response_to_hub))

    @override
    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        return self._registry.service_hub_to_ros1(type_name, type_hash)

    @override
    def side_name(self, hub_name: str) -> str:
        return self._names.side_name(hub_name)

    @override
    def hub_name(self, side_name: str) -> str:
        return names.hub_name(side_name)

    @override
    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> KeySubscription:
        """Subscribe to a topic's key; the namespace ``*`` matches all bridges."""
        key, announcement = self._announcement(Kind.SUBSCRIPTION, topic, side_type)
        return self.register(KeySubscription(self.context, key, qos, deliver, lambda _sample: key, announcement))

    @override
    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> Ros1KeyPublisher:
        key, announcement = self._announcement(Kind.PUBLISHER, topic, side_type)
        return self.register(Ros1KeyPublisher(self.context, topic, key, qos, announcement))

    @override
    def caller(self, name: str, side_type: SideType) -> KeyCaller:
        key, announcement = self._announcement(Kind.CLIENT, name, side_type)
        return self.register(KeyCaller(self.context, key, name, announcement))

    @override
    def serve(self, name: str, side_type: SideType, call: Call) -> KeyServer:
        """Serve a service's key for clients of any namespace, and announce it to the bridges."""
        key, announcement = self._announcement(Kind.SERVER, name, side_type)
        any_namespace = data_key(AnnouncedTopic(name, side_type.name, side_type.type_id), "*")
        return self.register(KeyServer(self.context, key, name, call, announcement, nothing=b"", asked=any_namespace))

    def _announcement(self, kind: Kind, name: str, side_type: SideType) -> tuple[str, Announcement]:
        assert self._aloha is not None
        topic = AnnouncedTopic(name, side_type.name, side_type.type_id)
        return data_key(topic, self._namespace), Announcement(partial(self._aloha.announce, kind, topic))


def _with_error_texts(convert: Callable[[bytes], bytes] | None) -> Callable[[bytes], bytes] | None:
    if convert is None:
        return None

    def converted(reply: bytes) -> bytes:
        try:
            return convert(reply)
        except ConversionError:
            text = reply[:_MAX_ERROR].decode(errors="replace")
            if not text or not text.isprintable():
                raise
            raise ConversionError(f"the server failed: {text}") from None

    return converted


AGAIN = 3.0
"""Minimum seconds between two republications of latched messages for further bridges."""

SETTLE = 0.5
"""Seconds within which a bridge both subscribes and announces the subscription, in either order."""


class Ros1KeyPublisher(KeyPublisher):
    """A publisher of a hub topic in the ros1 dialect.

    The dialect has no latching: bridges use plain zenoh subscribers and do not query earlier messages. Therefore
    latched messages are published again when the key gets its first subscriber, and when another bridge announces a
    subscription; earlier subscribers then receive them again. A plain ``get`` on the key returns them, too.
    """

    def __init__(self, context: KeyContext, topic: str, key: str, qos: Qos, announcement: Announcement) -> None:
        super().__init__(context, key, qos, announcement)
        self.topic = topic
        self._due: float | None = None
        self._last = self._since = -AGAIN
        if qos.latched:
            self.watch(self._on_first_subscriber)

    def _on_first_subscriber(self) -> None:
        self._due = self._since = time.monotonic()

    def on_new_bridge(self, *, first: bool) -> None:
        """Schedule the latched messages for a bridge that announces a subscription, the topic's ``first`` or not."""
        now = time.monotonic()
        if not self._qos.latched or self._due is not None:
            return
        if first and now - self._since < SETTLE:
            return  # the key's first subscriber has received them; a later announcement may come from another bridge
        self._due = max(now + SETTLE, self._last + AGAIN)

    def tick(self, now: float) -> None:
        """Publish the latched messages again when they are due."""
        due = self._due
        if due is not None and now >= due:
            self._due, self._last = None, now
            self.republish()
