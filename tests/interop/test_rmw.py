"""A rmw_zenoh node on the hub of a running daemon receives every message, and its messages arrive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from bridge.hub.wire.qos import Qos
from bridge.messages.actions import names
from bridge.messages.json import to_json
from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.actions import HubActions
from tests.peers.zenoh.release_actions import ReleaseActionServer
from tests.peers.zenoh.releases import LYRICAL, ReleaseNode
from tests.support.wait import until

STRING, TWIST = "std_msgs/String", "geometry_msgs/Twist"
NAVIGATE = "nav2_msgs/action/NavigateToPose"
COUNT = 20


def test_the_velocities_of_a_ros1_program_arrive_up_to_the_stop(shared: Deployment) -> None:
    """The hub node used to receive only the first 0.2 m/s, and never the stop."""
    ros1, node = shared.ros1(), shared.zenoh()
    received = node.subscribe("/cmd_vel", TWIST)
    out = ros1.advertise("/cmd_vel", TWIST)
    probe = {"linear": {"x": 0.1}}
    until(lambda: ros1.publish(out, probe) or node.wait(received, 1, 0.2), "the route exists")
    send = lambda speed: ros1.publish(out, {"linear": {"x": speed}})  # noqa: E731
    until(lambda: _all_arrive(send, {"ros1": (node, received)}, shared, "/cmd_vel", "in"), "all velocities arrive")


def test_the_velocities_of_a_node_arrive_on_both_sides_up_to_the_stop(shared: Deployment) -> None:
    node = shared.zenoh()
    out = node.advertise("/cmd_vel_of_node", TWIST)
    programs: dict[str, Any] = {"ros1": shared.ros1(), "ros2": shared.ros2()}
    received = {name: item.subscribe("/cmd_vel_of_node", TWIST, depth=100) for name, item in programs.items()}
    for name, program in programs.items():
        node.hub_publish_until(out, {"linear": {"x": 0.1}}, lambda p=program, n=name: p.wait(received[n], 1, 0.2))
    ends = {name: (program, received[name]) for name, program in programs.items()}
    send = lambda speed: node.publish(out, {"linear": {"x": speed}})  # noqa: E731
    until(lambda: _all_arrive(send, ends, shared, "/cmd_vel_of_node", "out"), "all velocities arrive")


def _all_arrive(
    send: Callable[[float], None], ends: dict[str, tuple[Any, int]], shared: Deployment, topic: str, direction: str
) -> bool:
    """Send velocities and the stop; return False if a side's worker stalled, and so dropped and counted a command.

    ``ends`` are the subscriptions, by the side whose route bridges the topic.
    """
    stale = lambda: {side: shared.until_route(side, topic, direction)["drops"]["stale"] for side in ends}  # noqa: E731
    before, dropped = {side: _settled(*end) for side, end in ends.items()}, stale()
    speeds = [0.2] * (COUNT // 2) + [0.0] * (COUNT // 2)
    for number, speed in enumerate(speeds, 1):  # one at a time, because of queued commands only the newest is kept
        send(speed)

        def arrived(number: int = number) -> bool:
            counts = {side: before[side] + number for side in ends}
            return all(len(peer.wait(end, counts[side], 0.2)) >= counts[side] for side, (peer, end) in ends.items())

        until(lambda: arrived() or stale() != dropped, f"velocity {number} arrives or is dropped")
        if not arrived():
            break
    got = {side: [m["linear"]["x"] for m in peer.wait(end, 0)][before[side] :] for side, (peer, end) in ends.items()}
    complete = all(arrived == speeds for arrived in got.values())
    assert complete or stale() != dropped, got
    return complete


SCAN = {"angle_min": 1.0, "ranges": [1.0, 2.0]}
STREAMS = {
    "/tf": ("tf2_msgs/TFMessage", lambda n: {"transforms": [{"transform": {"translation": {"x": n}}}]}),
    "/scan": ("sensor_msgs/LaserScan", lambda n: {**SCAN, "angle_min": n}),
    "/odom": ("nav_msgs/Odometry", lambda n: {"pose": {"pose": {"position": {"x": n}}}}),
}
NUMBER: dict[str, Any] = {
    "/tf": lambda m: m["transforms"][0]["transform"]["translation"]["x"],
    "/scan": lambda m: m["angle_min"],
    "/odom": lambda m: m["pose"]["pose"]["position"]["x"],
}


@pytest.mark.parametrize("side", ["ros1", "ros2"])
def test_streams_of_a_robot_arrive_completely(shared: Deployment, side: str) -> None:
    program, node = getattr(shared, side)(), shared.zenoh()
    for topic, (kind, message) in STREAMS.items():
        received = node.subscribe(topic, kind)
        out = program.advertise(topic, kind, depth=100)
        probe = message(-1.0)
        until(lambda o=out, p=probe, r=received: program.publish(o, p) or node.wait(r, 1, 0.2), f"{topic} arrives")
        for number in range(COUNT):
            program.publish(out, message(float(number)))
        numbers = lambda t=topic, r=received: [NUMBER[t](m) for m in node.wait(r, 0) if NUMBER[t](m) >= 0]  # noqa: E731
        until(lambda n=numbers: n()[-1:] == [COUNT - 1.0], f"the last message of {topic} arrives")
        assert numbers() == [float(number) for number in range(COUNT)], topic
        program.drop(out)


def test_the_feedback_of_an_action_arrives_completely(shared: Deployment) -> None:
    server, node = shared.ros2(), shared.zenoh()
    kind, rounds = "nav2_msgs/NavigateToPose", [{"number_of_recoveries": number} for number in range(COUNT)]
    acting = server.ask("act", action="/count", type=kind, feedback=rounds, held=True)["id"]
    topic = "/count/_action/feedback"
    token = until(lambda: node.publishers(topic), "the action's feedback is on the hub")[0]
    received: list[int] = []

    def receive(payload: bytes) -> None:
        message = to_json(node.registry, token.type_name, payload)
        received.append(message["feedback"]["number_of_recoveries"])

    node.node.subscription(topic, token.type_name, token.type_hash, Qos(depth=100), receive)
    client = shared.keep(HubActions(shared.settings("client")))
    client.ask("send_goal", action="/count", type=kind, goal={}, seconds=30.0)
    until(lambda: len(received) >= COUNT, "all feedback arrives")
    assert received == list(range(COUNT))
    server.ask("release", id=acting)


def test_nav2_of_lyrical_is_driven_from_ros1_and_ros2(shared: Deployment) -> None:
    """Lyrical's version of NavigateToPose has two more feedback fields."""
    settings, parts = shared.settings("bt_navigator"), names("/lyrical")
    assert settings.router is not None
    node = ReleaseNode(settings.router, settings.domain, "bt_navigator", LYRICAL)
    result = {"error_code": 9003, "error_msg": "late"}
    server = ReleaseActionServer(node, "/lyrical", NAVIGATE, {"distance_remaining": 2.5}, result)
    for side in ("ros1", "ros2"):
        for part in (parts.send_goal, parts.get_result):
            shared.until_route(side, part, "out", state="active")
    pose = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 5.0}, "orientation": {"w": 1.0}}}
    clients: list[tuple[Any, str, dict[str, Any]]] = [
        (shared.ros1(), "move_base_msgs/MoveBase", {"target_pose": pose}),
        (shared.ros2(), "nav2_msgs/NavigateToPose", {"pose": pose}),
    ]
    for number, (client, kind, request) in enumerate(clients, 1):
        goal = client.ask("send_goal", action="/lyrical", type=kind, goal=request, seconds=30.0)["id"]
        state = client.ask("goal", id=goal, until={"ends": 1}, seconds=30)
        assert (state["accepted"], state["ends"]) == (True, 1), state
        assert len(server.goals) == number
        assert server.goals[-1]["goal"]["pose"]["pose"]["position"]["x"] == 5.0
    assert (state["status"], state["result"]["error_code"], state["result"]["error_msg"]) == (4, 9003, "late")

    def explained() -> bool:
        text = shared.command("explain", "/lyrical").stdout
        both = text.count("NavigateToPose_Feedback.position_tracking_error") == 2  # one for each side
        return both and "bt_navigator has lyrical's version" in text

    until(explained, "explain names the field and the version for each side", 30)
    server.close()
    node.close()


def test_the_messages_of_midspan_topic_pub_arrive_completely(shared: Deployment) -> None:
    node = shared.zenoh()
    received = node.subscribe("/said", STRING)
    done = shared.command("topic", "pub", "/said", STRING, "{data: hi}", "--rate", "20", "--count", "10")
    assert done.returncode == 0, done.stderr
    assert node.wait(received, 10) == [{"data": "hi"}] * 10


def _settled(program: Any, received: int) -> int:
    """Return how many messages have arrived, once the last probe has."""
    counts = [-1]

    def settled() -> bool:
        counts.append(len(program.wait(received, counts[-1] + 1, 1.0)))
        return counts[-1] == counts[-2]

    until(settled, "the last probe arrives")
    return counts[-1]
