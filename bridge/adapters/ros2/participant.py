"""Our one DDS participant and node, and the endpoints that are made on it.

rclpy's own ``Node`` puts a parameter-event publisher and more on the graph and needs an executor; only its inner
module is used here, the one that rclpy's classes stand on (``rclpy.impl.implementation_singleton``, Jazzy).
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation

from bridge.adapters.ros2.qos import to_rclpy
from bridge.adapters.ros2.service_names import service_of
from bridge.hub.qos import Qos
from bridge.messages.errors import MessageTypeError

_rclpy: Any = rclpy_implementation

_DISCOVERY = "ros_discovery_info"
"""The DDS topic on which every ROS participant tells its nodes: its writers are the participants."""


@contextlib.contextmanager
def _explained(topic: str, message_class: Any) -> Iterator[None]:
    """Say what was refused: rcl speaks of incompatible types and of allocators."""
    try:
        yield
    except (_rclpy.RCLError, ValueError) as err:
        msg = f"ROS 2 does not take {topic} as {message_class.type_name}: {err}"
        raise MessageTypeError(msg, "rename it by a rule, if it does not come right by itself in a moment") from err


class Participant:
    """A node with nothing of its own on the graph; making and destroying endpoints is safe from any thread."""

    def __init__(self, name: str, domain: int) -> None:
        self._lock = threading.Lock()
        self._context = Context()
        self._context.init(args=[], initialize_logging=False, domain_id=domain)
        self._node = _rclpy.Node(name, "", self._context.handle, [], False, False)

    @property
    def pointer(self) -> int:
        """``rcl_node_t *``."""
        return int(self._node.pointer)

    def topics(self) -> list[str]:
        """Names of all ROS topics on the graph."""
        return [name for name, _types in _rclpy.rclpy_get_topic_names_and_types(self._node, False)]

    def publishers(self, topic: str) -> Sequence[Mapping[str, Any]]:
        """A ROS topic's publishers, in rclpy's words."""
        found: list[Mapping[str, Any]] = _rclpy.rclpy_get_publishers_info_by_topic(self._node, topic, False)
        return found

    def subscriptions(self, topic: str) -> Sequence[Mapping[str, Any]]:
        """A ROS topic's subscriptions, in rclpy's words."""
        found: list[Mapping[str, Any]] = _rclpy.rclpy_get_subscriptions_info_by_topic(self._node, topic, False)
        return found

    def participants(self) -> list[bytes]:
        """GIDs of one endpoint of each ROS participant, ours included."""
        return [
            bytes(info["endpoint_gid"])
            for info in _rclpy.rclpy_get_publishers_info_by_topic(self._node, _DISCOVERY, True)
        ]

    def make_node(self, name: str) -> Any:
        """Another node of this participant, with nothing of its own; ``name`` is the full one."""
        namespace, _, base = name.rpartition("/")
        with self._lock:
            return _rclpy.Node(base, namespace, self._context.handle, [], False, False)

    def make_writer(self, message_class: Any, topic: str, qos: Qos) -> Any:
        """A DDS writer; it has ``pointer``, ``rcl_publisher_t *``."""
        with self._lock, _explained(topic, message_class):
            return _rclpy.Publisher(self._node, message_class, topic, to_rclpy(qos))

    def make_reader(self, message_class: Any, topic: str, qos: Qos) -> Any:
        """A DDS reader; it has ``pointer``, ``rcl_subscription_t *``."""
        with self._lock, _explained(topic, message_class):
            return _rclpy.Subscription(self._node, message_class, topic, to_rclpy(qos))

    def service_topics(self) -> list[tuple[str, str]]:
        """All services on the graph: each one's name and its requests' DDS topic."""
        raw = _rclpy.rclpy_get_topic_names_and_types(self._node, True)
        return [(service, topic) for topic, _types in raw if (service := service_of(topic))]

    def writers(self, dds_topic: str) -> Sequence[Mapping[str, Any]]:
        """A DDS topic's writers, in rclpy's words."""
        found: list[Mapping[str, Any]] = _rclpy.rclpy_get_publishers_info_by_topic(self._node, dds_topic, True)
        return found

    def readers(self, dds_topic: str) -> Sequence[Mapping[str, Any]]:
        """A DDS topic's readers, in rclpy's words."""
        found: list[Mapping[str, Any]] = _rclpy.rclpy_get_subscriptions_info_by_topic(self._node, dds_topic, True)
        return found

    def make_client(self, service_class: Any, service: str, qos: Qos) -> Any:
        """A client; it has ``pointer``, ``rcl_client_t *``."""
        with self._lock, _explained(service, service_class):
            return _rclpy.Client(self._node, service_class, service, to_rclpy(qos))

    def make_server(self, service_class: Any, service: str, qos: Qos) -> Any:
        """A server; it has ``pointer``, ``rcl_service_t *``."""
        with self._lock, _explained(service, service_class):
            return _rclpy.Service(self._node, service_class, service, to_rclpy(qos))

    def make_guard_condition(self) -> Any:
        """A guard condition of ours."""
        return _rclpy.GuardCondition(self._context.handle)

    def make_wait_set(self, guard_conditions: int, subscriptions: int = 0, clients: int = 0, services: int = 0) -> Any:
        """A wait set with room for so many."""
        return _rclpy.WaitSet(subscriptions, guard_conditions, 0, clients, services, 0, self._context.handle)

    def destroy(self, entity: Any) -> None:
        """Give an endpoint or a guard condition back."""
        with self._lock:
            entity.destroy_when_not_in_use()

    def close(self) -> None:
        """Leave the network."""
        self.destroy(self._node)
        self._context.try_shutdown()
        self._context.destroy()
