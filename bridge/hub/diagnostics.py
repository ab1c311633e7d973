"""``/diagnostics`` on the hub, for rqt_robot_monitor and the Foxglove app: names, and whether there are subscribers."""

from __future__ import annotations

from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.graph import HubGraph
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry

TOPIC = "/diagnostics"
TYPE = "diagnostic_msgs/msg/DiagnosticArray"
DIAGNOSTICS_WANTED = "/_midspan/diagnostics"
"""A side's worker subscribes to this topic while a program on its side subscribes to `TOPIC`.

The route's own subscription on the hub does not show that, because it exists even without subscribers on the side.
"""


def announce(hub: Hub, registry: Registry) -> HubPublisher:
    """Advertise `TOPIC` on the hub, so that tools list it even while no status is published."""
    return hub.publisher(TOPIC, TYPE, registry.ros2(TYPE).type_id, Qos(depth=10))


def has_subscribers(graph: HubGraph) -> bool:
    """Return whether `TOPIC` has a subscriber on the hub or on any side."""
    ends = graph.subscriptions(TOPIC)
    return any(each.origin is None and not each.pending for each in ends) or bool(
        graph.subscriptions(DIAGNOSTICS_WANTED)
    )
