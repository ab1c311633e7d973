"""Real Cyclone DDS programs and the real daemon: topics, services, actions and parameters cross to each side."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from typing import Any

import pytest
import yaml
import zenoh

from bridge.adapters.ros2.services.cyclone import unwrap
from bridge.messages.registry import Registry
from bridge.messages.values import MessageWriter
from tests.adapters.ros2.conftest import string, text
from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.actions import HubActions
from tests.peers.hub.calls import SET_BOOL, Ends, Service
from tests.peers.ros2.cyclone import CyclonePeer
from tests.support.ports import free_port
from tests.support.wait import until
from yarp_compat.naming import connections
from yarp_compat.naming.client import NameClient
from yarp_compat.naming.config import Address
from yarp_compat.pythonic import Client

TEXT, TYPE = "std_msgs/String", "std_srvs/SetBool"
ACTION = "nav2_msgs/action/NavigateToPose"
SEND_GOAL = f"{ACTION}_SendGoal"
NAVIGATE = "nav2_msgs/NavigateToPose"
GOAL = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 5.0}}}}

NODE = "/cyclone_node"
RULE = {"ros1": "/mirrored", "node": NODE, "owner": "ros2"}
PARAMETERS: dict[str, dict[str, Any]] = {
    "list_parameters": {"result": {"names": ["speed"]}},
    "describe_parameters": {"descriptors": [{"name": "speed", "type": 3}]},
    "get_parameters": {"values": [{"type": 3, "double_value": 0.5}]},
    "get_parameter_types": {"types": [3]},
    "set_parameters": {"results": [{"successful": True}]},
}
"""A node's parameter services, and the reply of each."""


@pytest.fixture(scope="module")
def of_all_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployment]:
    """A daemon with all sides."""
    with Deployment(tmp_path_factory.mktemp("cyclone")) as deployment:
        key = {"key": "json/lamp", "topic": "/lamp", "type": SET_BOOL, "direction": "out"}
        deployment.start(
            yarp={"nameserver": "embedded", "address": f"127.0.0.1:{free_port()}", "poll": 0.1},
            zenoh={"dialects": [{"dialect": "json", "keys": [key]}]},
            routing={"parameters": [RULE]},
        )
        yield deployment


def name_server(deployment: Deployment) -> NameClient:
    host, _, port = yaml.safe_load(deployment.file.read_text())["yarp"]["address"].partition(":")
    return NameClient(Address(host, int(port)))


def cyclone(deployment: Deployment) -> CyclonePeer:
    return deployment.keep(CyclonePeer())


def session_config(deployment: Deployment) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{deployment.port}"]))
    return config


def until_explained(deployment: Deployment, name: str, decision: str, direction: str = "in") -> dict[str, Any]:
    """Return the line of ``explain`` about a name, once it shows this decision."""

    def explained() -> dict[str, Any] | None:
        lines = [line for line in deployment.explain(name) if (line["topic"], line["direction"]) == (name, direction)]
        return next((line for line in lines if line["decision"] == decision), None)

    deployment.status()
    return until(explained, f"{name} is {decision}", 30, every=0.1)  # type: ignore[return-value]


def executed(native: CyclonePeer, server: int) -> list[bytes]:
    """Return the requests that a server on Cyclone DDS has received, without header and trailing zeros."""
    framed = [unwrap(request) for request in native.requests(server)]
    return [request.payload.rstrip(b"\0") for request in framed if request is not None]


def test_clients_of_each_side_call_a_service_of_cyclone_dds(shared: Deployment) -> None:
    """The server receives the values that each client sent, and each client gets the reply."""
    native, service = cyclone(shared), Service(Registry(), SET_BOOL)
    server = native.serve("/lamp", TYPE, service.response(success=True, message="lit"))
    shared.until_route("ros1", "/lamp", "out", state="active")
    ros1 = shared.ros1()
    ros1.ask("await_service", service="/lamp", seconds=20)
    call = ros1.ask("call", service="/lamp", type=TYPE, request={"data": True})["id"]
    assert ros1.ask("result", id=call, seconds=20)["reply"] == {"success": True, "message": "lit"}

    ends, hub = Ends(), shared.zenoh().hub
    client = hub.client("/lamp", SET_BOOL, service.type.type_id)
    until(lambda: client.ready, "the service is on the hub")
    client.call(service.request(data=False), ends.done)
    assert service.answer(ends.replies()[0])["message"] == "lit"

    printed = shared.command("service", "call", "/lamp", "{data: true}")
    assert printed.returncode == 0, printed.stderr
    assert "lit" in printed.stdout

    names, port = name_server(shared), "/midspan/lamp/rpc"
    until(lambda: connections.exists(names, port), f"{port} is registered", 40)
    with Client(port, naming=names) as yarp:
        assert "lit" in str(yarp.ask([True], timeout=20.0))
    with zenoh.open(session_config(shared)) as session:

        def asked() -> list[zenoh.Reply]:
            return list(session.get("json/lamp", payload=json.dumps({"data": True}), timeout=10.0))

        (reply,) = until(asked, "a reply arrives", 20)
    assert reply.ok is not None
    assert json.loads(reply.ok.payload.to_string())["message"] == "lit"
    on, off = (service.request(data=data).rstrip(b"\0") for data in (True, False))
    assert executed(native, server) == [on, off, on, on, on]


def test_a_name_served_on_two_kinds_of_dds_is_called_on_fast_dds(shared: Deployment) -> None:
    """The server on Fast DDS is called, and the one on Cyclone DDS gets no request; explain and doctor name both."""
    native, ros2, service = cyclone(shared), shared.ros2(), Service(Registry(), SET_BOOL)
    server = native.serve("/twice", TYPE, service.response(success=False))
    fast = ros2.ask("serve", service="/twice", type=TYPE, reply={"success": True, "message": "lit"})["id"]
    until(
        lambda: "calls go to /" in until_explained(shared, "/twice", "bridged")["why"], "explain names the server", 30
    )
    shared.until_route("ros1", "/twice", "out", state="active")
    ros1 = shared.ros1()
    ros1.ask("await_service", service="/twice", seconds=20)
    call = ros1.ask("call", service="/twice", type=TYPE, request={"data": True})["id"]
    assert ros1.ask("result", id=call, seconds=20)["reply"] == {"success": True, "message": "lit"}
    printed = shared.command("service", "call", "/twice", "{data: true}")
    assert printed.returncode == 0, printed.stderr
    other = "and not to a node with an unknown name on Cyclone DDS"
    until(lambda: other in shared.command("explain", "/twice").stdout, "explain names the other node")

    def warned() -> list[dict[str, str]]:
        findings = json.loads(shared.command("doctor", "--json", seconds=60).stdout)
        return [finding for finding in findings if (finding["check"], finding["result"]) == ("cyclone", "warn")]

    (line,) = until(warned, "doctor warns")
    assert "another DDS also serves /twice, so the servers of these nodes get no calls" in line["seen"]
    assert native.requests(server) == []
    assert ros2.ask("requests", id=fast, count=2, seconds=20)["requests"] == [{"data": True}] * 2


def test_goals_reach_a_server_on_cyclone_dds(shared: Deployment) -> None:
    """One server accepts the goals of a client on the hub and of a client on ROS 1, and ends them."""
    native = cyclone(shared)
    service = Service(Registry(), f"{ACTION}_GetResult")
    servers = native.act("/cyclone_go", ACTION, result=service.response(status=4))
    for part in ("send_goal", "get_result", "cancel_goal"):
        until_explained(shared, f"/cyclone_go/_action/{part}", "bridged")
    ros2 = shared.ros2()
    for name in ("feedback", "status"):
        topic = f"/cyclone_go/_action/{name}"
        until(lambda topic=topic: ros2.graph()["publishers"].get(topic), f"{topic} has a publisher")
    ros1, hub = shared.ros1(), shared.keep(HubActions(shared.settings("module")))
    goal = hub.ask("send_goal", action="/cyclone_go", type=NAVIGATE, goal=GOAL, seconds=20)["id"]
    assert hub.ask("goal", id=goal, until={"accepted": True, "status": 4}, seconds=20)["status"] == 4
    pose = {"target_pose": GOAL["pose"]}
    goal = ros1.ask("send_goal", action="/cyclone_go", type="move_base_msgs/MoveBase", goal=pose)["id"]
    state = ros1.ask("goal", id=goal, until={"ends": 1}, seconds=20)
    assert state["accepted"] is True, state
    send_goal = Service(Registry(), SEND_GOAL)
    asked = [request for request in executed(native, servers) if len(request) > 40]
    goals = [send_goal.asked(padded(request)) for request in asked]
    assert [goal["goal"]["pose"]["pose"]["position"]["x"] for goal in goals] == [5.0, 5.0]
    assert {goal["goal"]["pose"]["header"]["frame_id"] for goal in goals} == {"map"}


def padded(request: bytes) -> bytes:
    """Append zeros to a request whose trailing zeros were removed."""
    return request + bytes(200)


def test_a_request_to_cancel_goals_is_answered_on_cyclone_dds(shared: Deployment) -> None:
    """The peer rejects each request to cancel goals."""
    native = cyclone(shared)
    servers = native.act("/cyclone_stop", ACTION)
    until_explained(shared, "/cyclone_stop/_action/cancel_goal", "bridged")

    def answered() -> bool:
        """Return whether the reply arrived. A node that has just started is not yet ready for calls."""
        printed = shared.command("halt", "--json", "--seconds", "1")
        return "rejected" in json.loads(printed.stdout)["errors"].get("/cyclone_stop", "")

    until(answered, "the request is answered", 20)
    everything = Service(Registry(), "action_msgs/srv/CancelGoal").request().rstrip(b"\0")
    assert everything in executed(native, servers)


def test_parameters_of_a_node_on_cyclone_dds_are_copied_to_ros1(shared: Deployment) -> None:
    """A node's parameters are copied to ROS 1."""
    native, ros1 = cyclone(shared), shared.ros1()
    for name, values in PARAMETERS.items():
        type_ = f"rcl_interfaces/srv/{name.title().replace('_', '')}"
        native.serve(f"{NODE}/{name}", type_.replace("/srv/", "/"), Service(Registry(), type_).response(**values))

    def copied() -> bool:
        return ros1.ask("get_param", name="/mirrored/speed")["value"] == 0.5

    until(copied, "the node's parameter is in ROS 1", 40, every=0.2)


def test_clients_on_cyclone_dds_call_a_ros1_service(shared: Deployment) -> None:
    native, service, ros1 = cyclone(shared), Service(Registry(), SET_BOOL), shared.ros1()
    server = ros1.ask("serve", service="/fan", type=TYPE, reply={"success": True, "message": "on"})["id"]
    shared.until_route("ros2", "/fan", "out", state="active")
    calls = [native.call("/fan", TYPE, service.request(data=data)) for data in (True, False)]
    for call in calls:
        assert service.answer(native.reply(call)) == {"success": True, "message": "on"}
    requests = ros1.ask("requests", id=server, count=2, seconds=20)["requests"]
    assert sorted(request["data"] for request in requests) == [False, True]


def test_topics_of_cyclone_dds_are_bridged_both_ways(shared: Deployment) -> None:
    native, ros1 = cyclone(shared), shared.ros1()
    kind = "std_msgs/String"
    out, subscription = native.advertise("/from_cyclone", kind), ros1.subscribe("/from_cyclone", kind)
    to_native, back = ros1.advertise("/to_cyclone", kind), native.subscribe("/to_cyclone", kind)

    def received() -> list[Any]:
        native.put(out, string("from Cyclone DDS"))
        return ros1.wait(subscription, 1, 0.2)

    def delivered() -> list[bytes]:
        ros1.publish(to_native, {"data": "from ROS 1"})
        return native.received(back, 1, 0.2)

    assert until(received, "a message arrives on ROS 1", 30)[0] == {"data": "from Cyclone DDS"}
    assert text(until(delivered, "a message arrives on Cyclone DDS", 30)[0]) == "from ROS 1"


def shows(deployment: Deployment, *texts: str) -> bool:
    printed = deployment.command("status").stdout
    return all(text in printed for text in texts)


def graph_message_of_humble() -> bytes:
    """Return a ``ParticipantEntitiesInfo`` of Humble, whose GIDs have 24 bytes, for a node with one publisher."""
    gid = bytes(range(24))
    node = cdr_string("/") + cdr_string("humble_node") + struct.pack("<II", 0, 1) + gid
    return b"\0\1\0\0" + gid + struct.pack("<I", 1) + node


def cdr_string(value: str) -> bytes:
    data = value.encode() + b"\0"
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)


def test_a_node_with_graph_messages_of_humble_is_found_by_its_endpoints(shared: Deployment) -> None:
    native, ros1 = shared.keep(CyclonePeer(user_data="enclave=/;")), shared.ros1()
    service = Service(Registry(), SET_BOOL)
    graph = native.advertise_raw(
        "ros_discovery_info", "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_", latched=True
    )
    native.put(graph, graph_message_of_humble())
    out, subscription = native.advertise("/from_humble", "std_msgs/String"), ros1.subscribe("/from_humble", TEXT)
    server = native.serve("/humble_lamp", TYPE, service.response(success=True, message="lit"))

    def received() -> list[Any]:
        native.put(out, string("from Humble"))
        return ros1.wait(subscription, 1, 0.2)

    assert until(received, "a message arrives on ROS 1", 30)[0] == {"data": "from Humble"}
    ros1.ask("await_service", service="/humble_lamp", seconds=20)
    call = ros1.ask("call", service="/humble_lamp", type=TYPE, request={"data": True})["id"]
    assert ros1.ask("result", id=call, seconds=20)["reply"] == {"success": True, "message": "lit"}
    assert len(executed(native, server)) == 1
    message = MessageWriter(Registry().schema("sensor_msgs/msg/Range")).message({"range": 2.5})
    ranges = native.advertise("/range", "sensor_msgs/Range")
    subscription = ros1.subscribe("/range", "sensor_msgs/Range")

    def range_received() -> list[Any]:
        native.put(ranges, message[:-4])  # Humble's Range lacks the variance of later releases
        return ros1.wait(subscription, 1, 0.2)

    assert until(range_received, "a Range of Humble arrives on ROS 1", 30)[0]["range"] == 2.5
    measured = ros1.advertise("/measured", "sensor_msgs/Range")
    humble, jazzy = native.subscribe("/measured", "sensor_msgs/Range"), shared.ros2()
    later = jazzy.subscribe("/measured", "sensor_msgs/Range")

    def both_received() -> bool:
        ros1.publish(measured, {"range": 2.5})
        return bool(native.received(humble, 1, 0.1)) and bool(jazzy.wait(later, 1, 0.1))

    until(both_received, "Humble and Jazzy receive a Range", 40)
    assert {payload[-4:] for payload in native.received(humble, 1)} == {message[-8:-4]}
    assert {len(payload) for payload in native.received(humble, 1)} == {len(message) - 4}
    assert {m["range"] for m in jazzy.wait(later, 1)} == {2.5}


def test_doctor_names_the_nodes(shared: Deployment) -> None:
    native, service = cyclone(shared), Service(Registry(), SET_BOOL)
    native.serve("/named", TYPE, service.response())
    until_explained(shared, "/named", "bridged")
    shared.ros2().advertise("/of_fast_dds", "std_msgs/String")
    until(lambda: shows(shared, "Cyclone DDS 11.0.1 (", "Fast DDS 2 (Iron or Jazzy): "), "status names both", 40)
    served_by = "    served by a node with an unknown name on Cyclone DDS 11.0.1 ("
    # a busy worker may not respond to a command in time
    until(lambda: served_by in shared.command("explain", "/named").stdout, "explain names the node")
    findings = json.loads(shared.command("doctor", "--json", seconds=60).stdout)
    named = [finding["seen"] for finding in findings if finding["check"] == "ros2-releases"]
    assert any(line.startswith("Cyclone DDS 11.0.1 (") for line in named), named
    assert any(line.startswith("Fast DDS 2 (Iron or Jazzy): ") for line in named), named
    (line,) = [finding for finding in findings if finding["check"] == "cyclone"]
    assert line["result"] == "ok"
    assert "topics, services and actions are bridged" in line["seen"]
