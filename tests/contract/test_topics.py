"""Topics cross in both directions: every message arrives once and in order."""

from __future__ import annotations

from bridge.messages.definitions.hashes import EMPTY_MEMBER
from tests.contract.hubside import HubSide
from tests.contract.side import Bridge, PeerLike, Side
from tests.support.wait import until

STRING = "std_msgs/String"


def test_messages_of_the_side_arrive_on_the_hub_in_order(
    side: Side, bridge: Bridge, far: HubSide, *, lane: bool
) -> None:
    peer = side.peer()
    out = peer.advertise("/chatter", STRING, depth=100)
    subscription = far.subscribe("/chatter", STRING)
    far.until_route("/chatter", "in")
    far.publish_until(peer, out, {"data": "probe"}, lambda: far.wait(subscription, 1, 0.2))
    for n in range(50):
        peer.publish(out, {"data": f"number {n}"})
    expected = [f"number {n}" for n in range(50)]
    assert [m["data"] for m in far.wait_without(subscription, "probe", 50)] == expected
    until(
        lambda: peer.publish(out, {"data": "probe"}) or far.uses_transport("/chatter", "in", lane=lane),
        "the route uses the expected transport",
        every=0.1,
    )


def test_messages_of_the_hub_arrive_on_the_side_in_order(
    side: Side, bridge: Bridge, far: HubSide, *, lane: bool
) -> None:
    peer = side.peer()
    subscription = peer.subscribe("/orders", STRING, depth=100)
    out = far.advertise("/orders", STRING)
    _until_heard(far, out, peer, subscription)
    for n in range(50):
        far.publish(out, {"data": f"number {n}"})
    until(lambda: {"data": "number 49"} in peer.wait(subscription, 51, 0.2), "the last message arrives")
    got = [m["data"] for m in peer.wait(subscription, 51) if m["data"] != "probe"]
    assert got == [f"number {n}" for n in range(50)]
    until(
        lambda: far.publish(out, {"data": "probe"}) or far.uses_transport("/orders", "out", lane=lane),
        "the route uses the expected transport",
        every=0.1,
    )


def test_same_topic_both_ways_does_not_loop(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.peer()
    from_peer = peer.advertise("/both", STRING)
    at_peer = peer.subscribe("/both", STRING, depth=100)
    from_far = far.advertise("/both", STRING)
    at_far = far.subscribe("/both", STRING)
    far.until_route("/both", "in")
    _until_heard(far, from_far, peer, at_peer)
    far.publish_until(peer, from_peer, {"data": "probe"}, lambda: far.wait(at_far, 1, 0.2))
    for n in range(10):
        peer.publish(from_peer, {"data": f"peer {n}"})
        far.publish(from_far, {"data": f"far {n}"})
    peer.publish(from_peer, {"data": "end"})
    far.publish(from_far, {"data": "end"})
    expected = [f"peer {n}" for n in range(10)]
    own = far.hears_itself * 11
    arrived = [m["data"] for m in far.wait_without(at_far, "probe", 11 + own)]
    assert [text for text in arrived if text.startswith("peer")] == expected
    assert arrived.count("end") == 1 + far.hears_itself
    assert [text for text in arrived if text.startswith("far")] == [f"far {n}" for n in range(10)] * far.hears_itself
    until(lambda: [m["data"] for m in peer.wait(at_peer, 22, 0.2)].count("end") == 2, "both end messages arrive")
    received = [m["data"] for m in peer.wait(at_peer, 23, 0.5)]
    assert [m for m in received if m.startswith("far")] == [f"far {n}" for n in range(10)]
    assert [m for m in received if m.startswith("peer")] == expected


def test_a_velocity_is_bridged_with_its_values(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.peer()
    twist = {"linear": {"x": 1.0, "y": 2.0, "z": 3.0}, "angular": {"x": 4.0, "y": 5.0, "z": 6.0}}
    out = peer.advertise("/speed", "geometry_msgs/Twist")
    subscription = far.subscribe("/speed", "geometry_msgs/Twist")
    far.publish_until(peer, out, twist, lambda: far.wait(subscription, 1, 0.2))
    assert far.wait(subscription, 1)[0] == twist


def test_a_custom_type_is_bridged_both_ways(side: Side, bridge: Bridge, far: HubSide) -> None:
    thing = {
        "header": {"frame_id": "map"},
        "number": 7,
        "parts": [{"name": "a", "size": [1.0, 2.0, 3.0]}, {"name": "", "size": [4.0, 5.0, 6.0]}],
        "words": ["x", "", "yz"],
        "done": True,
    }
    peer = side.peer()
    out = peer.advertise("/things", "contract_msgs/Thing")
    subscription = far.subscribe("/things", "contract_msgs/Thing")
    far.until_route("/things", "in", 90)
    far.publish_until(peer, out, thing, lambda: far.wait(subscription, 1, 0.2))
    assert _without_stamp(far.wait(subscription, 1))[0] == thing
    back = far.advertise("/things_back", "contract_msgs/Thing")
    heard_back = peer.subscribe("/things_back", "contract_msgs/Thing")
    far.until_route("/things_back", "out", 90)
    far.hub_publish_until(back, thing, lambda: peer.wait(heard_back, 1, 0.2))
    assert _without_stamp(peer.wait(heard_back, 1))[0] == thing


def test_an_own_empty_type_is_bridged_both_ways(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.peer()
    out = peer.advertise("/pings", "own_msgs/Ping")
    received = far.subscribe("/pings", "own_msgs/Ping")
    far.until_route("/pings", "in", 90)
    far.publish_until(peer, out, {}, lambda: far.wait(received, 1, 0.2))
    assert _bare(far.wait(received, 1)[0]) == {}
    back = far.advertise("/pings_back", "own_msgs/Ping")
    received_back = peer.subscribe("/pings_back", "own_msgs/Ping")
    far.until_route("/pings_back", "out", 90)
    far.hub_publish_until(back, {}, lambda: peer.wait(received_back, 1, 0.2))
    assert _bare(peer.wait(received_back, 1)[0]) == {}


def test_an_octomap_whose_definition_is_in_a_folder_is_bridged(side: Side, bridge: Bridge, far: HubSide) -> None:
    tree = {
        "header": {"frame_id": "map"},
        "binary": True,
        "id": "OcTree",
        "resolution": 0.05,
        "data": [1, -2, 127, -128],
    }
    peer = side.peer()
    out = peer.advertise("/octomap_binary", "octomap_msgs/Octomap", latched=True)
    far.until_route("/octomap_binary", "in", 90)

    def crossed() -> bool:  # a route may exist shortly before zenoh programs discover it
        peer.publish(out, tree)
        return bool(far.until_route("/octomap_binary", "in")["messages"])

    until(crossed, "a message crosses", 20, every=0.5)
    subscription = far.subscribe("/octomap_binary", "octomap_msgs/Octomap", latched=True)
    got = _without_stamp(far.wait(subscription, 1))
    assert got == [tree] * max(len(got), 1)


def _bare(message: dict) -> dict:
    """Return a message without the field that ROS 2's C code and IDL add to an empty message."""
    return {name: value for name, value in message.items() if name != EMPTY_MEMBER}


def _without_stamp(messages: list[dict]) -> list[dict]:
    return [{**m, "header": {"frame_id": m["header"]["frame_id"]}} for m in messages]


def _until_heard(far: HubSide, out: int, peer: PeerLike, heard: int) -> None:
    far.hub_publish_until(out, {"data": "probe"}, lambda: peer.wait(heard, 1, 0.2))
