"""Latched messages are retained per publisher, and late joiners receive all of them."""

from __future__ import annotations

from collections import Counter

import pytest

from tests.contract.hubside import HubSide
from tests.contract.side import Bridge, PeerLike, Side
from tests.support.wait import until

STRING = "std_msgs/String"


@pytest.fixture(autouse=True)
def _skip_if_latching_is_unknown(side: Side) -> None:
    if not side.tells_latching:
        pytest.skip("this side does not announce latching; tests/adapters/zenoh tests it")


def test_a_late_joiner_of_the_hub_receives_the_last_message_of_three_latched_publishers(
    side: Side, bridge: Bridge, far: HubSide
) -> None:
    peers = [side.peer() for _ in range(3)]
    ids = [p.advertise("/state", STRING, latched=True, depth=1) for p in peers]
    _publish(peers, ids, "early")
    far.until_published("/state", 3)
    _publish(peers, ids, "old")  # from here on, messages cross live
    _publish(peers, ids, "state")
    _until_late(far, "/state", ["state 0", "state 1", "state 2"], "the last message of each publisher crossed")
    assert _late(far, "/state", 3) == ["state 0", "state 1", "state 2"]
    peers[1].drop(ids[1])
    until(lambda: len(far.publishers("/state")) == 2, "the closed publisher left the hub", 15)
    assert _late(far, "/state", 2) == ["state 0", "state 2"]


def test_a_late_joiner_of_the_side_receives_the_last_message_of_three_latched_publishers(
    side: Side, bridge: Bridge, far: HubSide
) -> None:
    ids = [far.advertise("/plans", STRING, latched=True, depth=1) for _ in range(3)]
    for number, id_ in enumerate(ids):
        far.publish(id_, {"data": f"plan {number}"})
    until(lambda: (far.route("/plans", "out") or {}).get("messages", 0) >= 3, "three messages crossed", 15, every=0.1)
    assert _late_peer(side, "/plans", 3) == ["plan 0", "plan 1", "plan 2"]
    assert _late_peer(side, "/plans", 3) == ["plan 0", "plan 1", "plan 2"]
    far.drop(ids[1])
    until(
        lambda: far.route("/plans", "out")["sources"] == 2,
        "the messages of the closed publisher are dropped",
        15,
        every=0.1,
    )
    # the route's sources change just before the side drops the message
    until(lambda: _late_peer(side, "/plans", 2) == ["plan 0", "plan 2"], "the remaining messages are retained")


def test_the_newest_latched_messages_from_before_the_start_are_bridged(side: Side, far: HubSide, config) -> None:
    """Only the newest message of each publisher crosses."""
    peer = side.peer()
    out = peer.advertise("/early", STRING, latched=True, depth=1)
    far_out = far.advertise("/early_hub", STRING, latched=True, depth=1)
    for text in ("older", "early"):
        peer.publish(out, {"data": text})
        far.publish(far_out, {"data": f"{text} hub"})
    side.bridge(config())
    subscription = far.subscribe("/early", STRING, latched=True)
    assert far.wait(subscription, 1, 15) == [{"data": "early"}]
    subscription = peer.subscribe("/early_hub", STRING, latched=True)
    assert peer.wait(subscription, 1, 15) == [{"data": "early hub"}]
    for topic, direction in (("/early", "in"), ("/early_hub", "out")):  # a route counts a message after sending it
        until(
            lambda t=topic, d=direction: (far.route(t, d) or {}).get("messages"), f"the message on {topic} is counted"
        )
        assert far.route(topic, direction)["messages"] == 1
    assert far.route("/early_hub", "out")["latency_ms"] == {}


def test_a_late_joiner_of_the_hub_receives_the_static_transforms_of_three_broadcasters(
    side: Side, bridge: Bridge, far: HubSide
) -> None:
    peers = [side.peer() for _ in range(3)]
    ids = [p.advertise("/tf_static", "tf2_msgs/TFMessage", latched=True, depth=1) for p in peers]
    for number, (peer, id_) in enumerate(zip(peers, ids, strict=True)):
        peer.publish(id_, _transforms(f"sensor{number}", f"lens{number}"))
    everything = [f"{part}{n}" for part in ("lens", "sensor") for n in range(3)]
    until(lambda: _frames(_late_tf(far)) == everything, "the hub has all static transforms", 15)
    peers[0].drop(ids[0])
    until(lambda: (far.route("/tf_static", "in") or {}).get("sources") == 2, "one broadcaster has left", 15, every=0.1)
    assert _frames(_late_tf(far)) == everything


def test_a_late_joiner_of_the_side_receives_the_static_transforms_of_three_broadcasters(
    side: Side, bridge: Bridge, far: HubSide
) -> None:
    ids = [far.advertise("/tf_static", "tf2_msgs/TFMessage", latched=True, depth=1) for _ in range(3)]
    for number, id_ in enumerate(ids):
        far.publish(id_, _transforms(f"sensor{number}"))
    until(
        lambda: (far.route("/tf_static", "out") or {}).get("messages", 0) >= 3, "three messages crossed", 15, every=0.1
    )
    assert _frames(_late_peer_tf(side)) == ["sensor0", "sensor1", "sensor2"]
    far.drop(ids[2])
    until(lambda: far.route("/tf_static", "out")["sources"] == 2, "one broadcaster has left", 15, every=0.1)
    assert _frames(_late_peer_tf(side)) == ["sensor0", "sensor1", "sensor2"]


def test_transforms_that_are_not_latched_are_published_unchanged(side: Side, bridge: Bridge, far: HubSide) -> None:
    moving, fixed = side.peer(), side.peer()
    subscription = far.subscribe("/robot/tf", "tf2_msgs/TFMessage")
    out = moving.advertise("/robot/tf", "tf2_msgs/TFMessage")
    far.until_published("/robot/tf", 1)
    fixed.publish(fixed.advertise("/robot/tf", "tf2_msgs/TFMessage", latched=True, depth=1), _transforms("fixed"))
    until(lambda: _frames(_late_tf(far, "/robot/tf")) == ["fixed"], "the static transform is retained", 15)

    def alone() -> bool:
        moving.publish(out, _transforms("moving"))
        return _frames(far.wait(subscription, 10_000, 0.2)) == ["moving"]

    until(alone, "only the moving transform arrives", 15)
    assert _frames(_late_tf(far, "/robot/tf")) == ["fixed"]


def test_a_topic_follows_a_program_that_stops_and_resumes_latching(side: Side, bridge: Bridge, far: HubSide) -> None:
    peer = side.peer()
    for latched, text in ((True, "kept"), (False, "heard"), (True, "retained again")):
        out = peer.advertise("/mode", STRING, latched=latched, depth=1)
        if latched:
            peer.publish(out, {"data": text})
            _until_late(far, "/mode", [text], f"{text} is kept")
        else:
            until(
                lambda: [p.qos.latched for p in far.publishers("/mode")] == [False],
                "the topic is no longer latched",
                20,
            )
            subscription = far.subscribe("/mode", STRING)

            def crossed(out: int = out, subscription: int = subscription, text: str = text) -> bool:
                peer.publish(out, {"data": text})
                return {"data": text} in far.wait(subscription, 1, 0.2)

            until(crossed, "the volatile message is received", 15)
            # the first late subscription may still receive the message live over zenoh, which is slower than the lane;
            # each late subscription would receive a retained message
            _until_late(far, "/mode", [], "nothing is retained")
        peer.drop(out)


def _publish(peers: list[PeerLike], ids: list[int], text: str) -> None:
    for number, (peer, id_) in enumerate(zip(peers, ids, strict=True)):
        peer.publish(id_, {"data": f"{text} {number}"})


def _until_late(far: HubSide, topic: str, expected: list[str], what: str) -> None:
    """Wait until a late subscription receives exactly these messages; a failure lists what each one received."""
    received = Counter[str]()

    def once() -> bool:
        messages = _late(far, topic, len(expected))
        received[repr(messages)] += 1
        return messages == expected

    try:
        until(once, what, 20)
    except AssertionError as err:
        publishers = [(publisher.gid.hex(), publisher.qos) for publisher in far.publishers(topic)]
        raise AssertionError(f"{err}; received {received}; {publishers}; {far.route(topic, 'in')}") from None


def _late(far: HubSide, topic: str, count: int) -> list[str]:
    subscription = far.subscribe(topic, STRING, latched=True)
    far.wait(subscription, count)
    got = far.wait(subscription, count + 1, 0.5)
    far.drop(subscription)
    return sorted(m["data"] for m in got)


def _late_peer(side: Side, topic: str, count: int) -> list[str]:
    peer = side.peer()
    subscription = peer.subscribe(topic, STRING, latched=True, depth=100)
    peer.wait(subscription, count)
    return sorted(m["data"] for m in peer.wait(subscription, count + 1, 0.5))


def _transforms(*children: str) -> dict:
    item = {"translation": {"x": 1.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    return {"transforms": [{"header": {"frame_id": "base"}, "child_frame_id": c, "transform": item} for c in children]}


def _late_tf(far: HubSide, topic: str = "/tf_static") -> list[dict]:
    subscription = far.subscribe(topic, "tf2_msgs/TFMessage", latched=True)
    got = far.wait(subscription, 1)
    far.drop(subscription)
    return got


def _late_peer_tf(side: Side) -> list[dict]:
    peer = side.peer()
    subscription = peer.subscribe("/tf_static", "tf2_msgs/TFMessage", latched=True, depth=100)
    return peer.wait(subscription, 1)


def _frames(messages: list[dict]) -> list[str]:
    return sorted(t["child_frame_id"] for t in messages[-1]["transforms"]) if messages else []
