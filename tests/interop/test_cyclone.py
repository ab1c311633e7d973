"""Real Cyclone DDS programs and the real daemon: each client of their services receives the reason at once."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import Any

import pytest
import yaml
import zenoh

from bridge.hub.endpoints.calls import UnsentCallError
from bridge.hub.wire.keys import topic_key
from bridge.messages.registry import Registry
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

TYPE = "std_srvs/SetBool"
ACTION = "nav2_msgs/action/NavigateToPose"
SEND_GOAL = f"{ACTION}_SendGoal"
NAVIGATE = "nav2_msgs/NavigateToPose"
GOAL = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 5.0}}}}
AT_ONCE = 3.0

NODE = "/cyclone_node"
RULE = {"ros1": "/mirrored", "node": NODE, "owner": "ros2"}
PARAMETERS = {
    "list_parameters": "rcl_interfaces/ListParameters",
    "describe_parameters": "rcl_interfaces/DescribeParameters",
    "get_parameters": "rcl_interfaces/GetParameters",
    "get_parameter_types": "rcl_interfaces/GetParameterTypes",
    "set_parameters": "rcl_interfaces/SetParameters",
}


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


def until_refused(deployment: Deployment, name: str, direction: str = "in") -> dict[str, Any]:
    """Return the decision on a name that Cyclone DDS serves or calls."""

    def decision() -> dict[str, Any] | None:
        lines = [line for line in deployment.explain(name) if (line["topic"], line["direction"]) == (name, direction)]
        return next((line for line in lines if line["decision"] == "refused"), None)

    deployment.status()
    return until(decision, f"{name} is refused", 30, every=0.1)  # type: ignore[return-value]


def test_services_of_cyclone_dds(shared: Deployment) -> None:
    native, service = cyclone(shared), Service(Registry(), SET_BOOL)
    server = native.serve("/lamp", TYPE, service.response(success=True))
    decision = until_refused(shared, "/lamp")
    assert "/lamp is served on Cyclone DDS" in decision["reason"]
    assert "rmw_fastrtps_cpp" in decision["cure"]

    shared.until_route("ros1", "/lamp", "out", state="active")
    ros1 = shared.ros1()
    ros1.ask("await_service", service="/lamp", seconds=20)
    began = time.monotonic()
    call = ros1.ask("call", service="/lamp", type=TYPE, request={"data": True})["id"]
    answer = ros1.ask("result", id=call, seconds=20)
    assert "Cyclone DDS" in answer["error"]
    assert time.monotonic() - began < AT_ONCE

    ends, hub = Ends(), shared.zenoh().hub
    client = hub.client("/lamp", SET_BOOL, service.type.type_id)
    until(lambda: client.ready, "the service is on the hub")
    client.call(service.request(data=True), ends.done)
    (end,) = ends.wait(seconds=AT_ONCE)
    assert isinstance(end, UnsentCallError)

    printed = shared.command("service", "call", "/lamp", "{data: true}")
    assert printed.returncode == 1
    assert "Cyclone DDS" in printed.stderr
    assert "cannot cross" in shared.command("explain", "/lamp").stdout
    assert native.requests(server) == []


def test_yarp_and_json_clients_of_cyclone_dds(shared: Deployment) -> None:
    native, service = cyclone(shared), Service(Registry(), SET_BOOL)
    server = native.serve("/lamp", TYPE, service.response(success=True))
    until_refused(shared, "/lamp")
    names, port = name_server(shared), "/midspan/lamp/rpc"
    until(lambda: connections.exists(names, port), f"{port} is registered", 40)
    with Client(port, naming=names) as client:
        failed, reason = client.ask([True], timeout=AT_ONCE)
    assert str(failed) == "fail"
    assert "Cyclone DDS" in reason
    with zenoh.open(session_config(shared)) as session:

        def asked() -> list[zenoh.Reply]:
            return list(session.get("json/lamp", payload=json.dumps({"data": True}), timeout=AT_ONCE))

        (reply,) = until(asked, "a reply", 20)
    assert reply.err is not None
    assert "Cyclone DDS" in reply.err.payload.to_string()
    assert native.requests(server) == []


def test_actions_of_cyclone_dds(shared: Deployment) -> None:
    native = cyclone(shared)
    servers = native.act("/cyclone_go", ACTION)
    for part in ("send_goal", "get_result", "cancel_goal"):
        until_refused(shared, f"/cyclone_go/_action/{part}")
    ros1, hub = shared.ros1(), shared.keep(HubActions(shared.settings("module")))
    pose = {"target_pose": GOAL["pose"]}
    goal = ros1.ask("send_goal", action="/cyclone_go", type="move_base_msgs/MoveBase", goal=pose)["id"]
    state = ros1.ask("goal", id=goal, until={"ends": 1}, seconds=20)
    assert state["accepted"] is False
    assert "Cyclone DDS" in state["text"]

    goal = hub.ask("send_goal", action="/cyclone_go", type=NAVIGATE, goal=GOAL, seconds=20)["id"]
    assert hub.ask("goal", id=goal, until={"accepted": False}, seconds=AT_ONCE)["accepted"] is False

    printed = shared.command("action", "send", "/cyclone_go", json.dumps(GOAL))
    assert printed.returncode == 1
    assert "Cyclone DDS" in printed.stderr
    assert native.requests(servers) == []


def test_parameters_of_cyclone_dds(shared: Deployment) -> None:
    native = cyclone(shared)
    servers = [native.serve(f"{NODE}/{name}", type_, b"\0\1\0\0\0") for name, type_ in PARAMETERS.items()]

    def warned() -> list[str]:
        return [line for line in shared.worker("ros1").get("warnings", []) if NODE in line and "Cyclone DDS" in line]

    until(warned, "the ROS 1 worker reports why the parameters are not shared", 40)
    assert [native.requests(server) for server in servers] == [[]] * len(servers)


def test_halt_reports_what_it_cannot_cancel(shared: Deployment) -> None:
    native = cyclone(shared)
    servers = native.act("/cyclone_stop", ACTION)
    until_refused(shared, "/cyclone_stop/_action/cancel_goal")
    printed = shared.command("halt", "--json", "--seconds", "0.2")
    assert printed.returncode == 1
    assert "Cyclone DDS" in json.loads(printed.stdout)["errors"]["/cyclone_stop"]
    assert native.requests(servers) == []


def test_zenoh_clients_of_a_refused_action_get_error_and_refusal(shared: Deployment) -> None:
    """A client of rmw_zenoh logs an error reply and keeps waiting; the rejecting response ends its call."""
    native = cyclone(shared)
    servers = native.act("/cyclone_zenoh", ACTION)
    until_refused(shared, "/cyclone_zenoh/_action/send_goal")
    service = Service(Registry(), SEND_GOAL)
    key = topic_key(0, "/cyclone_zenoh/_action/send_goal", SEND_GOAL, service.type.type_id)
    with zenoh.open(session_config(shared)) as session:

        def asked() -> list[zenoh.Reply]:
            consolidation = zenoh.ConsolidationMode.NONE
            return list(session.get(key, payload=service.request(), timeout=AT_ONCE, consolidation=consolidation))

        error, reply = until(asked, "replies", 20)
    assert error.err is not None
    assert "Cyclone DDS" in error.err.payload.to_string()
    assert reply.ok is not None
    assert service.answer(reply.ok.payload.to_bytes())["accepted"] is False
    assert native.requests(servers) == []


def test_cyclone_clients_of_a_ros1_service(shared: Deployment) -> None:
    native, service, ros1 = cyclone(shared), Service(Registry(), SET_BOOL), shared.ros1()
    server = ros1.ask("serve", service="/fan", type=TYPE, reply={"success": True})["id"]
    shared.until_route("ros2", "/fan", "out", state="active")
    call = native.call("/fan", TYPE, service.request(data=True))
    decision = until_refused(shared, "/fan", "out")
    assert "requests for /fan from Cyclone DDS" in decision["reason"]
    assert shared.daemon is not None
    until(lambda: "requests for /fan from Cyclone DDS" in shared.daemon.output(), "the warning", 20)
    ros2 = shared.ros2()
    other = ros2.ask("call", service="/fan", type=TYPE, request={"data": True})["id"]
    assert ros2.ask("result", id=other, seconds=20)["reply"]["success"] is True
    assert ros1.ask("requests", id=server, count=1, seconds=0)["requests"] == [{"data": True}]
    assert native.reply(call, 0.0) == b""


def test_topics_of_cyclone_dds(shared: Deployment) -> None:
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

    assert until(received, "a message on ROS 1", 30)[0] == {"data": "from Cyclone DDS"}
    assert text(until(delivered, "a message on Cyclone DDS", 30)[0]) == "from ROS 1"


def test_doctor_names_the_nodes(shared: Deployment) -> None:
    native, service = cyclone(shared), Service(Registry(), SET_BOOL)
    native.serve("/lamp", TYPE, service.response())
    until_refused(shared, "/lamp")
    findings = json.loads(shared.command("doctor", "--json", seconds=60).stdout)
    (line,) = [finding for finding in findings if finding["check"] == "cyclone"]
    assert line["result"] == "warn"
    assert "topics cross; services, actions and parameters cannot be called (" in line["seen"]
    assert "/lamp" in line["seen"]
