"""Two daemons have a dialect on one network, on one hub or on two: nothing loops, and nothing arrives twice."""

from __future__ import annotations

import pytest

from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.adapters.zenoh.conftest import Place
from tests.contract.hubside import HubSide
from tests.peers.daemon.exchange import exchange, until_all_receive
from tests.peers.hub.quick import QuickHub

STRING = "std_msgs/String"
JSON = {"dialect": "json", "keys": [{"key": "json/both", "topic": "/both", "type": "std_msgs/msg/String"}]}


@pytest.mark.parametrize("dialect", ["ros2dds", "ros1", "json"])
@pytest.mark.parametrize("hubs", ["one hub", "two hubs"])
def test_nothing_loops_and_nothing_arrives_twice(place: Place, dialect: str, hubs: str) -> None:
    entry = JSON if dialect == "json" else {"dialect": dialect}
    program = {"ros2dds": place.ros2dds, "ros1": place.ros1, "json": place.json}[dialect]()
    topic = "/json/both" if dialect == "json" else "/both"
    subscription, out = program.subscribe(topic, STRING), program.advertise(topic, STRING)
    far = [place.far]
    with QuickHub() as other:
        first = place.bridge(entry, name="one")
        hub = {"listen": other.endpoint if hubs == "two hubs" else place.hubs.endpoint}
        second = place.bridge(entry, name="two", hub=hub, state=place.folder / "two")
        if hubs == "two hubs":
            far.append(HubSide(Hub.open(other.settings("far")), Registry()))
        try:
            from_far = exchange(program, out, subscription, far)
            if hubs == "one hub":  # the standby daemon takes over
                active = min((first, second), key=lambda bridge: bridge.bridges[0].health().state != "running")
                active.stop()
                until_all_receive(
                    program, out, subscription, [(far[0], from_far[0], far[0].subscribe("/both", STRING))]
                )
            second.stop()
        finally:
            for end in far[1:]:
                end.hub.close()
