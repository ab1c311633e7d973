"""The state of Midspan's parts on the hub, as rqt_robot_monitor and the Foxglove app show it: names, and who hears."""

from __future__ import annotations

from bridge.hub.endpoints.publisher import HubPublisher
from bridge.hub.graph import HubGraph
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry

TOPIC = "/diagnostics"
TYPE = "diagnostic_msgs/msg/DiagnosticArray"
HEARD = "/_midspan/diagnostics"
"""Under this name a side's worker subscribes while a program of its side hears `TOPIC`: who tells need not ask for it.

The routes of a topic subscribe on the hub whether or not anybody on their side listens.
"""


def announce(hub: Hub, registry: Registry) -> HubPublisher:
    """Have `TOPIC` on the hub, where those find it who choose of a list; nobody need tell by it."""
    return hub.publisher(TOPIC, TYPE, registry.ros2(TYPE).type_id, Qos(depth=10))


def heard(graph: HubGraph) -> bool:
    """Whether a native program of the hub hears `TOPIC`, or one of a side."""
    ends = graph.subscriptions(TOPIC)
    return any(each.origin is None and not each.pending for each in ends) or bool(graph.subscriptions(HEARD))
