"""A native program of the hub. Usage: ``python -m benchmarks.losses.hub_program NAME ROUTER DOMAIN``."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from typing import Any

from typing_extensions import override

from benchmarks.losses.program import MEGABYTE, Program
from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.node import Hub
from bridge.hub.session import HubSettings
from bridge.hub.wire.qos import Durability, Qos, Reliability
from bridge.messages.registry import Registry

CDR = b"\0\1\0\0"
POINT, TWIST, STRING, CLOCK = (
    "geometry_msgs/msg/Vector3",
    "geometry_msgs/msg/Twist",
    "std_msgs/msg/String",
    "rosgraph_msgs/msg/Clock",
)
_STREAM = Qos(Reliability.RELIABLE, Durability.VOLATILE, depth=100)


class HubProgram(Program):
    """A program that is a node on the hub, with its own zenoh session."""

    def __init__(self, name: str, router: str, domain: int) -> None:
        super().__init__(name)
        self._registry = Registry()
        settings = HubSettings(domain=domain, router=router, node=name, daemon="program", worker=name)
        self._hub = Hub.open(settings)
        self._publishers: dict[str, HubPublisher] = {}

    @override
    def open(self) -> None:
        for kind, type_ in (("stream", POINT), ("cmd_vel", TWIST), ("large", STRING)):
            self._publishers[kind] = self._publisher(f"/{self.name}/{kind}", type_, _STREAM)
        self._publishers["state"] = self._publisher("/state", STRING, _latched(1))
        self._subscribe("/state", STRING, _latched(100), lambda data: self.record_line(_text(data)))

    @override
    def publish(self, kind: str, sent: float, number: int) -> None:
        if kind == "large":
            self._publishers[kind].put(_string(MEGABYTE))
        elif kind != "clock":  # only the ROS 1 program publishes /clock
            more = 3 if kind == "cmd_vel" else 0
            self._publishers[kind].put(CDR + struct.pack(f"<{3 + more}d", sent, number, *[0.0] * (1 + more)))

    @override
    def publish_state(self, line: str) -> None:
        self._publishers["state"].put(_string(line))

    @override
    def listen(self, source: str) -> None:
        if source == "clock":
            self._follow("/clock", CLOCK, _clock)
            return
        self._follow(f"/{source}/stream", POINT, _point)
        self._follow(f"/{source}/cmd_vel", TWIST, _point)
        self._follow(f"/{source}/large", STRING, lambda _data: (0.0, 0.0))

    @override
    def late(self, take: Callable[[str], None]) -> Callable[[], None]:
        return self._subscribe("/state", STRING, _latched(100), lambda data: take(_text(data)))

    @override
    def nodes(self) -> list[str]:
        return [node.node for node in self._hub.graph.nodes()]

    @override
    def close(self) -> None:
        self._hub.close()

    def _publisher(self, topic: str, type_: str, qos: Qos) -> HubPublisher:
        return self._hub.publisher(topic, type_, self._registry.ros2(type_).type_id, qos)

    def _subscribe(self, topic: str, type_: str, qos: Qos, take: Callable[[bytes], Any]) -> Callable[[], None]:
        hash_ = self._registry.ros2(type_).type_id
        return self._hub.subscription(topic, type_, hash_, qos, lambda sample: take(sample.data())).close

    def _follow(self, topic: str, type_: str, read: Callable[[bytes], tuple[float, float]]) -> None:
        self._subscribe(topic, type_, _STREAM, lambda data: self.record_message(topic, *read(data)))


def _point(data: bytes) -> tuple[float, float]:
    x, y = struct.unpack_from("<2d", data, 4)
    return x, y


def _clock(data: bytes) -> tuple[float, float]:
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    return seconds + nanoseconds / 1e9, 0.0


def _string(text: str) -> bytes:
    return CDR + struct.pack("<I", len(text) + 1) + text.encode() + b"\0"


def _text(data: bytes) -> str:
    return data[8:-1].rstrip(b"\0").decode()


def _latched(depth: int) -> Qos:
    return Qos(Reliability.RELIABLE, Durability.TRANSIENT_LOCAL, depth=depth)


if __name__ == "__main__":
    HubProgram(sys.argv[1], sys.argv[2], int(sys.argv[3])).run(silent=False)
