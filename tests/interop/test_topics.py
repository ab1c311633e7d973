"""Topics of real programs cross in every direction."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

import pytest

from bridge.messages.registry import Registry
from tests.peers.daemon.deployment import Deployment
from tests.peers.ros1.network import ROS1_PYTHON
from tests.support.lane import LANE
from tests.support.process import Process
from tests.support.wait import until

STRING = "std_msgs/String"


def cross(sender: Any, out: int, receiver: Any, subscription: int, message: dict) -> dict:
    """Publish until a message arrives; return the first one."""

    def once() -> list[dict]:
        sender.publish(out, message)
        return receiver.wait(subscription, 1, 0.2)

    first: dict = until(once, "a message crosses", 30)[0]
    return first


def test_messages_are_bridged_in_every_direction_between_ros1_ros2_and_zenoh(shared: Deployment) -> None:
    programs = {"ros1": shared.ros1(), "ros2": shared.ros2(), "sdk": shared.sdk()}
    for (from_, sender), (to, receiver) in itertools.permutations(programs.items(), 2):
        topic = f"/{from_}_to_{to}"
        subscription = receiver.subscribe(topic, STRING)
        out = sender.advertise(topic, STRING)
        assert cross(sender, out, receiver, subscription, {"data": topic}) == {"data": topic}
        if "sdk" not in (from_, to):
            shared.until_route(from_, topic, "in", way="lane" if LANE else "zenoh")
            shared.until_route(to, topic, "out", way="lane" if LANE else "zenoh")


FIELDS = [
    *({"name": name, "offset": 4 * place, "datatype": 7, "count": 1} for place, name in enumerate("xyz")),
    {"name": "ring", "offset": 13, "datatype": 4, "count": 1},
]
CLOUD = {"height": 2, "width": 1, "fields": FIELDS, "point_step": 16, "row_step": 20, "data": list(range(40))}
DEPTH = {"height": 1, "width": 2, "encoding": "16UC1", "step": 4, "data": [1, 0, 255, 255]}
MARKER = {
    "ns": "tree",
    "id": 3,
    "type": 6,
    "points": [{"x": 1.0, "y": 2.0, "z": 3.0}],
    "colors": [{"r": 1.0, "a": 0.5}],
}
THREE_D = [
    ("sensor_msgs/PointCloud2", CLOUD),
    ("sensor_msgs/Image", DEPTH),
    ("visualization_msgs/MarkerArray", {"markers": [MARKER]}),
]


def within(part: Any, whole: Any) -> bool:
    """Return whether the whole contains these fields; bytes may be bytes or a list."""
    if isinstance(part, dict):
        return all(within(value, whole[key]) for key, value in part.items())
    if isinstance(part, list) and part and not isinstance(part[0], int):
        return len(part) == len(whole) and all(map(within, part, whole))
    return list(part) == list(whole) if isinstance(part, list) else bool(part == whole)


@pytest.mark.thorough
@pytest.mark.parametrize(("kind", "message"), THREE_D, ids=[kind for kind, _ in THREE_D])
def test_clouds_depth_and_markers_cross_in_every_direction(
    shared: Deployment, kind: str, message: dict[str, Any]
) -> None:
    programs = {"ros1": shared.ros1(), "ros2": shared.ros2(), "sdk": shared.sdk()}
    for (from_, sender), (to, receiver) in itertools.permutations(programs.items(), 2):
        topic = f"/{from_}_to_{to}/{kind.partition('/')[2].lower()}"
        subscription = receiver.subscribe(topic, kind)
        out = sender.advertise(topic, kind)
        assert within(message, cross(sender, out, receiver, subscription, message)), (from_, to)


POSE = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
OCTOMAP = {"header": {"frame_id": "map"}, "binary": True, "id": "OcTree", "resolution": 0.5, "data": [-1, -1, 1, 0]}
SHAPE = [{"label": label, "size": 2, "stride": stride} for label, stride in (("column_index", 4), ("row_index", 2))]
HEIGHTS = {"layout": {"dim": SHAPE, "data_offset": 0}, "data": [0.5, 1.5, 2.5, 3.5]}
GRID = {"layers": ["height"], "basic_layers": ["height"], "data": [HEIGHTS], "outer_start_index": 1}
SIZES = {"resolution": 0.25, "length_x": 0.5, "length_y": 0.5, "pose": POSE}
NOT_INSTALLED = {
    "octomap_msgs/Octomap": (OCTOMAP, OCTOMAP),
    "octomap_msgs/OctomapWithPose": ({"origin": POSE, "octomap": OCTOMAP}, {"origin": POSE, "octomap": OCTOMAP}),
    "grid_map_msgs/GridMap": (
        {**GRID, "info": {**SIZES, "header": {"frame_id": "map"}}},
        {**GRID, "info": SIZES, "header": {"frame_id": "map"}},
    ),
}
"""Messages of packages that Debian does not have: as ROS 1 spells them, and as ROS 2 and the hub do."""
GET = "octomap_msgs/GetOctomap"


@pytest.mark.thorough
def test_types_of_missing_packages_cross_in_every_direction(shared: Deployment) -> None:
    """A ROS 1 program has definitions, a ROS 2 program packages built by Midspan, and a zenoh program only names."""
    registry = Registry(ros1_packages=Path("/nonexistent"))
    programs: dict[str, Any] = {"ros1": shared.ros1(), "ros2": shared.ros2(), "zenoh": shared.zenoh()}
    for kind in NOT_INSTALLED:
        programs["ros1"].ask("define", type=kind, definition=registry.ros1(kind).definition)
    request = registry.service_hub_to_ros1("octomap_msgs/srv/GetOctomap").side
    assert programs["ros1"].ask("define", type=GET, definition=request.definition)["md5"] == request.type_id
    pairs = list(itertools.permutations(programs, 2))
    ends = {}
    for kind, (from_, to) in itertools.product(NOT_INSTALLED, pairs):
        topic = f"/{from_}_to_{to}/{kind.partition('/')[2].lower()}"
        ends[kind, from_, to] = programs[to].subscribe(topic, kind), programs[from_].advertise(topic, kind)
    for (kind, from_, to), (subscription, out) in ends.items():
        sent, expected = (NOT_INSTALLED[kind][side != "ros1"] for side in (from_, to))
        assert within(expected, cross(programs[from_], out, programs[to], subscription, sent)), (kind, from_, to)
    for from_, to in pairs:
        program, service = programs[to], f"/maps_of_{to}_for_{from_}"
        reply = {"map": OCTOMAP}
        if to == "zenoh":
            program.serve(service, GET, reply=reply)
        else:
            program.ask("serve", service=service, type=GET, reply=reply)
        assert within(reply, called(from_, programs[from_], service)), (from_, to)


def called(side: str, program: Any, service: str) -> dict[str, Any]:
    """Return a GetOctomap response, once the service has a server."""
    if side == "zenoh":
        result: dict[str, Any] = program.call(service, GET).result(30.0)
    else:
        if side == "ros1":
            program.ask("await_service", service=service, seconds=30.0)
        call = program.ask("call", service=service, type=GET, request={}, seconds=30.0)["id"]
        result = program.ask("result", id=call, seconds=30.0)
    assert result["reply"] is not None, result
    reply: dict[str, Any] = result["reply"]
    return reply


@pytest.mark.thorough
def test_messages_are_bridged_in_every_direction_without_the_lane(deployment: Deployment) -> None:
    deployment.start(hub={"listen": f"tcp/127.0.0.1:{deployment.port}", "lane": False})
    programs = {"ros1": deployment.ros1(), "ros2": deployment.ros2()}
    for (from_, sender), (to, receiver) in itertools.permutations(programs.items(), 2):
        topic = f"/{from_}_to_{to}"
        subscription = receiver.subscribe(topic, STRING)
        out = sender.advertise(topic, STRING)
        assert cross(sender, out, receiver, subscription, {"data": topic}) == {"data": topic}
        assert deployment.until_route(to, topic, "out", way="zenoh")["why"] == "this worker has no lane"

        def explained(topic: str = topic) -> bool:  # a busy worker may not respond to the command in time
            return deployment.command("explain", topic).stdout.count("over zenoh, as this worker has no lane") == 2

        until(explained, "explain names the transport of both routes")


def test_explain_lists_the_connections_of_ros1(shared: Deployment) -> None:
    ros1, ros2 = shared.ros1(), shared.ros2()
    for topic, direction, sender, receiver in (
        ("/connected/in", "in", ros1, ros2), ("/connected/out", "out", ros2, ros1)
    ):  # fmt: skip
        subscription = receiver.subscribe(topic, STRING)
        cross(sender, sender.advertise(topic, STRING), receiver, subscription, {"data": "x" * 100})

        def counted(topic: str = topic) -> list[dict[str, Any]]:
            """Return the connections, once all are counted: bytes are counted shortly before their message."""
            listed: list[dict[str, Any]] = json.loads(shared.command("explain", topic, "--json").stdout)["connections"]
            return listed if all(one["bytes"] == one["messages"] * 108 > 0 for one in listed) else []

        (connection,) = until(counted, "explain lists the connection")
        kind = "publishers" if direction == "in" else "subscribers"
        names = [name for name in shared.master.state()[kind][topic] if name != "/midspan"]
        assert names == [connection["node"]]
        assert (connection["direction"], connection["transport"]) == (direction, "TCPROS")
        assert connection["host"].startswith("127.0.0.1:")
        text = shared.command("explain", topic).stdout
        assert f"{connection['node']} at {connection['host']} (TCPROS, {topic}): " in text


def test_a_start_pose_without_covariance_reaches_a_localizer_with_one(shared: Deployment) -> None:
    """Real amcl (1.17.3) uses zero covariances literally, and puts all particles at one point."""
    start = {"pose": {"pose": {"orientation": {"w": 1.0}}, "covariance": [0.0] * 36}}
    programs = {"ros1": shared.ros1(), "ros2": shared.ros2()}
    for (from_, sender), (_, receiver) in itertools.permutations(programs.items(), 2):
        topic = f"/{from_}/initialpose"
        subscription = receiver.subscribe(topic, "geometry_msgs/PoseWithCovarianceStamped")
        out = sender.advertise(topic, "geometry_msgs/PoseWithCovarianceStamped")
        got = cross(sender, out, receiver, subscription, start)["pose"]["covariance"]
        assert [got[0], got[7], got[35]] == [0.25, 0.25, math.radians(15.0) ** 2]


FIRST = """
import io, json, sys, genpy, roslib.message, rospy
from rospy.msg import serialize_message
from rospy.topics import _PublisherImpl
topic, kind, first, later = json.loads(sys.argv[1])
rospy.init_node("first", anonymous=True)
kind = roslib.message.get_message_class(kind)
old, new, written = kind(), kind(), io.BytesIO()
genpy.message.fill_message_args(old, [first])
genpy.message.fill_message_args(new, [later])
serialize_message(written, 0, old)
add = _PublisherImpl.add_connection

def to_the_first(publication, connection):
    if publication.resolved_name != topic:
        return add(publication, connection)
    _PublisherImpl.add_connection = add
    added = add(publication, connection)
    connection.write_data(written.getvalue())
    return added

_PublisherImpl.add_connection = to_the_first
publisher = rospy.Publisher(topic, kind, queue_size=10)
while _PublisherImpl.add_connection is to_the_first:
    rospy.sleep(0.005)
rospy.sleep(3.0)
while not rospy.is_shutdown():
    publisher.publish(new)
    rospy.sleep(0.05)
"""
"""A program that waits for a subscriber. Midspan's probe is its first subscriber, so only the probe gets the first
message. It publishes later messages until it is stopped, because Midspan may connect after the pause."""


def from_the_first_on(shared: Deployment, topic: str, kind: str, *messages: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what a ROS 2 program receives from a publisher, then from a program that waits for a subscriber."""
    receiver, other = shared.ros2(), shared.ros1()
    subscription = receiver.subscribe(topic, kind)
    out = other.advertise(topic, kind)
    before, first, later = messages
    cross(other, out, receiver, subscription, before)  # so that all endpoints exist
    program = json.dumps([topic, kind, first, later])
    with Process([ROS1_PYTHON, "-c", FIRST, program], shared.master.env):
        many = lambda: sum(within(later, message) for message in receiver.wait(subscription, 1, 0.1)) >= 10  # noqa: E731
        until(many, "later messages arrive")
    return receiver.wait(subscription, 10)


def test_the_only_message_of_a_program_that_waits_for_a_subscriber_is_received(shared: Deployment) -> None:
    """The probe of such a program is its first subscriber, and the program's only message may go to the probe."""
    sent = [{"data": text} for text in ("before", "first", "later")]
    received = from_the_first_on(shared, "/once", STRING, *sent)
    assert [message for message in sent if message in received] == sent


def test_a_command_to_the_probe_is_not_delivered_late(shared: Deployment) -> None:
    """Messages to the probe wait until the route exists. Velocities must not wait, as their sender may have stopped."""
    sent = [{"linear": {"x": speed}} for speed in (3.0, 1.0, 2.0)]
    received = from_the_first_on(shared, "/cmd_vel_once", "geometry_msgs/Twist", *sent)
    assert {message["linear"]["x"] for message in received} == {3.0, 2.0}


def test_messages_do_not_loop_whatever_the_names_of_nodes(shared: Deployment) -> None:
    """Three programs publish and subscribe on one topic; two have the names of the bridge's own nodes."""
    ros1, ros2, zenoh = shared.ros1("midspan_ros2"), shared.ros2("midspan"), shared.zenoh()
    programs: dict[str, Any] = {"ros1": ros1, "ros2": ros2, "zenoh": zenoh}
    subscriptions = {name: program.subscribe("/all", STRING, depth=200) for name, program in programs.items()}
    out = {name: program.advertise("/all", STRING, depth=200) for name, program in programs.items()}
    for sender, receiver in itertools.permutations(programs, 2):
        probe = {"data": f"probe {sender} to {receiver}"}
        _until_has(programs[sender], out[sender], programs[receiver], subscriptions[receiver], probe)
    for number in range(20):
        for name, program in programs.items():
            program.publish(out[name], {"data": f"{name} {number}"})
    for name, program in programs.items():
        program.publish(out[name], {"data": f"{name} end"})
    for name, program in programs.items():
        own_come_back = name != "zenoh"  # the test's hub session does not receive its own messages, rospy and rclpy do
        expected = {f"{n} {i}" for n in programs if n != name or own_come_back for i in [*range(20), "end"]}
        until(lambda p=program, h=subscriptions[name], e=expected: e <= _texts(p, h), f"{name} received everything", 20)
        counted = [
            m["data"] for m in program.wait(subscriptions[name], 10_000, 0.5) if not m["data"].startswith("probe")
        ]
        assert sorted(counted) == sorted(expected), name


def test_custom_types_are_bridged_between_ros1_and_ros2(shared: Deployment) -> None:
    thing = {
        "header": {"frame_id": "map"},
        "number": 513,
        "parts": [{"name": "wheel", "size": [0.5, 1.5, 2.5]}],
        "words": ["a", "", "ccc"],
        "done": True,
    }
    ros1, ros2 = shared.ros1(), shared.ros2()
    for sender, receiver, topic in ((ros1, ros2, "/things_a"), (ros2, ros1, "/things_b")):
        subscription = receiver.subscribe(topic, "contract_msgs/Thing")
        out = sender.advertise(topic, "contract_msgs/Thing")
        got = cross(sender, out, receiver, subscription, thing)
        got["header"] = {"frame_id": got["header"]["frame_id"]}
        assert got == thing


def test_a_type_that_only_a_connection_header_defines_is_bridged(shared: Deployment) -> None:
    """The definition comes from rospy's connection header, because no package has it; the ROS 2 package is built."""
    ros1, far = shared.ros1(), shared.zenoh()
    point = "=" * 80 + "\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    text = "string name\nint16[] blob\ngeometry_msgs/Point at\n" + point
    ros1.ask("define", type="header_only_msgs/Marked", definition=text)
    out = ros1.advertise("/marked", "header_only_msgs/Marked", latched=True)
    message = {"name": "x", "blob": [1, 2, 255], "at": {"x": 1.0, "y": 2.0, "z": 3.0}}
    ros1.publish(out, message)
    shared.until_route("ros1", "/marked", "in", messages=1)
    shared.until_route("ros2", "/marked", "out", messages=1)
    far.registry.learn_ros2(
        "header_only_msgs/msg/Marked", text.replace("MSG: geometry_msgs/Point", "MSG: geometry_msgs/msg/Point")
    )
    subscription = far.subscribe("/marked", "header_only_msgs/Marked", latched=True)
    assert far.wait(subscription, 1) == [message]


def test_a_best_effort_sensor_is_received(shared: Deployment) -> None:
    ros1, ros2 = shared.ros1(), shared.ros2()
    subscription = ros1.subscribe("/sensor", STRING)
    out = ros2.advertise("/sensor", STRING, best_effort=True)
    assert cross(ros2, out, ros1, subscription, {"data": "measured"}) == {"data": "measured"}


def test_a_burst_of_a_thousand_messages_crosses_completely(shared: Deployment) -> None:
    ros1, ros2 = shared.ros1(), shared.ros2()
    for sender, receiver, topic in ((ros1, ros2, "/burst_a"), (ros2, ros1, "/burst_b")):
        subscription = receiver.subscribe(topic, STRING, depth=2000)
        out = sender.advertise(topic, STRING, depth=2000, **({"queue": 2000} if sender is ros1 else {}))
        cross(sender, out, receiver, subscription, {"data": "first"})
        sender.publish(out, {"data": "burst"}, times=1000)
        until(
            lambda receiver=receiver, subscription=subscription: (
                receiver.wait(subscription, 1001, 0.5).count({"data": "burst"}) == 1000
            ),
            f"the burst on {topic}",
            20,
        )


def test_incompatible_qos_is_reported(shared: Deployment) -> None:
    ros1, ros2 = shared.ros1(), shared.ros2()
    ros1.advertise("/volatile", STRING)
    ros2.subscribe("/volatile", STRING, latched=True)
    shared.until_route("ros2", "/volatile", "out")
    named = lambda: [w for w in shared.worker("ros2").get("warnings", []) if "/volatile" in w]  # noqa: E731
    until(named, "the mismatch is reported", 20, every=0.2)


def test_diagnostics_on_both_ros_sides_name_the_routes(shared: Deployment) -> None:
    ros1, ros2 = shared.ros1(), shared.ros2()
    ros1.advertise("/watched", STRING)
    shared.until_route("ros2", "/watched", "out")
    for program, side in ((ros1, "ros1"), (ros2, "ros2")):
        subscription = program.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray")

        def named(program: Any = program, subscription: int = subscription) -> bool:
            last = program.wait(subscription, 1, 1.0)[-1:]
            return any("/watched" in status["name"] for m in last for status in m["status"])

        until(named, f"diagnostics of {side} name the route", 20)


def _texts(program: Any, subscription: int) -> set[str]:
    return {m["data"] for m in program.wait(subscription, 10_000, 0.1)}


def _until_has(sender: Any, out: int, receiver: Any, subscription: int, probe: dict) -> None:
    def once() -> bool:
        sender.publish(out, probe)
        return probe["data"] in _texts(receiver, subscription)

    until(once, probe["data"], 30)


def test_a_renamed_topic_gets_a_legal_name(deployment: Deployment) -> None:
    deployment.start(routing={"rules": [{"regex": "/lidar/(.*)/scan", "rename": r"/scan/\1"}]})
    ros1, ros2 = deployment.ros1(), deployment.ros2()
    subscription = ros2.subscribe("/scan/n1_2v", STRING)
    out = ros1.advertise("/lidar/1-2v/scan", STRING)
    assert cross(ros1, out, ros2, subscription, {"data": "x"}) == {"data": "x"}
