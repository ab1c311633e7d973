"""Parameters of a real roscore, shared as the parameters of a node on the hub."""

from __future__ import annotations

import json
import threading
import time
import urllib.request
import xmlrpc.client
from typing import Any

import pytest

from bridge.adapters.ros1.parameters.follower import ParameterSharing
from bridge.adapters.ros1.parameters.values import NOT_SET, ParameterType, ParameterValue
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.values import MessageReader
from tests.peers.ros1.network import EMBEDDED, RosMaster, needs_ros1
from tests.peers.ros1.parameters import (
    PERIOD,
    REGISTRY,
    ParameterClient,
    RecordingServer,
    Share,
    double,
    rule,
)
from tests.support.wait import until


@needs_ros1
def test_ros1_parameters_appear_on_a_node(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    master.call(
        "setParam", "/own", {"speed": 1.5, "frames": {"base": "base_link"}, "odd": [[1], [2]], "deep": {"x": 1}}
    )
    parameters = share(
        rule("ros1", "/own", "/ns/own_node"), rule("ros1", "/own_one", "/ns/own_node", prefix="one", write=False)
    )
    master.call("setParam", "/own_one", 3)
    client = ParameterClient(hubs[1], "/ns/own_node")
    until(lambda: ("own_node", "/ns") in {(n.node, n.namespace) for n in hubs[1].graph.nodes()}, "the node exists", 20)
    assert client.get("speed", "frames.base", "one", "nothing") == [1.5, "base_link", 3, None]
    listed = client.call("list_parameters", prefixes=[], depth=0)["result"]
    assert (listed["names"], listed["prefixes"]) == (["deep.x", "frames.base", "one", "speed"], ["deep", "frames"])
    assert client.call("list_parameters", prefixes=["frames"], depth=1)["result"]["names"] == ["frames.base"]
    assert client.call("list_parameters", prefixes=[], depth=1)["result"]["names"] == ["one", "speed"]
    assert client.call("get_parameter_types", names=["speed", "one", "x"])["types"].tolist() == [3, 2, 0]
    about = client.call("describe_parameters", names=["speed", "one"])["descriptors"]
    assert [(item["type"], item["read_only"], item["description"]) for item in about] == [
        (3, False, "ROS 1 parameter /own/speed"),
        (2, True, "ROS 1 parameter /own_one"),
    ]
    until(lambda: any("/own/odd" in warning for warning in parameters.warnings()), "the odd list is reported")
    all_shared = {"ros1": "/own", "node": "/ns/own_node", "owner": "ros1", "shared": 4, "skipped": []}
    until(lambda: parameters.details()[0] == all_shared, "the comparison has found all parameters")


@needs_ros1
def test_a_ros2_node_sets_ros1_parameters(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    master.call("setParam", "/set", {"speed": 1.5, "below": {"x": 1}, "fixed": 7})
    share(rule("ros1", "/set", "/set_node", names=["speed", "below/**", "new"]))
    client = ParameterClient(hubs[1], "/set_node")
    results = client.set(
        speed=ParameterValue(ParameterType.DOUBLE, 2.5),
        fixed=ParameterValue(ParameterType.INTEGER, 8),
        below=ParameterValue(ParameterType.INTEGER, 1),
        new=ParameterValue(ParameterType.STRING, "there"), below__x=ParameterValue(ParameterType.INTEGER, 2**40),
    )["results"]  # fmt: skip
    assert [item["successful"] for item in results] == [True, False, False, True, False]
    assert [item["reason"] for item in results if item["reason"]] == [
        "no rule of routing.parameters shares fixed",
        "/set/below is a namespace in ROS 1",
        "below.x: 1099511627776 does not fit into ROS 1's 32-bit integers",
    ]
    assert master.call("getParam", "/set") == {"speed": 2.5, "below": {"x": 1}, "fixed": 7, "new": "there"}
    both = {"speed": ParameterValue(ParameterType.DOUBLE, 9.0), "nobody": ParameterValue(ParameterType.DOUBLE, 9.0)}
    assert not client.set("set_parameters_atomically", **both)["result"]["successful"]
    assert master.call("getParam", "/set/speed") == 2.5
    assert client.set("set_parameters_atomically", new=NOT_SET)["result"]["successful"]
    assert master.call("getParam", "/set/new") is None


@needs_ros1
def test_a_ros2_node_does_not_overwrite_values_that_are_above_or_below_a_name(
    master: RosMaster, hubs: tuple[Hub, Hub], share: Share
):
    before = {"speed": 1.5, "tree": {"odd": [[1]]}}
    master.call("setParam", "/kept", before)
    share(rule("ros1", "/kept", "/kept_node"))
    one = ParameterValue(ParameterType.INTEGER, 1)
    client = ParameterClient(hubs[1], "/kept_node")
    results = client.set(speed__max=one, tree=one)["results"]
    assert [item["reason"] for item in results] == [
        "/kept/speed has a value, and ROS 1 does not allow names below it",
        "/kept/tree is a namespace in ROS 1",
    ]
    assert not client.set("set_parameters_atomically", new=one, new__below=one)["result"]["successful"]
    assert master.call("getParam", "/kept") == before


@needs_ros1
def test_a_ros2_node_does_not_overwrite_a_value_above_the_rule(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    master.call("setParam", "/over", 3)
    share(rule("ros1", "/over/below", "/over_node"))
    reasons = [item["reason"] for item in ParameterClient(hubs[1], "/over_node").set(speed=double(1.5))["results"]]
    assert reasons == ["/over has a value, and ROS 1 does not allow names below it"]
    assert master.call("getParam", "/over") == 3


@needs_ros1
@pytest.mark.skipif(EMBEDDED, reason="Midspan's own master refuses such values")
@pytest.mark.parametrize(
    "odd", [[json.loads("[" * 70 + "]" * 70)], [None], [2**40]], ids=["deep", "none", "large integer"]
)
def test_a_value_that_the_master_cannot_send_is_reported_alone(
    master: RosMaster, hubs: tuple[Hub, Hub], share: Share, odd: Any
):
    set_odd(master, "/odd/below/value", odd)
    try:
        set_odd(master, "/odd/speed", 1.5)
        parameters = share(rule("ros1", "/odd", "/odd_node"), rule("ros1", "/even", "/even_node"))
        master.call("setParam", "/even/speed", 2.5)
        client = ParameterClient(hubs[1], "/odd_node")
        assert client.get("speed", "below.value") == [1.5, None]
        assert ParameterClient(hubs[1], "/even_node").get("speed") == [2.5]
        warning = "parameter /odd/below/value: not on /odd_node as below.value: its value cannot be read"
        until(lambda: [w.startswith(warning) for w in parameters.warnings()] == [True], "only the value is reported")
        assert client.set(below__value=ParameterValue(ParameterType.INTEGER, 3))["results"][0]["successful"]
        until(lambda: not parameters.warnings(), "the report ends")
        assert client.get("speed", "below.value") == [1.5, 3]
    finally:
        master.call("deleteParam", "/odd")


def set_odd(master: RosMaster, name: str, value: Any) -> None:
    """Set a parameter to any value; XML-RPC's Python client itself refuses large integers."""
    marshaller = xmlrpc.client.Marshaller(allow_none=True)
    marshaller.dispatch = {
        **marshaller.dispatch,
        int: lambda _, number, write: write(f"<value><i8>{number}</i8></value>"),
    }
    params = marshaller.dumps(("/test", name, value))
    body = f"<?xml version='1.0'?><methodCall><methodName>setParam</methodName>{params}</methodCall>"
    request = urllib.request.Request(master.uri, body.encode(), {"Content-Type": "text/xml"})
    with urllib.request.urlopen(request, timeout=10.0) as answer:
        assert b"<fault>" not in answer.read()


def events(hub: Hub) -> list[dict[str, Any]]:
    """Return a list to which the parameter events on the hub are appended."""
    kind = REGISTRY.ros2("rcl_interfaces/msg/ParameterEvent")
    received: list[dict[str, Any]] = []

    def on_sample(sample: Any) -> None:
        received.append(MessageReader(REGISTRY.schema(kind.name), sample.payload.to_bytes()).message())

    hub.subscription("/parameter_events", kind.name, kind.type_id, Qos(depth=100), on_sample)
    return received


@needs_ros1
def test_changes_of_ros1_parameters_are_published_as_events(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    received = events(hubs[1])
    master.call("setParam", "/told", {"stays": 1, "changes": 2, "goes": 3})
    share(rule("ros1", "/told", "/told_node"))
    ParameterClient(hubs[1], "/told_node")

    def changed() -> bool:
        master.call("setParam", "/told/changes", master.call("getParam", "/told/changes") + 1)
        return any(item["name"] == "changes" for event in received for item in event["changed_parameters"])

    until(changed, "the change is published", every=0.5)
    master.call("deleteParam", "/told/goes")
    master.call("setParam", "/told/comes", "new")
    until(
        lambda: [n["name"] for e in received for n in e["deleted_parameters"]] == ["goes"], "the deletion is published"
    )
    until(
        lambda: [n["value"]["string_value"] for e in received for n in e["new_parameters"]] == ["new"],
        "the new parameter is published",
    )
    assert {event["node"] for event in received} == {"/told_node"}


@needs_ros1
def test_frequent_calls_do_not_postpone_the_comparison(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    received = events(hubs[1])
    master.call("setParam", "/called", {"speed": 0})
    share(rule("ros1", "/called", "/called_node"))
    client = ParameterClient(hubs[1], "/called_node")

    def changed_between_calls() -> bool:
        master.call("setParam", "/called/speed", master.call("getParam", "/called/speed") + 1)
        end = time.monotonic() + 3 * PERIOD
        while time.monotonic() < end:
            client.call("list_parameters", prefixes=[], depth=0)
        return any(event["node"] == "/called_node" and event["changed_parameters"] for event in received)

    until(changed_between_calls, "the change is published", every=0)


@pytest.mark.thorough
@needs_ros1
def test_the_node_is_withdrawn_when_the_master_exits(hubs: tuple[Hub, Hub]):
    with RosMaster() as master:
        master.call("setParam", "/gone/speed", 1.0)
        parameters = ParameterSharing(
            [rule("ros1", "/gone", "/gone_node")], hubs[0], REGISTRY, RecordingServer(master.uri), lambda: True, PERIOD
        )
        try:
            assert ParameterClient(hubs[1], "/gone_node").get("speed") == [1.0]
            master.stop()
            until(lambda: not hubs[1].graph.servers("/gone_node/get_parameters"), "the node is gone")
            assert any("does not respond" in warning for warning in parameters.warnings())
            master.start()
            master.call("setParam", "/gone/speed", 2.0)
            assert ParameterClient(hubs[1], "/gone_node").get("speed") == [2.0]
            until(lambda: parameters.warnings() == [], "no problem is left")
        finally:
            parameters.stop()


@needs_ros1
def test_a_worker_on_standby_shares_nothing(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    active = threading.Event()
    master.call("setParam", "/standing/speed", 1.0)
    share(rule("ros1", "/standing", "/standing_node"), active=active.is_set)
    share(rule("ros1", "/standing", "/active_node"))
    ParameterClient(hubs[1], "/active_node")
    assert not hubs[1].graph.servers("/standing_node/get_parameters")
    active.set()
    assert ParameterClient(hubs[1], "/standing_node").get("speed") == [1.0]
    active.clear()
    until(lambda: not hubs[1].graph.servers("/standing_node/get_parameters"), "the service is withdrawn again")
