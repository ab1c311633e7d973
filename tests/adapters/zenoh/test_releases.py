"""Topics, services and actions between a side and nodes of Humble on the hub, which announce no type hashes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from bridge.hub.wire.qos import LATCHED, Qos
from tests.adapters.zenoh.conftest import ROS2, Place, until_linked
from tests.peers.zenoh.actions import SUCCEEDED, ActionClient
from tests.peers.zenoh.programs import Ros1Bridge, Ros2ddsBridge
from tests.peers.zenoh.releases import (
    HUMBLE,
    JAZZY,
    ReleaseClient,
    ReleaseNode,
    ReleasePublisher,
    ReleaseServer,
    ReleaseSubscription,
    Topic,
)
from tests.support.wait import until

SIDE = "zenoh_ros2dds"
YES = {"success": True, "message": "yes"}
SPEED = "geometry_msgs/Twist"
"""No topic of this type is named like a command here, because commands are dropped if this process stalls."""

TWISTS = [{"linear": {"x": 0.1 * number}} for number in range(1, 11)]
LIGHT = Topic("/light", "std_srvs/srv/SetBool", "unused")
ACTION = "tf2_msgs/action/LookupTransform"
NAME = "tf2_msgs/LookupTransform"
ID = {"goal_id": {"uuid": list(range(16))}}


@pytest.fixture
def humble(place: Place) -> Iterator[ReleaseNode]:
    place.bridge({"dialect": "ros2dds"}, {"dialect": "ros1", "latched": ["/map"]})
    node = ReleaseNode(place.hubs.endpoint, 0, "humble", HUMBLE)
    yield node
    node.close()


def twists(received: ReleaseSubscription) -> list[float]:
    return [ROS2.decode(SPEED, sample.payload)["linear"]["x"] for sample in received.samples]


def test_topics_from_humble_reach_each_dialect_once(place: Place, humble: ReleaseNode) -> None:
    dialects: dict[str, Ros2ddsBridge | Ros1Bridge] = {"ros2dds": place.ros2dds(), "ros1": place.ros1()}
    for program in dialects.values():
        until_linked(program, 3)  # the two dialects and the other program
    received = {name: program.subscribe("/speed", SPEED) for name, program in dialects.items()}
    publisher = ReleasePublisher(humble, Topic("/speed", "geometry_msgs/msg/Twist", "unused", Qos(depth=1)))
    for name, program in dialects.items():
        place.until_route(f"zenoh_{name}", "/speed", "out")

        def put(name: str = name, program: Any = program) -> bool:
            publisher.put(ROS2.encode(SPEED, {"angular": {"z": 9.0}}))
            return bool(program.wait(received[name], 1, 0.1))

        until(put, f"{name} is matched")
    for message in TWISTS:
        publisher.put(ROS2.encode(SPEED, message))

        def arrived(message: dict[str, Any] = message) -> bool:
            return all(
                abs(program.wait(received[name], 1)[-1]["linear"]["x"] - message["linear"]["x"]) < 1e-9
                for name, program in dialects.items()
            )

        until(arrived, "the message arrives")
    for name, program in dialects.items():
        speeds = [m["linear"]["x"] for m in program.wait(received[name], 1) if not m["angular"]["z"]]
        assert speeds == [m["linear"]["x"] for m in TWISTS], name


def test_topics_of_a_dialect_reach_humble_and_jazzy_once(place: Place, humble: ReleaseNode) -> None:
    bridge = place.ros2dds()
    until_linked(bridge, 2)
    type_hash = ROS2.type_id(SPEED)
    jazzy = ReleaseNode(place.hubs.endpoint, 0, "jazzy", JAZZY)
    topic = Topic("/speed", "geometry_msgs/msg/Twist", type_hash, Qos(depth=1))
    received = [ReleaseSubscription(node, topic) for node in (humble, jazzy)]
    publisher = bridge.advertise("/speed", SPEED, depth=1)

    def put() -> bool:
        bridge.publish(publisher, {"linear": {"x": 9.0}})
        return all(subscription.samples for subscription in received)

    until(put, "both endpoints are matched", every=0.1)
    for subscription in received:
        subscription.samples.clear()
    for number, message in enumerate(TWISTS):
        bridge.publish(publisher, message)
        for subscription in received:
            until(lambda s=subscription, n=number: len([x for x in twists(s) if x < 9.0]) > n, "the message arrives")
    for subscription in received:
        assert [speed for speed in twists(subscription) if speed < 9.0] == [m["linear"]["x"] for m in TWISTS]
        numbers = [sample.sequence for sample in subscription.samples]
        assert len(set(numbers)) == len(numbers)
    jazzy.close()


def test_a_latched_map_is_bridged_in_each_direction(place: Place, humble: ReleaseNode) -> None:
    bridge = place.ros2dds()
    type_name = "nav_msgs/OccupancyGrid"
    there = Topic("/there", "nav_msgs/msg/OccupancyGrid", "unused", LATCHED)
    sent = bridge.advertise("/there", type_name, latched=True, depth=1)
    bridge.publish(sent, {"header": {"frame_id": "there"}, "data": [1]})
    place.until_route(SIDE, "/there", "in")
    late = ReleaseSubscription(humble, there)
    until(lambda: late.samples, "a late subscription receives the message")
    assert ROS2.decode(type_name, late.samples[0].payload)["header"]["frame_id"] == "there"
    back = ReleasePublisher(humble, Topic("/back", "nav_msgs/msg/OccupancyGrid", "unused", LATCHED))
    back.put(ROS2.encode(type_name, {"header": {"frame_id": "back"}, "data": [2]}))
    place.until_route(SIDE, "/back", "out")
    received = bridge.subscribe("/back", type_name, latched=True, depth=1)
    assert bridge.wait(received, 1)[0]["header"]["frame_id"] == "back"


def test_a_type_that_no_one_defines_is_refused_with_the_cure(place: Place, humble: ReleaseNode) -> None:
    publisher = ReleasePublisher(humble, Topic("/own", "own_msgs/msg/Own", "unused"))
    publisher.put(b"\0\1\0\0")

    def refused() -> list[dict[str, Any]]:
        return [line for line in place.explain(SIDE, "/own") if line["decision"] == "refused"]

    (line,) = until(refused, "the endpoint is refused", every=0.2)
    assert "own_msgs/msg/Own" in line["reason"]
    assert line["cure"]


def test_services_are_called_in_each_direction(place: Place, humble: ReleaseNode) -> None:
    bridge = place.ros2dds()
    server = ReleaseServer(humble, LIGHT, lambda _: ROS2.encode("std_srvs/SetBool_Response", YES))
    place.until_route(SIDE, "/light", "out")
    reply = until(lambda: bridge.call("/light", "std_srvs/SetBool", {"data": True}).result()["reply"], "it replies")
    assert reply == YES
    assert ROS2.decode("std_srvs/SetBool_Request", server.requests[-1]) == {"data": True}
    serving, _tokens = bridge.serve("/door", "std_srvs/SetBool", {"type": "std_srvs/SetBool", "reply": YES})
    place.until_route(SIDE, "/door", "in")
    client = ReleaseClient(humble, Topic("/door", "std_srvs/srv/SetBool", "unused"))

    def called() -> list[bytes]:
        return client.call(ROS2.encode("std_srvs/SetBool_Request", {"data": True}))

    (answer,) = until(called, "a reply arrives", every=0.1)
    assert ROS2.decode("std_srvs/SetBool_Response", answer) == YES
    assert serving.requests()[-1] == {"data": True}


class HumbleAction:
    """An action server of a Humble node that accepts each goal and ends it at once."""

    def __init__(self, node: ReleaseNode, name: str) -> None:
        self.goals: list[dict[str, Any]] = []

        def part(suffix: str, type_name: str, **more: Any) -> Topic:
            return Topic(f"{name}/_action/{suffix}", type_name, "unused", **more)

        ReleaseServer(node, part("send_goal", f"{ACTION}_SendGoal"), self._send_goal)
        ReleaseServer(node, part("cancel_goal", "action_msgs/srv/CancelGoal"), lambda _: b"\0\1\0\0" + bytes(8))
        ReleaseServer(node, part("get_result", f"{ACTION}_GetResult"), self._get_result)
        self.feedback = ReleasePublisher(node, part("feedback", f"{ACTION}_FeedbackMessage"))
        self.status = ReleasePublisher(node, part("status", "action_msgs/msg/GoalStatusArray", qos=LATCHED))

    def _send_goal(self, request: bytes) -> bytes:
        self.goals.append(ROS2.decode(f"{NAME}_SendGoal_Request", request))
        self.report()
        return ROS2.encode(f"{NAME}_SendGoal_Response", {"accepted": True})

    def _get_result(self, _request: bytes) -> bytes:
        result = {"transform": {"child_frame_id": "laser"}}
        return ROS2.encode(f"{NAME}_GetResult_Response", {"status": SUCCEEDED, "result": result})

    def report(self) -> None:
        """Publish feedback, and the status of the last goal."""
        goal_id = self.goals[-1]["goal_id"]
        self.feedback.put(ROS2.encode(f"{NAME}_FeedbackMessage", {"goal_id": goal_id}))
        statuses = {"status_list": [{"goal_info": {"goal_id": goal_id}, "status": SUCCEEDED}]}
        self.status.put(ROS2.encode("action_msgs/GoalStatusArray", statuses))


def test_an_action_of_humble_is_driven_from_a_dialect(place: Place, humble: ReleaseNode) -> None:
    bridge = place.ros2dds()
    server = HumbleAction(humble, "/lookup")
    client = ActionClient(bridge, "/lookup")
    for part in ("send_goal", "cancel_goal", "get_result"):
        place.until_route(SIDE, f"/lookup/_action/{part}", "out")

    def answered(part: str, request: dict[str, Any]) -> Any:
        return until(lambda: client.ask(part, request).result()["reply"], f"a reply of {part}", every=0.1)

    assert answered("send_goal", {**ID, "goal": {"target_frame": "map"}})["accepted"]
    assert server.goals[-1]["goal"]["target_frame"] == "map"
    until(lambda: (server.report(), client.feedback)[1], "feedback arrives", every=0.1)
    until(
        lambda: client.statuses and client.statuses[-1]["status_list"][-1]["status"] == SUCCEEDED, "the status arrives"
    )
    result = answered("get_result", ID)
    assert (result["status"], result["result"]["transform"]["child_frame_id"]) == (SUCCEEDED, "laser")
    client.close()


def test_an_action_of_humble_is_driven_from_a_node_of_the_hub(place: Place, humble: ReleaseNode) -> None:
    server = HumbleAction(humble, "/lookup")
    client = place.node.action_client("/lookup", ACTION)
    until(lambda: client.ready, "the action is on the hub")
    ends: list[Any] = []
    place.on_node(lambda: client.send({"target_frame": "map"}, lambda *end: ends.append(end)))
    _goal, result, _reason = until(lambda: ends, "the goal ends")[0]
    assert result["transform"]["child_frame_id"] == "laser"
    assert server.goals[-1]["goal"]["target_frame"] == "map"


def test_topics_between_releases_on_the_hub_are_relayed_and_reach_a_dialect_once(
    place: Place, humble: ReleaseNode
) -> None:
    bridge, jazzy = place.ros2dds(), ReleaseNode(place.hubs.endpoint, 0, "jazzy", JAZZY)
    topic = Topic("/speed", "geometry_msgs/msg/Twist", ROS2.type_id(SPEED), Qos(depth=100))
    publisher, subscription = ReleasePublisher(humble, topic), ReleaseSubscription(jazzy, topic)
    received = bridge.subscribe("/speed", SPEED)

    def put() -> bool:
        publisher.put(ROS2.encode(SPEED, {"angular": {"z": 9.0}}))
        return bool(subscription.samples) and bool(bridge.wait(received, 1, 0.1))

    until(put, "both receive")
    for message in TWISTS:
        publisher.put(ROS2.encode(SPEED, message))
    expected = [message["linear"]["x"] for message in TWISTS]
    until(lambda: twists(subscription)[-1] == expected[-1], "Jazzy receives all messages")
    until(lambda: bridge.wait(received, 1)[-1]["linear"]["x"] == expected[-1], "the dialect receives all messages")
    assert [x for x in twists(subscription) if x] == [x for x in expected if x]
    speeds = [m["linear"]["x"] for m in bridge.wait(received, 1) if not m["angular"]["z"]]
    assert speeds == expected
    rows = [row for name in (SIDE, "zenoh_ros1") for row in place.answer(name).get("relay", {}).get("names", ())]
    assert [(row["topic"], row["senders"], row["receivers"]) for row in rows] == [("/speed", ["/humble"], ["/jazzy"])]
    assert rows[0]["messages"] >= len(expected)
    jazzy.close()
