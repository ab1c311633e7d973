"""A latched message of a publisher that may not pass yet is kept until it may; streams are not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import pytest
import zenoh

from bridge.hub.graph import HubEndpoint
from bridge.hub.liveliness import EndpointKind
from bridge.hub.qos import Durability, Qos, Reliability
from bridge.hub.session import Hub
from bridge.hub.subscription import HubSample
from bridge.messages.conversion import Conversion
from bridge.messages.registry import Registry
from bridge.routing.age import Pulse
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.joint import Joint
from bridge.routing.lease import Lease
from bridge.routing.outroute import OutRoute
from bridge.routing.route import RouteKey
from bridge.routing.rules import Decision
from tests.support.fake import FakeEdge, FakeNetwork
from tests.support.hub import HubNetwork

STRING = "std_msgs/msg/String"
GID = b"g" * 16


def line(text: str) -> bytes:
    return b"\0\1\0\0" + (len(text) + 1).to_bytes(4, "little") + text.encode() + b"\0"


@pytest.mark.parametrize("latched", [True, False])
@pytest.mark.parametrize("standby", [True, False])
def test_what_comes_before_its_publisher_may_pass(latched: bool, standby: bool) -> None:
    registry, network = Registry(), FakeNetwork()
    type_ = registry.ros2(STRING)
    durability = Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE
    qos = Qos(Reliability.RELIABLE, durability, depth=1)
    endpoint = HubEndpoint(
        "z", "n", "/", EndpointKind.PUBLISHER, "/state", STRING, type_.type_id, qos, GID, None, pending=False, own=False
    )
    native = replace(endpoint, zid="y", gid=b"n" * 16)
    with HubNetwork() as hubs, Hub.open(hubs.settings("waiting")) as hub:
        idle, lease = Dispatcher("idle"), Lease()
        lease.extend(-math.inf if standby else math.inf)
        joint = Joint(hub, FakeEdge(network, registry), Pulse(), lease, cast("Any", None), idle, idle, lambda: None)
        decision = Decision(allowed=True, why="", name="/state")
        route = OutRoute(
            RouteKey("/state", STRING, type_.type_id), "/state", None, Conversion(type_, type_, None), decision, joint
        )
        route.update(*([native, endpoint], []) if standby else ([native], [], [endpoint]))
        for number, text in enumerate(("old", "new"), 1):
            route._handle(HubSample(zenoh.ZBytes(line(text)), number, number, GID, "z"))
        assert route.counters.messages == 0
        lease.extend(math.inf)
        route.update([native, endpoint], [])
        assert route.counters.messages == (1 if latched else 0)
        retained = [p for writer in network._writers for p in writer.retained.values()]
        assert retained == ([line("new")] if latched else [])
        route.update([native, endpoint], [])
        assert route.counters.messages == (1 if latched else 0), "given once"
        route.close()
