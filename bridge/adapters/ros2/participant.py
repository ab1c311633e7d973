"""Our one DDS participant and node, and the endpoints that are made on it."""

from __future__ import annotations

import threading
from typing import Any

from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node

from bridge.adapters.ros2.qos import to_rclpy
from bridge.hub.qos import Qos


class Participant:
    """A node without executor, parameters, log topic or services; making and destroying is safe from any thread."""

    def __init__(self, name: str, domain: int) -> None:
        self._lock = threading.Lock()
        self._context = Context()
        self._context.init(args=[], initialize_logging=False, domain_id=domain)
        self.node: Any = Node(
            name,
            context=self._context,
            cli_args=[],
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )

    def make_writer(self, message_class: Any, topic: str, qos: Qos) -> Any:
        """A DDS writer."""
        events = PublisherEventCallbacks(use_default_callbacks=False)
        with self._lock:
            return self.node.create_publisher(message_class, topic, to_rclpy(qos), event_callbacks=events)

    def make_reader(self, message_class: Any, topic: str, qos: Qos) -> Any:
        """A DDS reader; its messages are taken by the loop, never by an executor."""
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        with self._lock:
            return self.node.create_subscription(
                message_class, topic, _never, to_rclpy(qos), event_callbacks=events, raw=True
            )

    def destroy_writer(self, writer: Any) -> None:
        """Give a writer back."""
        with self._lock:
            self.node.destroy_publisher(writer)

    def destroy_reader(self, reader: Any) -> None:
        """Give a reader back."""
        with self._lock:
            self.node.destroy_subscription(reader)

    def close(self) -> None:
        """Leave the network."""
        with self._lock:
            self.node.destroy_node()
        self._context.try_shutdown()
        self._context.destroy()


def _never(_message: bytes) -> None:
    msg = "no executor runs on this node"
    raise AssertionError(msg)
