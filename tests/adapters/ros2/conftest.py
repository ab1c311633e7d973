"""The edge under test, and real peers, on this process's own ROS domain."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bridge.adapters.ros2.edge import Ros2Edge
from bridge.config.model import Config
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from bridge.messages.transcode.conversion import Conversion, SideType
from bridge.routing.edge import Endpoint, Kind
from tests.peers.listener import Listener
from tests.peers.peer import Peer
from tests.peers.ros2.network import ROS2_PEER, ros2_domain, ros2_environment, ros2_python
from tests.support.wait import until


def text(payload: bytes) -> str:
    """Return the text in the CDR bytes of a std_msgs/msg/String."""
    assert payload[:4] == b"\0\1\0\0"
    length = int.from_bytes(payload[4:8], "little")
    return payload[8 : 7 + length].decode()


def string(data: str) -> bytes:
    """Return the CDR bytes of a std_msgs/msg/String."""
    encoded = data.encode()
    return b"\0\1\0\0" + (len(encoded) + 1).to_bytes(4, "little") + encoded + b"\0"


class Inbox:
    """Records what a subscription delivers: payload, source, time."""

    def __init__(self) -> None:
        self.messages: list[tuple[bytes, str, int | None]] = []

    def texts(self) -> list[str]:
        """Return the texts of the received std_msgs/msg/String, sorted."""
        return sorted(text(payload) for payload, _, _ in self.messages)

    def deliver(self, payload: bytes, source: str, time_ns: int | None) -> None:
        self.messages.append((payload, source, time_ns))


class RunningEdge(Listener):
    """A started edge with its registry, and helpers for tests."""

    def __init__(self, registry: Registry, state: Path) -> None:
        super().__init__()
        self.registry = registry
        self.edge = Ros2Edge(Config.model_validate({"ros2": {"domain": ros2_domain()}}), registry, state)
        self.edge.start(self)

    def type(self, name: str) -> SideType:
        return self.registry.ros2(name)

    def subscribe(self, topic: str, type_name: str, qos: Qos | None = None) -> Inbox:
        inbox = Inbox()
        self.edge.subscribe(topic, self.type(type_name), qos or Qos(), inbox.deliver)
        return inbox

    def conversion(self, type_name: str) -> Conversion:
        return self.edge.from_hub(type_name, self.type(type_name).type_id)

    def until_seen(self, topic: str, kind: Kind, count: int = 1) -> list[Endpoint]:
        """Return the topic's endpoints of one kind, once there are ``count`` of them, all with known nodes."""

        def listed() -> list[Endpoint] | None:
            present = [e for e in self.edge.endpoints() if e.topic == topic and e.kind is kind]
            return present if len(present) == count and all(e.node for e in present) else None

        result = until(listed, f"{count} {kind.value} on {topic}")
        assert result is not None
        return result

    def until_gone(self, topic: str, kind: Kind) -> None:
        """Wait until the topic has no endpoint of one kind."""
        until(
            lambda: not [e for e in self.edge.endpoints() if e.topic == topic and e.kind is kind],
            f"no {kind.value} on {topic}",
        )


@pytest.fixture(scope="session")
def registry() -> Registry:
    return Registry()


@pytest.fixture
def edge(registry: Registry, tmp_path: Path) -> Iterator[RunningEdge]:
    """An edge that must stop all of its threads."""
    before = set(threading.enumerate())
    running = RunningEdge(registry, tmp_path)
    yield running
    running.edge.stop()
    until(lambda: set(threading.enumerate()) <= before, "its threads have ended")
    assert not running.failures


@pytest.fixture
def peer() -> Iterator[Callable[..., Peer]]:
    """Starts real rclpy programs; keywords are environment variables."""
    peers: list[Peer] = []

    def start(name: str = "peer", **environ: str) -> Peer:
        started = Peer(ROS2_PEER, ros2_python(), ros2_environment(**environ), name)
        peers.append(started)
        return started

    yield start
    for started in peers:
        started.stop()
