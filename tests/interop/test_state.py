"""Latched messages between real ROS 1 and ROS 2 programs."""

from __future__ import annotations

from typing import Any

from tests.peers.daemon.deployment import Deployment
from tests.support.wait import until

STRING = "std_msgs/String"


def late(program: Any, topic: str, count: int, type_: str = STRING, seconds: float = 40) -> list[dict]:
    """Return the messages that a late subscriber receives, once there are ``count`` or the time is over."""
    subscription = program.subscribe(topic, type_, latched=True, depth=100)
    program.wait(subscription, count, seconds)
    messages: list[dict] = program.wait(subscription, count + 1, 0.5)
    program.drop(subscription)
    return messages


def test_three_latched_ros1_publishers_reach_late_ros2_and_zenoh(shared: Deployment) -> None:
    publishers = [shared.ros1() for _ in range(3)]
    ids = [p.advertise("/note", STRING, latched=True) for p in publishers]
    for number, (publisher, id_) in enumerate(zip(publishers, ids, strict=True)):
        publisher.publish(id_, {"data": f"note {number}"})
    shared.until_route("ros2", "/note", "out", sources=3, messages=3)
    far, sdk = shared.zenoh(), shared.sdk()
    for joiner in (shared.ros2(), shared.ros2(), far):
        assert sorted(m["data"] for m in late(joiner, "/note", 3)) == ["note 0", "note 1", "note 2"]
    # zenoh-ros2-sdk 0.1.8 queries the caches with zenoh's default consolidation, which returns one reply per key, and
    # only once, from the publishers that it knows by then
    messages = until(lambda: late(sdk, "/note", 1, seconds=5), "a late zenoh-ros2-sdk subscriber receives the note", 30)
    assert {m["data"] for m in messages} <= {"note 0", "note 1", "note 2"}
    publishers[0].stop()
    shared.until_route("ros2", "/note", "out", sources=2)
    assert sorted(m["data"] for m in late(shared.ros2(), "/note", 2)) == ["note 1", "note 2"]


def test_three_latched_ros2_publishers_reach_late_ros1(shared: Deployment) -> None:
    publishers = [shared.ros2() for _ in range(3)]
    ids = [p.advertise("/word", STRING, latched=True, depth=1) for p in publishers]
    for number, (publisher, id_) in enumerate(zip(publishers, ids, strict=True)):
        publisher.publish(id_, {"data": f"word {number}"})
    shared.until_route("ros1", "/word", "out", sources=3, messages=3)
    for joiner in (shared.ros1(), shared.ros1()):
        assert sorted(m["data"] for m in late(joiner, "/word", 3)) == ["word 0", "word 1", "word 2"]
    publishers[0].stop()
    shared.until_route("ros1", "/word", "out", sources=2)
    assert sorted(m["data"] for m in late(shared.ros1(), "/word", 2)) == ["word 1", "word 2"]


def test_late_joiners_receive_the_complete_tf_static_of_three_broadcasters_in_both_directions(
    shared: Deployment,
) -> None:
    for make, side, joiner in ((shared.ros1, "ros2", shared.ros2), (shared.ros2, "ros1", shared.ros1)):
        frames = [f"from_{side}_{number}" for number in range(3)]
        for frame in frames:
            broadcaster = make()
            id_ = broadcaster.advertise("/tf_static", "tf2_msgs/TFMessage", latched=True, depth=1)
            broadcaster.publish(id_, transform(frame))

        def whole(joiner: Any = joiner, frames: list[str] = frames) -> bool:
            got = late(joiner(), "/tf_static", 1, "tf2_msgs/TFMessage", 5)
            return set(frames) <= {t["child_frame_id"] for m in got for t in m["transforms"]}

        until(whole, f"a late {side} joiner has {frames}", 30)


def transform(child: str) -> dict:
    """Return a static transform."""
    pose = {"translation": {"x": 1.0, "y": 2.0, "z": 3.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    return {"transforms": [{"header": {"frame_id": "base_link"}, "child_frame_id": child, "transform": pose}]}
