"""The contract suite's far end as an rmw_zenoh node."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.hub.graph import HubEndpoint
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from tests.contract.hubside import HubSide
from tests.peers.zenoh.rmw import RmwNode


class RmwSide(HubSide):
    """Publishes and subscribes on the hub with zenoh's advanced publishers and subscribers, as rmw_zenoh does.

    A Midspan hub session without topics provides the services, the graph and the control plane.
    """

    def __init__(self, hub: Hub, registry: Registry, router: str) -> None:
        super().__init__(hub, registry)
        self.node = RmwNode(router, hub.domain, "far_rmw")

    def _publisher(self, topic: str, name: str, type_hash: str, qos: Qos) -> Any:
        return self.node.publisher(topic, name, type_hash, qos)

    def _subscription(self, topic: str, name: str, type_hash: str, qos: Qos, receive: Callable[[bytes], None]) -> Any:
        return self.node.subscription(topic, name, type_hash, qos, receive)

    def _is_own(self, endpoint: HubEndpoint) -> bool:
        return endpoint.own or endpoint.zid == self.node.zid

    def close(self) -> None:
        """Leave the hub."""
        try:
            self.node.close()
        finally:
            super().close()
