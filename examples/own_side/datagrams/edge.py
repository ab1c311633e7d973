"""The edge: what Midspan's engine asks of a side. Rules, queues, latching, origins and counters are the engine's."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from pydantic import Field

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


class DatagramSection(SideSection):
    """The section ``datagrams`` of the configuration."""

    group: str = Field(default="239.255.42.1:30420", pattern=r"^[\d.]+:\d+$", description="The multicast group.")
    interface: str = Field(default="127.0.0.1", description="Address of the network interface.")


class DatagramEdge(Edge):
    """Joins a network of datagrams; topics alone cross."""

    side: ClassVar[str] = "datagrams"

    def __init__(self, config: Config, registry: Registry, _folder: Path) -> None:
        self._section: DatagramSection = getattr(config, self.side)
        self._name, self._registry = config.name, registry
        self._node: Node | None = None
        self._joined = 0.0
        self._later = DelayedCalls("datagrams-join")

    def start(self, listener: EdgeListener) -> None:
        """See `Edge.start`."""
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

    def stop(self) -> None:
        """See `Edge.stop`."""
        self._later.close()
        if self._node is not None:
            self._node.close()

    def network(self) -> str | None:
        """See `Edge.network`."""
        return None if self._node is None else f"{self._section.interface}/{self._section.group}"

    def is_own_network(self, origin: Origin) -> bool:
        """See `Edge.is_own_network`."""
        return origin.side == self.side and origin.network == self.network()

    def endpoints(self) -> Sequence[Endpoint]:
        """See `Edge.endpoints`."""
        programs = [] if self._node is None else list(self._node.programs.values())
        return [
            Endpoint(
                end.id,
                _KINDS[end.kind],
                end.topic,
                end.type,
                Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL if end.latched else Durability.VOLATILE, depth=10),
                MadeBy.MIDSPAN if program.by else MadeBy.NATIVE,
                program.node,
            )
            for program in programs
            for end in program.ends.values()
            if end.kind in _KINDS
        ]

    def to_hub(self, endpoint: Endpoint) -> Conversion:
        """See `Edge.to_hub`."""
        known = self._registry.ros2(endpoint.type)
        return Conversion(known, known, lambda text: self._from_text(known.name, text))

    def from_hub(self, type_name: str, type_hash: str) -> Conversion:
        """See `Edge.from_hub`."""
        known = self._registry.ros2(type_name)
        if type_hash and type_hash != known.type_id:
            raise MessageTypeError(f"{type_name}: hash {type_hash} is not {known.type_id}", "install the same version")
        return Conversion(known, known, lambda cdr: json.dumps(to_json(self._registry, type_name, cdr)).encode())

    def _from_text(self, type_name: str, text: bytes) -> bytes:
        fields = json.loads(text)
        if not isinstance(fields, dict):
            raise ConversionError(f"a {type_name} is an object with its fields")
        return from_json(self._registry, type_name, fields)

    def learn(self, type_name: str, definition: str) -> None:
        """See `Edge.learn`."""
        self._registry.learn_ros2(type_name, definition)

    def subscribe(self, topic: str, side_type: SideType, qos: Qos, deliver: Deliver) -> _OwnEnd:
        """See `Edge.subscribe`: while nobody knows who published a message, it does not cross."""
        node = self._running()

        def take(message: bytes, publisher: str) -> None:
            program = node.programs.get(publisher.partition(".")[0])
            end = None if program is None or program.by else program.ends.get(publisher)
            if end is not None and end.type == side_type.name:
                deliver(message, publisher, None)

        return _OwnEnd(node, node.open("sub", topic, side_type.name, latched=qos.latched, take=take))

    def advertise(self, topic: str, side_type: SideType, qos: Qos) -> _OwnEnd:
        """See `Edge.advertise`."""
        node = self._running()
        return _OwnEnd(node, node.open("pub", topic, side_type.name, latched=qos.latched))

    def announce(self, record: bytes) -> None:
        """See `Edge.announce`."""
        if self._node is not None:
            self._node.record = record.hex()
            self._node.hello()

    def sightings(self) -> Sequence[Sighting]:
        """See `Edge.sightings`."""
        programs = [] if self._node is None else list(self._node.programs.values())
        return [
            Sighting(p.id, bytes.fromhex(p.record) or None, p.heard) for p in programs if p.by not in ("", self._name)
        ]

    def settled(self, since: float) -> bool:
        """See `Edge.settled`."""
        return self._node is not None and time.monotonic() > max(since, self._joined) + 3 * BEAT

    def _running(self) -> Node:
        if self._node is None:
            raise MessageTypeError("the network is away")
        return self._node

    def _changed(self) -> None:
        self._listener.graph_changed()
        self._listener.presence_changed()


class _OwnEnd:
    """A publisher or a subscription of ours; see `EdgePublisher` and `EdgeSubscription`."""

    lost = dropped = 0
    heard = True

    def __init__(self, node: Node, end: End) -> None:
        self._node, self._end = node, end

    def send(self, payload: bytes, source: str) -> None:
        self._node.publish(self._end, payload, source)

    def forget(self, source: str) -> None:
        self._node.forget(self._end, source)

    def close(self) -> None:
        self._node.close_end(self._end)


def look_at_programs(context: CheckContext) -> Sequence[Finding]:
    """Who is on the network?"""
    section: DatagramSection = getattr(context.config, DatagramEdge.side)
    try:
        node = Node(section.group, section.interface, "/midspan_doctor", by="doctor")
    except OSError as err:
        return [fail(f"{section.group} cannot be joined: {err}", "give the address of this machine in interface")]
    time.sleep(2 * BEAT)
    names = sorted(program.node for program in node.programs.values())
    node.close()
    return [ok(f"{section.group}: {', '.join(names) or 'nobody is there'}")]


CHECKS = (Check("datagrams-programs", "programs on the network of datagrams", look_at_programs),)
