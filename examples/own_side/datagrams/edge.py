"""The edge, which Midspan's engine calls. The engine implements rules, queues, latching, origins and counters."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from pydantic import Field
from typing_extensions import override

from bridge.concurrency import DelayedCalls
from bridge.config.model import Config
from bridge.config.sections.section import SideSection
from bridge.doctor.check import Check, Finding, fail, ok
from bridge.doctor.context import CheckContext
from bridge.hub.graph.tokens import Origin
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, SideType
from bridge.routing.edge import Deliver, Edge, EdgeListener, Endpoint, Kind, MadeBy, Sighting
from datagrams.network import BEAT, End, Node

_KINDS = {"pub": Kind.PUBLISHER, "sub": Kind.SUBSCRIPTION}

_VOLATILE = Qos(Reliability.RELIABLE, depth=10)
_LATCHED = Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, depth=1)
"""A native program retains only its last message."""


class DatagramSection(SideSection):
    """The section ``datagrams`` of the configuration."""

    group: str = Field(default="239.255.42.1:30420", pattern=r"^[\d.]+:\d+$", description="The multicast group.")
    interface: str = Field(default="127.0.0.1", description="Address of the network interface.")


class DatagramEdge(Edge):
    """Joins a network of datagrams; only topics are bridged."""

    side: ClassVar[str] = "datagrams"

    def __init__(self, config: Config, registry: Registry, _folder: Path) -> None:
        self._section: DatagramSection = getattr(config, self.side)
        self._name, self._registry = config.name, registry
        self._node: Node | None = None
        self._joined = 0.0
        self._later = DelayedCalls("datagrams-join")

    @override
    def start(self, listener: EdgeListener) -> None:
        self._listener = listener
        self._later.after(0.0, self._join)

    def _join(self) -> None:
        try:
            self._node = Node(
                self._section.group, self._section.interface, "/midspan", by=self._name, changed=self._changed
            )
        except OSError:
            self._later.after(1.0, self._join)
            return
        self._joined = time.monotonic()
        self._changed()

    @override
    def stop(self) -> None:
        self._later.close()
        if self._node is not None:
            self._node.close()

    @override
    def network(self) -> str | None:
        return None if self._node is None else f"{self._section.interface}/{self._section.group}"

    @override
    def is_own_network(self, origin: Origin) -> bool:
        return origin.side == self.side and origin.network == self.network()

    @override
    def endpoints(self) -> Sequence[Endpoint]:
        programs = [] if self._node is None else list(self._node.programs.values())
        return [
            Endpoint(
                end.id,
                _KINDS[end.kind],
                end.topic,
                end.type,
                _LATCHED if end.latched else _VOLATILE,
                MadeBy.MIDSPAN if program.by else MadeBy.NATIVE,
                program.node,
            )
            for program in programs
            for end in program.ends.values()
            if end.kind in _KINDS
        ]

    @override
    def to_hub(self, endpoint: Endpoint) -> Conversion:
        known = self._registry.ros2(endpoint.type)
        return Conversion(known, known, lambda text: self._from_text(known.name, text))

    @override
    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        known = self._registry.ros2(type_name)
        if type_hash and type_hash != known.type_id:
            raise MessageTypeError(f"{type_name}: hash {type_hash} is not {known.type_id}", "install the same version")
        return Conversion(known, known, lambda cdr: json.dumps(to_json(self._registry, type_name, cdr)).encode())

    def _from_text(self, type_name: str, text: bytes) -> bytes:
        fields = json.loads(text)
        if not isinstance(fields, dict):
            raise ConversionError(f"a {type_name} must be a JSON object")
        return from_json(self._registry, type_name, fields)

    @override
    def learn(self, type_name: str, definition: str) -> None:
        self._registry.learn_ros2(type_name, definition)

    @override
    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> _LocalEndpoint:
        # messages of publishers that are not in the graph yet are dropped
        node = self._running()

        def on_message(message: bytes, publisher: str) -> None:
            program = node.programs.get(publisher.partition(".")[0])
            end = None if program is None or program.by else program.ends.get(publisher.partition("@")[0])
            if end is not None and end.type == side_type.name:
                deliver(message, publisher, None)

        return _LocalEndpoint(node, node.open("sub", topic, side_type.name, latched=qos.latched, take=on_message))

    @override
    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> _LocalEndpoint:
        node = self._running()
        return _LocalEndpoint(node, node.open("pub", topic, side_type.name, latched=qos.latched))

    @override
    def announce(self, record: bytes) -> None:
        if self._node is not None:
            self._node.record = record.hex()
            self._node.hello()

    @override
    def sightings(self) -> Sequence[Sighting]:
        programs = [] if self._node is None else list(self._node.programs.values())
        return [
            Sighting(p.id, bytes.fromhex(p.record) or None, p.last_seen)
            for p in programs
            if p.by not in ("", self._name)
        ]

    @override
    def settled(self, since: float) -> bool:
        return self._node is not None and time.monotonic() > max(since, self._joined) + 3 * BEAT

    def _running(self) -> Node:
        if self._node is None:
            raise MessageTypeError("the network is not joined")
        return self._node

    def _changed(self) -> None:
        self._listener.graph_changed()
        self._listener.presence_changed()


class _LocalEndpoint:
    """A publisher or a subscription that the bridge opened: `EdgePublisher` and `EdgeSubscription`."""

    lost = dropped = 0
    has_subscribers = True

    def __init__(self, node: Node, end: End) -> None:
        self._node, self._end = node, end

    def send(self, payload: bytes, source: str) -> None:
        self._node.publish(self._end, payload, source)

    def drop_source(self, source: str) -> None:
        self._node.drop(self._end, source)

    def close(self) -> None:
        self._node.close_end(self._end)


def check_programs(context: CheckContext) -> Sequence[Finding]:
    """List the programs on the network."""
    section: DatagramSection = getattr(context.config, DatagramEdge.side)
    try:
        node = Node(section.group, section.interface, "/midspan_doctor", by="doctor")
    except OSError as err:
        return [fail(f"cannot join {section.group}: {err}", "set interface to an address of this machine")]
    time.sleep(2 * BEAT)
    names = sorted(program.node for program in node.programs.values())
    node.close()
    return [ok(f"{section.group}: {', '.join(names) or 'no programs'}")]


CHECKS = (Check("datagrams-programs", "programs on the network of datagrams", check_programs),)
