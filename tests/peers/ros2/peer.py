"""A real rclpy program that a test controls with JSON lines; see `tests.peers.peer`. It does not use Midspan."""
# ruff: noqa: A002  # parameters are named as in the commands

from __future__ import annotations

import contextlib
import importlib
import signal
import sys
import threading
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
import rclpy.utilities
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.peers.commands import Commands, Record, only_answers, serve
from tests.peers.ros2.calls import Acting, Calling, Goal, Serving, depths, type_class


def message_class(name: str) -> Any:
    """Return the class of a type ``package/Name``."""
    package, _, short = name.rpartition("/")
    return getattr(importlib.import_module(f"{package.partition('/')[0]}.msg"), short)


def to_plain(value: Any) -> Any:
    """Return a message, or a part of one, as JSON values."""
    if hasattr(value, "get_fields_and_field_types"):
        return {field: to_plain(getattr(value, field)) for field in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if isinstance(value, (list, tuple, array)) or getattr(value, "ndim", None):
        return [to_plain(item) for item in value]
    return value.item() if hasattr(value, "item") else value


def fill(message: Any, fields: dict[str, Any]) -> Any:
    """Set the fields of a message from JSON; fields that are not named keep their defaults."""
    types = message.get_fields_and_field_types()
    for field, value in fields.items():
        setattr(message, field, converted(types[field], value))
    return message


def converted(kind: str, value: Any) -> Any:
    """Return a field's value in the ROS 2 type ``kind``, spelled as in ``get_fields_and_field_types``."""
    if kind.startswith("sequence<"):
        return [converted(kind[9:-1].split(",")[0].strip(), item) for item in value]
    if kind.endswith("]"):
        return [converted(kind.rpartition("[")[0], item) for item in value]
    if kind == "octet":
        return bytes([value])
    return fill(message_class(kind)(), value) if "/" in kind else value


class Publisher:
    """A publisher of messages of one type."""

    def __init__(self, node: Any, topic: str, type_: Any, profile: Any) -> None:
        self._node, self.type = node, type_
        self.handle = node.create_publisher(type_, topic, profile)

    def drop(self) -> None:
        self._node.destroy_publisher(self.handle)


class Subscription(Record):
    """A subscription that stores all messages."""

    def __init__(self, node: Any, topic: str, type_: Any, profile: Any) -> None:
        super().__init__(to_plain)
        self._node = node
        self._handle = node.create_subscription(type_, topic, self.add, profile)

    def drop(self) -> None:
        self._node.destroy_subscription(self._handle)


class Peer(Commands):
    """The node, and the commands that use it."""

    def __init__(self, node: Any) -> None:
        super().__init__()
        self.node = node
        self._clients: dict[tuple[str, str], Any] = {}
        self._action_clients: dict[tuple[str, str], Any] = {}

    def profile(self, params: dict[str, Any]) -> Any:
        """Return the QoS profile for a command."""
        return qos(params)

    def advertise(self, topic: str, type: str, **params: Any) -> dict[str, Any]:
        return self.add(Publisher(self.node, topic, message_class(type), self.profile(params)))

    def subscribe(self, topic: str, type: str, **params: Any) -> dict[str, Any]:
        return self.add(Subscription(self.node, topic, message_class(type), self.profile(params)))

    def publish(self, id: int, message: dict[str, Any], times: int = 1) -> dict[str, Any]:
        publisher = self.parts[id]
        filled = fill(publisher.type(), message)
        for _ in range(times):
            publisher.handle.publish(filled)
        return {}

    def publish_raw(self, id: int, hex: str, zeros: int = 0) -> dict[str, Any]:
        """Publish bytes instead of a message: ``hex``, then ``zeros`` zero bytes."""
        self.parts[id].handle.publish(bytes.fromhex(hex) + bytes(zeros))
        return {}

    def serve(self, **params: Any) -> dict[str, Any]:
        return self.add(Serving(self.node, params, qos(params), fill, to_plain))

    def call(
        self, service: str, type: str, request: Any = None, requests: Any = None, seconds: float = 40.0, **params: Any
    ) -> dict[str, Any]:
        kind = type_class(type, "srv")
        client = self._clients.get((service, type))
        if client is None:
            client = self.node.create_client(kind, service, qos_profile=qos(params))
            self._clients[service, type] = client
        assert client.wait_for_service(seconds), f"no server of {service}"
        filled = [fill(kind.Request(), fields) for fields in requests or [request or {}]]
        return self.add(Calling(client, filled, to_plain))

    def act(self, **params: Any) -> dict[str, Any]:
        return self.add(Acting(self.node, params, qos(params), fill, to_plain))

    def send_goal(
        self, action: str, type: str, goal: Any = None, seconds: float = 40.0, **params: Any
    ) -> dict[str, Any]:
        kind = type_class(type, "action")
        client = self._action_clients.get((action, type))
        if client is None:
            parts = depths(qos(params), "goal_service", "result_service", "cancel_service", "feedback_sub")
            client = self._action_clients[action, type] = ActionClient(self.node, kind, action, **parts)
        assert client.wait_for_server(seconds), f"no server of {action}"
        return self.add(Goal(self.node, client, fill(kind.Goal(), goal or {}), to_plain))

    def ask_result(self, id: int) -> dict[str, Any]:
        self.parts[id].ask()
        return {}

    def graph(self) -> dict[str, Any]:
        topics = dict(self.node.get_topic_names_and_types())
        return {
            "topics": topics,
            "publishers": {t: [i.node_name for i in self.node.get_publishers_info_by_topic(t)] for t in topics},
            "subscriptions": {t: [i.node_name for i in self.node.get_subscriptions_info_by_topic(t)] for t in topics},
        }


def qos(params: dict[str, Any]) -> Any:
    """Return the QoS profile for a command; its default depth is enough for bursts that a busy program handles late."""
    profile: Any = QoSProfile(  # type: ignore[no-untyped-call]
        depth=params.get("depth") or (10 if params.get("latched") else 100),
        durability=DurabilityPolicy.TRANSIENT_LOCAL if params.get("latched") else DurabilityPolicy.VOLATILE,
        reliability=ReliabilityPolicy.BEST_EFFORT if params.get("best_effort") else ReliabilityPolicy.RELIABLE,
    )
    return profile


def main(make: Callable[[Any], Peer] = Peer) -> None:
    """Execute the commands from standard input until it ends."""
    answers = only_answers()  # Fast DDS writes to standard output, for example about port locks
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node: Any = rclpy.create_node(sys.argv[1] if len(sys.argv) > 1 else "peer")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spinner = threading.Thread(target=executor.spin, daemon=True)
    spinner.start()
    with contextlib.suppress(SystemExit):  # so that shared memory is released
        signal.signal(signal.SIGTERM, lambda *_: sys.exit())
        serve(make(node), answers)
    executor.shutdown(1.0)
    spinner.join(2)
    node.destroy_node()
    rclpy.utilities.try_shutdown()


if __name__ == "__main__":
    main()
