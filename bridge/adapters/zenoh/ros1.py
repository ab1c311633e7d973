"""The edge of the ros1 dialect: keys as zenoh-plugin-ros1 makes them; see `ros1_keys` and `ros1_aloha`.

Samples tell nothing of who put them there, so all native bridges of one key are one publisher. Whether a ROS 1
publisher latches is not told: for topics that usually are latched, the configuration's ``latched`` has the hub keep
the last message. Actions of ROS 1 are topics, and cross as such.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
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
from bridge.adapters.ros1 import names
from bridge.adapters.zenoh.announcement import Announcement
from bridge.adapters.zenoh.edge import KeyEdge, configured
from bridge.adapters.zenoh.key_caller import KeyCaller
from bridge.adapters.zenoh.key_server import KeyServer
from bridge.adapters.zenoh.ros1_aloha import Aloha
from bridge.adapters.zenoh.ros1_keys import Topic, data_key
from bridge.adapters.zenoh.ros1_publisher import Ros1KeyPublisher
from bridge.adapters.zenoh.subscription import KeySubscription
from bridge.config.model import Config
from bridge.config.sections.zenoh import Dialect
from bridge.hub.call import Call
from bridge.hub.qos import Durability, Qos
from bridge.messages.conversion import Conversion, ServiceConversion, SideType
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.registry import Registry
from bridge.routing.patterns import glob_regex
from bridge.routing.subject import split

_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
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

    def opened(self, session: zenoh.Session) -> None:
        """See `KeyEdge.opened`."""
        self._aloha = Aloha(session, self._namespace, self.changed, self._newcomer)

    def closing(self) -> None:
        """See `KeyEdge.closing`."""
        if self._aloha is not None:
            self._aloha.close()

    def tick(self, now: float) -> None:
        """See `KeyEdge.tick`."""
        if self._aloha is not None:
            self._aloha.tick(now)
        for publisher in self._publishers():
            publisher.tick(now)

    def _publishers(self) -> list[Ros1KeyPublisher]:
        with self._lock:
            return [part for part in self._parts if isinstance(part, Ros1KeyPublisher)]

    def _newcomer(self, topic: str, first: bool) -> None:
        for publisher in self._publishers():
            if publisher.topic == topic:
                publisher.newcomer(first=first)

    # -- the graph -----------------------------------------------------------------------------------------------------

    def endpoints(self) -> Sequence[Endpoint]:
        """What bridges tell, and the publishers that the configuration names."""
        told = [] if self._aloha is None else self._aloha.topics()

        def plain(topic: str, known: SideType) -> Endpoint:
            return self._endpoint(Kind.PUBLISHER, Topic(topic, known.name, known.type_id))

        found = [self._endpoint(kind, topic) for kind, topic in told]
        found += configured(self.dialect, self._ros1, plain)
        with self._lock:
            self._names.learn(e.topic for e in found)
        return list({(e.kind, e.id): e for e in found}.values())

    def _ros1(self, ros2_name: str) -> SideType:
        return self.registry.hub_to_ros1(ros2_name).target

    def _endpoint(self, kind: Kind, topic: Topic) -> Endpoint:
        if topic.md5 == "*":  # told by who takes any definition: ours stands for it
            with contextlib.suppress(MessageTypeError):
                topic = replace(topic, md5=self._md5(kind, topic.type))
        latched = kind is Kind.PUBLISHER and any(glob.fullmatch(topic.name) for glob in self._latched)
        qos = _LATCHED if latched else Qos()
        key = data_key(topic, self._namespace)
        return Endpoint(key, kind, topic.name, topic.type, qos, MadeBy.NATIVE, _NODE, topic.md5)

    def _md5(self, kind: Kind, type_name: str) -> str:
        if kind in _SERVICES:
            return self.registry.service_ros1_to_hub(type_name).side.type_id
        return self.registry.ros1(type_name).type_id

    def why_not(self, topic: str, type_name: str) -> str:
        """The services and topics of a ROS 2 action are none of ROS 1."""
        action = split(topic)[1] and ("/action/" in type_name or type_name.startswith("action_msgs/"))
        return "actions of ROS 2 do not cross to the ros1 dialect" if action else ""

    def warnings(self) -> list[str]:
        """Beacons that could not be read."""
        return [] if self._aloha is None else self._aloha.warnings()

    # -- types and names -----------------------------------------------------------------------------------------------

    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """See `Edge.to_hub`; no definition comes with the key, so that the type must be known here."""
        return self.registry.ros1_to_hub(endpoint.type, endpoint.type_id)

    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """See `Edge.from_hub`."""
        return self.registry.hub_to_ros1(type_name, type_hash)

    def service_to_hub(self, endpoint: Endpoint) -> ServiceConversion:
        """See `Edge.service_to_hub`; a reply that is the text of an error is told as one."""
        known = self.registry.service_ros1_to_hub(endpoint.type, endpoint.type_id)
        return replace(known, response_to_hub=_or_failed(known.response_to_hub))

    def service_from_hub(self, type_name: str, type_hash: str) -> ServiceConversion:
        """See `Edge.service_from_hub`."""
        return self.registry.service_hub_to_ros1(type_name, type_hash)

    def side_name(self, hub_name: str) -> str:
        """The ROS 1 spelling of a hub topic name; see `bridge.adapters.ros1.names`."""
        return self._names.side_name(hub_name)

    def hub_name(self, side_name: str) -> str:
        """The hub's spelling of a ROS 1 topic name; see `bridge.adapters.ros1.names`."""
        return names.hub_name(side_name)

    # -- endpoints of ours ---------------------------------------------------------------------------------------------

    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> EdgeSubscription:
        """Hear a topic's key, whatever the bridges' namespaces where ours is ``*``."""
        assert self._aloha is not None
        name = Topic(topic, side_type.name, side_type.type_id)
        announcement = Announcement(partial(self._aloha.tell, Kind.SUBSCRIPTION, name))
        key = data_key(name, self._namespace)

        def closed(part: KeySubscription) -> None:
            announcement.withdraw()
            self.drop(part)

        part = KeySubscription(self.session, key, self.inbox(deliver, qos), lambda _sample: key, closed)
        self.keep(part)
        announcement.tell()
        return part

    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> EdgePublisher:
        """Publish on a topic's key, and tell the bridges."""
        assert self._aloha is not None
        name = Topic(topic, side_type.name, side_type.type_id)
        announcement = Announcement(partial(self._aloha.tell, Kind.PUBLISHER, name))
        key = data_key(name, self._namespace)
        publisher = Ros1KeyPublisher(self.session, topic, key, qos, announcement.withdraw, self.drop)
        self.keep(publisher)
        announcement.tell()
        return publisher

    def caller(self, name: str, side_type: SideType) -> EdgeCaller:
        """Call a service's key, and tell the bridges."""
        key, announcement = self._announcement(Kind.CLIENT, name, side_type)
        part = KeyCaller(self.session, key, name, self.limit, self.errands, announcement.withdraw, self.drop)
        self.keep(part)
        announcement.tell()
        return part

    def serve(self, name: str, side_type: SideType, call: Call) -> EdgeServer:
        """Serve a service's key, whatever the namespace of the bridge that asks, and tell the bridges."""
        key, announcement = self._announcement(Kind.SERVER, name, side_type)
        any_namespace = data_key(Topic(name, side_type.name, side_type.type_id), "*")
        part = KeyServer(
            self.session, key, name, self.limit, call, announcement.withdraw, self.drop, nothing=b"",
            asked=any_namespace,
        )  # fmt: skip
        self.keep(part)
        announcement.tell()
        return part

    def _announcement(self, kind: Kind, name: str, side_type: SideType) -> tuple[str, Announcement]:
        assert self._aloha is not None
        topic = Topic(name, side_type.name, side_type.type_id)
        return data_key(topic, self._namespace), Announcement(partial(self._aloha.tell, kind, topic))


def _or_failed(convert: Callable[[bytes], bytes] | None) -> Callable[[bytes], bytes] | None:
    if convert is None:
        return None

    def converted(reply: bytes) -> bytes:
        try:
            return convert(reply)
        except ConversionError:
            text = reply[:_MAX_ERROR].decode(errors="replace")
            if not text or not text.isprintable():
                raise
            msg = f"the server failed: {text}"
            raise ConversionError(msg) from None

    return converted
