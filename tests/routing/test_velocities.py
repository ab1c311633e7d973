"""A side announces on the hub which velocities its own nodes subscribe to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from bridge.config.sections.routing import RoutingSection
from bridge.hub.session import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.registry import Registry
from bridge.routing.edge import MadeBy
from bridge.routing.engine import Engine
from tests.peers.fake import FakeEdge, FakeNetwork, Reader
from tests.peers.hub.network import HubNetwork
from tests.support.wait import until

TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"


class Side:
    """A side on a hub, and another program there."""

    def __init__(self, hubs: HubNetwork) -> None:
        self.network = FakeNetwork()
        self.hub, self.far = Hub.open(hubs.settings("side")), Hub.open(hubs.settings("far"))
        self.engine = Engine(FakeEdge(self.network, Registry()), self.hub, RoutingSection(), "side", pytest.fail)

    def rules(self, *rules: dict[str, Any]) -> None:
        self.engine.reload(RoutingSection.model_validate({"rules": rules}))

    def base(self, topic: str, type_name: str, made_by: MadeBy = MadeBy.NATIVE) -> Reader:
        return self.network.read_from(topic, type_name, Qos(), made_by, "/base", lambda *_: None)

    def announced(self, *velocities: tuple[str, str]) -> Callable[[], bool]:
        """Return a function that returns whether exactly these are announced."""
        expected = sorted((self.hub.zid, *velocity) for velocity in velocities)
        return lambda: self.far.graph.velocities() == expected

    def close(self) -> None:
        self.engine.stop()
        self.hub.close()
        self.far.close()


@pytest.fixture
def side() -> Iterator[Side]:
    with HubNetwork() as hubs:
        side_ = Side(hubs)
        side_.engine.start()
        yield side_
        side_.close()


def test_velocities_that_the_nodes_of_a_side_subscribe_to_are_announced(side: Side) -> None:
    side.base("/foreign/cmd_vel", TWIST, MadeBy.MIDSPAN)
    side.base("/odom", "nav_msgs/msg/Odometry")
    stamped = side.base("/cmd_vel", STAMPED)
    until(side.announced(("/cmd_vel", STAMPED)), "the subscription is announced")
    plain = side.base("/cmd_vel", TWIST)
    until(side.announced(("/cmd_vel", STAMPED), ("/cmd_vel", TWIST)), "both types are announced")
    side.network.remove(stamped)
    until(side.announced(("/cmd_vel", TWIST)), "one type is announced")
    side.network.remove(plain)
    until(side.announced(), "nothing is announced")


def test_announced_velocities_follow_the_rules(side: Side) -> None:
    side.base("/base/cmd_vel", STAMPED)
    until(side.announced(("/base/cmd_vel", STAMPED)), "the topic is announced")
    side.rules({"topic": "/cmd_vel", "rename": "/base/cmd_vel"})
    until(side.announced(("/base/cmd_vel", STAMPED), ("/cmd_vel", STAMPED)), "the renamed topic is announced too")
    side.rules({"topic": "/base/cmd_vel", "deny": True})
    until(side.announced(), "a denied topic is not announced")
    side.rules({"topic": "/base/cmd_vel", "type": TWIST, "deny": True})
    until(side.announced(("/base/cmd_vel", STAMPED)), "only the other type is denied")


def test_announced_velocities_end_with_the_network_of_the_side(side: Side) -> None:
    side.base("/cmd_vel", STAMPED)
    until(side.announced(("/cmd_vel", STAMPED)), "the subscription is announced")
    side.network.restart(None)
    until(side.announced(), "nothing is announced without a network")
    side.network.restart("fake-2")
    side.base("/cmd_vel", TWIST)
    until(side.announced(("/cmd_vel", TWIST)), "the new network's subscription is announced")
