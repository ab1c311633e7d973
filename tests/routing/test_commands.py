"""A command of a publisher that is not known yet is dropped, never kept and delivered later."""

from __future__ import annotations

import math
from typing import Any, cast

import pytest
import zenoh

from bridge.adapters.base import Endpoint, Kind, MadeBy
from bridge.hub.qos import Qos
from bridge.hub.session import Hub
from bridge.hub.subscription import HubSample
from bridge.messages.conversion import Conversion, SideType
from bridge.messages.registry import Registry
from bridge.routing.age import Pulse
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.inroute import InRoute
from bridge.routing.joint import Joint
from bridge.routing.lease import Lease
from bridge.routing.outroute import OutRoute
from bridge.routing.route import RouteKey
from bridge.routing.rules import Decision
from tests.support.fake import FakeEdge, FakeNetwork
from tests.support.hub import HubNetwork

TWIST = "geometry_msgs/msg/Twist"


@pytest.mark.parametrize(("topic", "kept"), [("/cmd_vel", 0), ("/odom_twist", 1)])
def test_only_what_is_no_command_waits_for_its_source(topic: str, kept: int) -> None:
    registry, network = Registry(), FakeNetwork()
    type_: SideType = registry.ros2(TWIST)
    conversion, decision = Conversion(type_, type_, None), Decision(allowed=True, why="", name=topic)
    key = RouteKey(topic, TWIST, type_.type_id)
    with HubNetwork() as hubs, Hub.open(hubs.settings("commands")) as hub:
        idle = Dispatcher("idle")
        lease = Lease()
        lease.extend(math.inf)
        joint = Joint(hub, FakeEdge(network, registry), Pulse(), lease, cast("Any", None), idle, idle, lambda: None)
        inwards = InRoute(key, topic, conversion, decision, joint)
        inwards.update([Endpoint("known", Kind.PUBLISHER, topic, TWIST, Qos(), MadeBy.NATIVE)])
        inwards._deliver(b"payload", "unknown", None)
        assert (len(inwards._pending), inwards.counters.drops["unknown"]) == (kept, 1 - kept)
        inwards.close()
        outwards = OutRoute(key, topic, None, conversion, decision, joint)
        outwards.update([], [])
        outwards._handle(HubSample(zenoh.ZBytes(b"payload"), 1, 1, b"g" * 16, "nobody"))
        assert (len(outwards._pending), outwards.counters.drops["unknown"]) == (kept, 1 - kept)
        outwards.close()
