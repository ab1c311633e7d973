"""A real rclpy program like `tests.peers.ros2.peer`, whose endpoints have the QoS BEST_AVAILABLE."""

from __future__ import annotations

from typing import Any

from peer import Endpoint, Peer, main, message_class
from rclpy.qos import qos_profile_best_available


class BestAvailablePeer(Peer):
    """The program's commands; ``advertise`` and ``subscribe`` ignore the QoS that a command asks for."""

    def advertise(self, params: dict[str, Any]) -> dict[str, Any]:
        type_ = message_class(params["type"])
        return self._add(
            Endpoint(self.node.create_publisher(type_, params["topic"], qos_profile_best_available), type_)
        )

    def subscribe(self, params: dict[str, Any]) -> dict[str, Any]:
        type_ = message_class(params["type"])
        endpoint = Endpoint(None, type_)
        endpoint.handle = self.node.create_subscription(
            type_, params["topic"], endpoint.receive, qos_profile_best_available
        )
        return self._add(endpoint)


if __name__ == "__main__":
    main(BestAvailablePeer)
