"""Hub endpoints with BEST_AVAILABLE in their tokens, which rmw_zenoh does not resolve, are bridged like any other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.wire.qos import BEST_AVAILABLE_NS, Durability, Qos, Reliability
from bridge.messages.json import from_json, to_json
from tests.contract.hubside import HubSide
from tests.contract.side import Bridge, Side
from tests.peers.hub.network import HubNetwork
from tests.peers.peer import Peer
from tests.peers.ros2.network import ros2_environment, ros2_python
from tests.support.wait import until

PROGRAM = Path(__file__).parents[1] / "peers" / "ros2" / "best_available.py"
STRING, TWIST = "std_msgs/msg/String", "geometry_msgs/msg/Twist"
OPEN = Qos(Reliability.BEST_AVAILABLE, Durability.BEST_AVAILABLE, deadline_ns=BEST_AVAILABLE_NS)


def publisher(far: HubSide, topic: str, type_name: str = STRING, qos: Qos = OPEN) -> Callable[[dict[str, Any]], None]:
    """Create a hub publisher, and return a function that publishes one message with it."""
    endpoint = far.hub.publisher(topic, type_name, far.registry.ros2(type_name).type_id, qos)
    return lambda message: endpoint.put(from_json(far.registry, type_name, message))


def test_a_best_available_publisher_of_the_hub_reaches_the_side(side: Side, bridge: Bridge, far: HubSide) -> None:
    publish = publisher(far, "/open")
    peer = side.peer()
    received = peer.subscribe("/open", "std_msgs/String")

    def crossed() -> bool:
        publish({"data": "best"})
        return bool(peer.wait(received, 1, 0.2))

    until(crossed, "a message crosses", 20)
    decisions = lambda: [line["decision"] for line in far.explain("/open") if line["direction"] == "out"]  # noqa: E731
    until(lambda: decisions() == ["bridged"], "explain reports it", 20)


def test_a_best_available_subscription_of_the_hub_receives_from_the_side(
    side: Side, bridge: Bridge, far: HubSide
) -> None:
    received: list[str] = []
    far.hub.subscription(
        "/open_in", STRING, far.registry.ros2(STRING).type_id, OPEN,
        lambda sample: received.append(to_json(far.registry, STRING, sample.data())["data"]),
    )  # fmt: skip
    peer = side.peer()
    out = peer.advertise("/open_in", "std_msgs/String")
    far.publish_until(peer, out, {"data": "best"}, lambda: "best" in received)


def test_the_side_keeps_the_last_message(side: Side, bridge: Bridge, far: HubSide) -> None:
    """A DDS publisher with BEST_AVAILABLE is transient local, so its messages are retained, too."""
    if not side.tells_latching:
        pytest.skip("this side does not show which topics are latched")
    publish = publisher(far, "/open_state")
    first = side.peer()
    received = first.subscribe("/open_state", "std_msgs/String", latched=True, depth=10)

    def crossed() -> bool:
        publish({"data": "kept"})
        return bool(first.wait(received, 1, 0.2))

    until(crossed, "a message crosses", 20)
    late = side.peer()
    assert late.wait(late.subscribe("/open_state", "std_msgs/String", latched=True, depth=10), 1, 15)


@pytest.mark.parametrize("topic", ["/cmd_vel", "/teleop"])
def test_a_velocity_is_never_latched(side: Side, bridge: Bridge, far: HubSide, topic: str) -> None:
    publish = publisher(far, topic, TWIST)
    peer = side.peer()
    received = peer.subscribe(topic, "geometry_msgs/Twist")

    def crossed() -> bool:
        publish({"linear": {"x": 0.2}})
        return bool(peer.wait(received, 1, 0.2))

    until(crossed, "a command crosses", 20)
    assert "volatile" in far.until_route(topic, "out")["qos"]
    late = side.peer()
    out = publisher(far, "/probe")
    at_late = late.subscribe(topic, "geometry_msgs/Twist", latched=side.tells_latching)
    probe = late.subscribe("/probe", "std_msgs/String")

    def probed() -> bool:
        out({"data": "probe"})
        return bool(late.wait(probe, 1, 0.2))

    until(probed, "the late program is connected", 20)
    assert late.wait(at_late, 1, 0.2) == []


def test_endpoints_with_undefined_policies_are_bridged(
    side: Side, bridge: Bridge, far: HubSide, hubs: HubNetwork
) -> None:
    type_id = far.registry.ros2(STRING).type_id
    with hubs.program() as session:
        zid = session.zid()
        key = f"@ros2_lv/{far.hub.domain}/{zid}/0/1/MP/%/%/stranger/%strange/std_msgs::msg::dds_::String_/{type_id}"
        token = session.liveliness().declare_token(f"{key}/9:8:7,10:,:,:6,,")
        far.until_route("/strange", "out")
        # while programs are being discovered, a side may warn of them
        until(lambda: far.status()["warnings"] == [], "nothing is reported", 20)
        token.undeclare()


@pytest.mark.parametrize("side", ["ros2"], indirect=True)
def test_rclpy_programs_with_best_available_exchange_messages(side: Side, bridge: Bridge, far: HubSide) -> None:
    """Fast DDS resolves the policies when an endpoint is created; the graph then shows the result."""
    peer = Peer(PROGRAM, ros2_python(), ros2_environment(), "best_available")
    try:
        out = peer.advertise("/dds_open", "std_msgs/String")
        received = far.subscribe("/dds_open", "std_msgs/String")
        far.publish_until(peer, out, {"data": "from DDS"}, lambda: far.wait(received, 1, 0.2))
        assert [p.qos.latched for p in far.publishers("/dds_open")] == [True]
        for topic, latched in (("/hub_volatile", False), ("/hub_latched", True)):
            far_out = far.advertise(topic, "std_msgs/String", latched=latched)
            far.publish(far_out, {"data": "first"})
            until(lambda topic=topic: topic in peer.graph()["topics"], f"{topic} is on the ROS 2 graph", 20)
            at_peer = peer.subscribe(topic, "std_msgs/String")
            if not latched:
                far.hub_publish_until(far_out, {"data": "later"}, lambda at=at_peer: peer.wait(at, 1, 0.2))
            assert peer.wait(at_peer, 1, 15)
    finally:
        peer.stop()
