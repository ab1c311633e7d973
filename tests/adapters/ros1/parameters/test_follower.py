"""Parameters are shared between a real roscore's parameter server and nodes on the hub."""

from __future__ import annotations

import json
import math
import re
import threading
import time
import urllib.request
import xmlrpc.client
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import pytest

from bridge.adapters.ros1.parameters.follower import ParameterSharing
from bridge.adapters.ros1.parameters.store import ParameterServer, copies_parameter, namespaces_parameter
from bridge.adapters.ros1.parameters.values import (
    MAX_DEPTH,
    NOT_SET,
    ParameterType,
    ParameterValue,
    to_ros2,
)
from bridge.config.sections.routing import ParameterRule
from bridge.hub.node import Hub
from bridge.hub.wire.qos import Qos
from bridge.messages.values import MessageReader
from tests.peers.hub.network import HubNetwork
from tests.peers.ros1.adapter import edge_on
from tests.peers.ros1.network import EMBEDDED, RosMaster, needs_ros1
from tests.peers.ros1.parameters import REGISTRY, ParameterClient, ParameterNode, double, integer, rule
from tests.support.wait import until

PERIOD = 0.1
OWNER = "1d3f"
COPIES = copies_parameter(OWNER)
NOBODY = "http://127.0.0.1:1/"
"""An address to which no master can report changes, so only the periodic comparison detects them."""


@pytest.fixture(scope="module")
def network() -> Iterator[HubNetwork]:
    with HubNetwork() as network:
        yield network


@pytest.fixture
def hubs(network: HubNetwork) -> Iterator[tuple[Hub, Hub]]:
    """The worker's session and another session."""
    with Hub.open(network.settings("midspan_ros1")) as ours, Hub.open(network.settings("others")) as others:
        yield ours, others


def server(master: RosMaster, owner: str = OWNER) -> RecordingServer:
    return RecordingServer(master.uri, lambda: "/midspan_test", NOBODY, owner)


class RecordingServer(ParameterServer):
    """A parameter server that counts written parameters."""

    written = 0

    def write(self, values: Mapping[str, Any]) -> list[str]:
        self.written += len(values)
        return super().write(values)


class RejectingServer(ParameterServer):
    """An in-memory parameter server that rejects lists of copies with more than ``limit`` names."""

    limit = 1

    def __init__(self) -> None:
        super().__init__(NOBODY, lambda: "/midspan_test", NOBODY, OWNER)
        self.values: dict[str, Any] = {}

    def write(self, values: Mapping[str, Any]) -> list[str]:
        rejected = [key for key, value in values.items() if key == COPIES and value and len(value) > self.limit]
        self.values |= {key: value for key, value in values.items() if key not in rejected}
        return rejected


def test_a_copy_that_the_master_does_not_list_is_not_set():
    """A later process deletes only copies that are listed."""
    store = RejectingServer()
    assert store.copy({"/a": 1}, ["/a"]) == []
    assert store.copy({"/a": 2, "/b": 1}, ["/a", "/b"]) == ["/b"]
    assert store.values == {COPIES: ["/a"], "/a": 2}
    assert store.copies == {"/a"}
    store.limit = 2
    assert store.copy({"/b": 1}, ["/a", "/b"]) == []
    assert store.values == {COPIES: ["/a", "/b"], "/a": 2, "/b": 1}


class Share(Protocol):
    """Starts sharing parameters by rules."""

    def __call__(
        self, *rules: ParameterRule, active: Callable[[], bool] = ..., store: ParameterServer | None = ...
    ) -> ParameterSharing: ...


@pytest.fixture
def share(master: RosMaster, hubs: tuple[Hub, Hub]) -> Iterator[Share]:
    started: list[ParameterSharing] = []

    def start(
        *rules: ParameterRule, active: Callable[[], bool] = lambda: True, store: ParameterServer | None = None
    ) -> ParameterSharing:
        store = store or server(master)
        started.append(ParameterSharing(rules, hubs[0], REGISTRY, store, active, PERIOD))
        return started[-1]

    yield start
    for parameters in started:
        parameters.stop()


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
def test_a_copy_does_not_overwrite_values_above_or_below_its_name(
    master: RosMaster, hubs: tuple[Hub, Hub], share: Share
):
    master.call("setParam", "/top", 3)
    before = {"speed": 1.5, "mode": {"a": 1}}
    master.call("setParam", "/robots/base", before)
    nodes = {
        "/top_node": ParameterNode(hubs[1], "/top_node", speed=double(0.5)),
        "/base_node": ParameterNode(hubs[1], "/base_node", mode=integer(1), speed__max=double(0.5), turn=double(2.5)),
    }
    parameters = share(
        rule("ros2", "/top/below", "/top_node"), rule("ros2", "/robots/base", "/base_node"), store=server(master)
    )
    until(lambda: master.call("getParam", "/robots/base/turn") == 2.5, "the other parameter is copied")
    asked = {name: node.asked for name, node in nodes.items()}
    until(lambda: all(node.asked > asked[name] + 2 for name, node in nodes.items()), "several comparisons are made")
    assert master.call("getParam", "/top") == 3
    assert master.call("getParam", "/robots/base") == {**before, "turn": 2.5}
    problems = {warning for warning in parameters.warnings() if "not copied" in warning}
    no_names, mode = "has a value, and ROS 1 does not allow names below it", "/robots/base/mode"
    assert problems == {
        f"parameter /top/below/speed: speed of /top_node is not copied, since /top {no_names}",
        f"parameter /robots/base/speed/max: speed.max of /base_node is not copied, since /robots/base/speed {no_names}",
        f"parameter {mode}: mode of /base_node is not copied, since {mode} is a namespace in ROS 1",
    }
    master.call("deleteParam", "/top")
    until(lambda: master.call("getParam", "/top") == {"below": {"speed": 0.5}}, "a name without an obstacle is copied")
    parameters.stop()
    assert master.call("getParam", "/robots/base") == before, "only copies are deleted"


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


@needs_ros1
def test_a_nodes_parameters_are_copied_to_ros1(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = ParameterNode(
        hubs[1], "/kept_node",
        FollowPath__speed=ParameterValue(ParameterType.DOUBLE, 1.5),
        FollowPath__inner__frame=ParameterValue(ParameterType.STRING, "odom"),
        FollowPath__huge=ParameterValue(ParameterType.INTEGER, 2**40),
        FollowPath__unset=NOT_SET,
        other=ParameterValue(ParameterType.INTEGER, 1),
    )  # fmt: skip
    master.call("setParam", "/kept", {"mine": 1, "speed": 99.0})
    parameters = share(rule("ros2", "/kept", "/kept_node", prefix="FollowPath"))
    want = {"mine": 1, "speed": 1.5, "inner": {"frame": "odom"}}
    until(lambda: master.call("getParam", "/kept") == want, "the node's values are in ROS 1")
    why = "/kept/huge: FollowPath.huge of /kept_node is not copied, since 1099511627776 does not fit"
    assert any(why in warning for warning in parameters.warnings())
    node.values["FollowPath.speed"] = ParameterValue(ParameterType.DOUBLE, 2.5)
    until(lambda: master.call("getParam", "/kept/speed") == 2.5, "the node's change is in ROS 1")
    del node.values["FollowPath.inner.frame"]
    until(lambda: master.call("getParam", "/kept/inner") is None, "the dropped parameter and its namespace are deleted")
    assert node.set == []
    parameters.stop()
    assert master.call("getParam", "/kept") == {"mine": 1}


@needs_ros1
def test_a_value_that_is_also_a_prefix_is_copied_without_the_names_below_it(
    master: RosMaster, hubs: tuple[Hub, Hub], share: Share
):
    hdr = ParameterNode(hubs[1], "/hdr", exposure=integer(7500), exposure__1=integer(100), exposure__a__b=integer(5))
    single = ParameterNode(hubs[1], "/single", limits__speed=double(1.5), limits__speed__max=double(2.0))
    unset = ParameterNode(hubs[1], "/unset_above", exposure=NOT_SET, exposure__1=integer(100))
    huge = ParameterNode(hubs[1], "/huge_above", exposure=integer(2**40), exposure__1=integer(100))
    store = server(master)
    parameters = share(
        rule("ros2", "/hdr", "/hdr"), rule("ros2", "/single", "/single", prefix="limits.speed"),
        rule("ros2", "/unset_above", "/unset_above"), rule("ros2", "/huge_above", "/huge_above"), store=store,
    )  # fmt: skip
    below = {"exposure": {"1": 100}}
    wanted = {"/hdr": {"exposure": 7500}, "/single": 1.5, "/unset_above": below, "/huge_above": below}
    until(
        lambda: {key: master.call("getParam", key) for key in wanted} == wanted,
        "the representable parameters are copied",
    )
    written, request = store.written, hdr.asked
    for node in (hdr, single, unset, huge):
        until(lambda node=node: node.asked > request + 5, "several comparisons are made")
    assert store.written == written, "nothing is written again"
    problems = parameters.warnings()
    for key, above in (("/hdr/exposure/1", "/hdr/exposure"), ("/hdr/exposure/a/b", "/hdr/exposure"),
                       ("/single/max", "/single")):  # fmt: skip
        name = key.removeprefix("/hdr/").replace("/", ".").replace(".single.", "limits.speed.")
        text = f"parameter {key}: {name} of {'/hdr' if 'hdr' in key else '/single'} is not copied, since {above} has a"
        assert any(item.startswith(text) for item in problems), key
    del hdr.values["exposure"]
    until(lambda: master.call("getParam", "/hdr") == {"exposure": {"1": 100, "a": {"b": 5}}}, "the names below appear")
    hdr.values["exposure"] = integer(50)
    until(lambda: master.call("getParam", "/hdr") == {"exposure": 50}, "the parameter is a single value again")


@needs_ros1
def test_a_name_of_too_many_parts_is_not_copied(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    deepest = ".".join(["a"] * MAX_DEPTH)
    node = ParameterNode(hubs[1], "/deep", nan=double(math.nan))
    node.values |= {deepest: integer(1), f"{deepest.replace('a', 'b')}.b": integer(2)}
    store = server(master)
    parameters = share(rule("ros2", "/deep", "/deep"), store=store)
    until(lambda: "a" in (master.call("getParam", "/deep") or {}), "the parameters are copied")
    written, request = store.written, node.asked
    until(lambda: node.asked > request + 3, "several comparisons are made")
    assert store.written == written, "nothing is written again"
    assert "b" not in master.call("getParam", "/deep")
    assert any(f"is not copied, since its name has more than {MAX_DEPTH} parts" in w for w in parameters.warnings())


@needs_ros1
def test_copies_of_a_killed_process_are_deleted_when_the_next_one_stops(
    master: RosMaster, hubs: tuple[Hub, Hub], share: Share
):
    alive = threading.Event()
    alive.set()
    node = ParameterNode(hubs[1], "/killed_node", speed=double(1.5), turn=double(0.5))
    rules = rule("ros2", "/killed", "/killed_node"), rule("ros2", "/killed_too", "/killed_node", prefix="turn")
    share(*rules, active=alive.is_set)
    until(lambda: master.call("getParam", "/killed") == {"speed": 1.5, "turn": 0.5}, "both parameters are copied")
    until(lambda: master.call("getParam", "/killed_too") == 0.5, "the other rule's parameter is copied")
    assert sorted(master.call("getParam", COPIES)) == ["/killed/speed", "/killed/turn", "/killed_too"]
    alive.clear()  # from here on the first process does nothing, as if it had been killed
    node.close()
    master.call("setParam", "/killed/mine", 1)
    again = share(rules[0])
    until(lambda: master.call("getParam", "/killed_too") is None, "no rule covers this copy anymore")
    again.stop()
    assert master.call("getParam", "/killed") == {"mine": 1}, "copies are deleted, and values of others stay"
    assert master.call("getParam", COPIES) is None


@needs_ros1
def test_copies_of_another_daemon_are_deleted_by_its_successor(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    first = threading.Event()
    first.set()
    node = ParameterNode(hubs[1], "/taken_node", speed=double(1.5), lasts=double(2.0))
    share(rule("ros2", "/taken", "/taken_node"), active=first.is_set, store=server(master, "dead"))
    until(lambda: master.call("getParam", "/taken") == {"speed": 1.5, "lasts": 2.0}, "both parameters are copied")
    first.clear()
    second = share(rule("ros2", "/taken", "/taken_node"))
    until(
        lambda: set(master.call("getParam", COPIES) or ()) == {"/taken/speed", "/taken/lasts"},
        "the successor adopts the copies",
    )
    del node.values["speed"]
    until(lambda: master.call("getParam", "/taken/speed") is None, "the parameter that the node dropped is deleted")
    second.stop()
    assert master.call("getParam", "/taken") is None, "the successor also adopts the namespace"


@needs_ros1
def test_copies_of_a_killed_process_are_deleted_without_rules(master: RosMaster, tmp_path: Path):
    (tmp_path / "ros1.json").write_text(json.dumps({"owner": "5e1f", "last": None}))
    master.call("setParam", "/unruled", {"gain": 1.0, "mine": 1})
    master.call("setParam", "/unruled_too/gain", 1.0)
    master.call("setParam", copies_parameter("5e1f"), ["/unruled/gain", "/unruled_too/gain"])
    master.call("setParam", namespaces_parameter("5e1f"), ["/unruled_too"])
    with edge_on(master, tmp_path, node="unruled"):
        until(lambda: master.call("getParam", copies_parameter("5e1f")) is None, "the copies are deleted")
        until(lambda: master.call("getParam", namespaces_parameter("5e1f")) is None, "their namespace is deleted")
        assert master.call("getParam", "/unruled") == {"mine": 1}
        assert master.call("getParam", "/unruled_too") is None


@needs_ros1
def test_unknown_names_are_reported(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = ParameterNode(hubs[1], "/names_node", gain=double(1.0), lens__focus=double(2.0))
    master.call("setParam", "/names", {"excluded": {"mine": 1}})
    parameters = share(rule("ros2", "/names", "/names_node", names=["*", "lens/**"]))
    until(lambda: master.call("getParam", "/names/gain") == 1.0, "the parameter is in ROS 1")
    assert parameters.warnings() == []
    master.call("setParam", "/names/gian", 2.0)
    master.call("setParam", "/names/lens/focs", 2.0)
    master.call("setParam", "/names/lens/focus/x", 3)  # replaces the copy with a namespace
    cure = "delete it in ROS 1, or exclude it with 'names' in routing.parameters"
    want = [
        f"parameter /names/{key}: set in ROS 1, but /names_node has no parameter {name} (similar: {similar}); {cure}"
        for key, name, similar in (("gian", "gian", "gain"), ("lens/focs", "lens.focs", "lens.focus"))
    ]
    until(lambda: master.call("getParam", "/names/lens") == {"focus": 2.0, "focs": 2.0}, "the copy is back")
    until(lambda: parameters.warnings() == want, "both parameters are reported")
    assert node.set == []
    master.call("deleteParam", "/names/gian")
    master.call("deleteParam", "/names/lens/focs")
    until(lambda: parameters.warnings() == [], "no problem is left")


@needs_ros1
def test_a_name_that_is_not_shared_is_not_reported_as_missing(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = ParameterNode(hubs[1], "/dashed_node", gain=double(1.0))
    node.values["a-b"] = integer(3)
    parameters = share(rule("ros2", "/dashed", "/dashed_node"))
    until(lambda: master.call("getParam", "/dashed") == {"gain": 1.0}, "the other parameter is in ROS 1")
    assert parameters.warnings() == []
    master.call("setParam", "/dashed/a-b", 2)
    want = (
        "parameter /dashed/a-b: set in ROS 1, but not on /dashed_node: only names of letters, digits and underscores"
        " are shared"
    )
    until(lambda: parameters.warnings() == [want], "the parameter is reported")
    assert parameters.details()[0]["skipped"] == ["a-b"]


@needs_ros1
def test_a_dot_in_a_name_of_ros1_is_reported(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    """The node's parameter `exposure.1` is `exposure/1` in ROS 1."""
    ParameterNode(hubs[1], "/camera", exposure__1=integer(100))
    parameters = share(rule("ros2", "/cam", "/camera"), rule("ros1", "/lens", "/lens_node"))
    until(lambda: master.call("getParam", "/cam") == {"exposure": {"1": 100}}, "the parameter is in ROS 1")
    for name in ("/cam/exposure.1", "/cam/gain.1", "/lens/focus.1"):
        master.call("setParam", name, 5)
    cure = "delete it in ROS 1, or exclude it with 'names' in routing.parameters"
    want = [
        "parameter /lens/focus.1: not on /lens_node, where focus.1 is /lens/focus/1 of ROS 1",
        "parameter /cam/exposure.1: set in ROS 1, but the parameter exposure.1 of /camera is /cam/exposure/1 there; "
        + cure,
        f"parameter /cam/gain.1: set in ROS 1, but the parameter gain.1 of /camera would be /cam/gain/1 there; {cure}",
    ]
    until(lambda: parameters.warnings() == want, "the names are reported")
    client = ParameterClient(hubs[1], "/lens_node")
    assert client.get("focus.1") == [None]
    assert client.set(focus__1=integer(7))["results"][0]["successful"]
    assert client.get("focus.1") == [7]
    assert master.call("getParam", "/lens") == {"focus.1": 5, "focus": {"1": 7}}


@needs_ros1
@pytest.mark.parametrize("write", [True, False])
def test_ros1_never_keeps_another_value_than_the_nodes(
    master: RosMaster, hubs: tuple[Hub, Hub], share: Share, caplog: pytest.LogCaptureFixture, write: bool
):
    """Of values that ROS 1 can represent it has the copy, of others none."""
    name = f"/other_{write}".lower()
    odd = {
        "huge": integer(2**40), "sizes": ParameterValue(ParameterType.INTEGER_ARRAY, [1, -(2**31) - 1]),
        "text": ParameterValue(ParameterType.STRING, "\x1b"), "lost": NOT_SET,
    }  # fmt: skip
    fine = {
        "data": ParameterValue(ParameterType.BYTE_ARRAY, b"\0\xff"), "nan": double(math.nan), "inf": double(math.inf),
        "least": integer(-(2**31)),
    }  # fmt: skip
    node = ParameterNode(hubs[1], f"{name}_node", **odd, **fine)
    node.refuses = {*odd, *fine}
    for path in odd.keys() | fine.keys():
        master.call("setParam", f"{name}/{path}", 5)
    parameters = share(rule("ros2", name, f"{name}_node", write=write))

    def is_nodes() -> bool:
        values = master.call("getParam", name)
        return values.keys() == fine.keys() and all(to_ros2(values[path]) == value for path, value in fine.items())

    until(is_nodes, "ROS 1 has the node's values only")
    assert sum(f"parameter {name}/huge is deleted" in text for text in caplog.messages) == 1
    caplog.clear()
    for path in odd.keys() | fine.keys():
        master.call("setParam", f"{name}/{path}", 6)
    until(is_nodes, "ROS 1 has the node's values again")
    asked = node.asked
    until(lambda: node.asked > asked + 2, "several comparisons are made")
    for path in odd.keys() | fine.keys():
        lines = [text for text in [*caplog.messages, *parameters.warnings()] if f"parameter {name}/{path}" in text]
        assert len(lines) == 2, "one line each in the log and in the status"
        why = rf"rejected 6(\.0)? for {path}: not now" if write else "write: false"
        assert all(re.search(why, line) for line in lines)
    assert parameters.details()[0]["shared"] == len(fine)


@needs_ros1
def test_a_value_without_a_copy_is_set_from_ros1(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = ParameterNode(hubs[1], "/big_node", big=integer(2**40), big__below=integer(1))
    parameters = share(rule("ros2", "/big", "/big_node"))
    until(lambda: master.call("getParam", "/big") == {"big": {"below": 1}}, "the other parameter is in ROS 1")
    master.call("setParam", "/big/big", 5)
    until(lambda: node.values["big"] == integer(5), "the node has ROS 1's value")
    until(lambda: master.call("getParam", "/big") == {"big": 5}, "the value is a copy now")
    node.values["big"] = integer(-(2**40))
    until(lambda: master.call("getParam", "/big") == {"big": {"below": 1}}, "the copy is deleted")
    parameters.stop()
    assert master.call("getParam", "/big") is None


@needs_ros1
def test_only_namespaces_of_copies_are_deleted(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = ParameterNode(hubs[1], "/spaces_node", a__b__c=integer(1), mine__d=integer(2), used__e=integer(3))
    master.call("setParam", "/spaces", {"mine": {}})
    parameters = share(rule("ros2", "/spaces", "/spaces_node"), rule("ros2", "/more/spaces", "/spaces_node"))
    wanted = {"a": {"b": {"c": 1}}, "mine": {"d": 2}, "used": {"e": 3}}
    for name in ("/spaces", "/more/spaces"):
        until(lambda name=name: master.call("getParam", name) == wanted, "the parameters are in ROS 1")
    master.call("setParam", "/more/spaces/used/own", 4)
    del node.values["a.b.c"], node.values["mine.d"]
    left = {"mine": {}, "used": {"e": 3}}
    until(lambda: master.call("getParam", "/spaces") == left, "the empty namespaces of copies are deleted")
    parameters.stop()
    assert master.call("getParam", "/spaces") == {"mine": {}}
    assert master.call("getParam", "/more") == {"spaces": {"used": {"own": 4}}}
    assert master.call("getParam", namespaces_parameter(OWNER)) is None


@needs_ros1
def test_a_declared_parameter_without_a_value_is_set_from_ros1(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = ParameterNode(hubs[1], "/late_node", lost=NOT_SET, mode=NOT_SET, count=NOT_SET, gain=double(1.0))
    node.types = {"mode": ParameterType.STRING, "count": ParameterType.INTEGER}
    master.call("setParam", "/late/lost", 3)  # before the node starts, as in a launch file
    parameters = share(rule("ros2", "/late", "/late_node"))
    until(lambda: node.values["lost"] == double(3.0), "the node's value has the declared type")
    until(lambda: "/late/lost" in (master.call("getParam", COPIES) or ()), "the parameter is a copy now")
    master.call("setParam", "/late/mode", 5)
    until(lambda: master.call("getParam", "/late/mode") is None, "the rejected value is deleted")
    assert any("/late/mode: /late_node rejected 5 for mode: not now" in item for item in parameters.warnings())
    master.call("setParam", "/late/count", [[1]])
    until(lambda: master.call("getParam", "/late/count") is None, "the list of lists is deleted")
    why = "/late/count: count of /late_node does not get the value set in ROS 1"
    assert any(why in item for item in parameters.warnings())
    node.values["lost"] = NOT_SET
    until(lambda: master.call("getParam", "/late/lost") is None, "the copy is deleted, since the node has no value")
    assert node.values["lost"] == NOT_SET


@needs_ros1
@pytest.mark.parametrize("write", [True, False])
def test_problems_of_a_node_disappear_with_it(master: RosMaster, hubs: tuple[Hub, Hub], share: Share, write: bool):
    name = f"/ended_{write}".lower()
    node = ParameterNode(
        hubs[1], f"{name}_node", huge=integer(2**40), speed=double(1.5), speed__x=double(1.0), fixed=double(1.0),
        lost=NOT_SET,
    )  # fmt: skip
    node.refuses = {"fixed", "lost"}
    parameters = share(rule("ros2", name, f"{name}_node", write=write))
    until(lambda: master.call("getParam", f"{name}/fixed") == 1.0, "the parameter is in ROS 1")
    for other in ("fixed", "lost", "unknown"):
        master.call("setParam", f"{name}/{other}", 2.0)

    def reported() -> set[str]:
        return {warning.partition(": ")[0] for warning in parameters.warnings()}

    wanted = {f"parameter {name}/{remaining}" for remaining in ("huge", "speed/x", "fixed", "lost", "unknown")}
    until(lambda: reported() == wanted, "all problems are reported")
    until(lambda: master.call("getParam", f"{name}/fixed") == 1.0, "the parameter is reset")
    node.close()
    until(lambda: parameters.warnings() == [], "the warnings disappear with the node")


@needs_ros1
def test_ros1_sets_a_nodes_parameters(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = ParameterNode(
        hubs[1],
        "/asked_node",
        speed=ParameterValue(ParameterType.DOUBLE, 1.5),
        mode=ParameterValue(ParameterType.STRING, "slow"),
    )
    parameters = share(rule("ros2", "/asked", "/asked_node"))
    until(lambda: master.call("getParam", "/asked") == {"speed": 1.5, "mode": "slow"}, "both parameters are in ROS 1")
    master.call("setParam", "/asked/speed", 3)
    parameters.compare_soon()
    until(lambda: node.values["speed"] == ParameterValue(ParameterType.DOUBLE, 3.0), "the node has ROS 1's value")
    node.refuses = {"mode"}
    master.call("setParam", "/asked/mode", "fast")
    until(lambda: master.call("getParam", "/asked/mode") == "slow", "the rejected value is reset")
    assert ("mode", "fast") in node.set
    until(
        lambda: any("rejected 'fast' for mode: not now" in item for item in parameters.warnings()),
        "the rejection is reported",
    )
    shared = {"ros1": "/asked", "node": "/asked_node", "owner": "ros2", "shared": 2, "skipped": []}
    assert parameters.details() == [shared]


@needs_ros1
def test_a_read_only_copy_is_reset(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = ParameterNode(hubs[1], "/read_node", speed=ParameterValue(ParameterType.DOUBLE, 1.5))
    share(rule("ros2", "/read_only", "/read_node", write=False))
    until(lambda: master.call("getParam", "/read_only/speed") == 1.5, "the parameter is in ROS 1")
    master.call("setParam", "/read_only/speed", 3.0)
    until(lambda: master.call("getParam", "/read_only/speed") == 1.5, "the parameter is reset")
    assert node.set == []


@needs_ros1
def test_values_set_while_the_node_is_absent_are_discarded(master: RosMaster, hubs: tuple[Hub, Hub], share: Share):
    node = ParameterNode(hubs[1], "/away_node", speed=ParameterValue(ParameterType.DOUBLE, 1.5))
    parameters = share(rule("ros2", "/away", "/away_node"))
    until(lambda: master.call("getParam", "/away/speed") == 1.5, "the parameter is in ROS 1")
    node.close()
    until(lambda: parameters.details()[0]["shared"] == 0, "the node is gone")
    master.call("setParam", "/away/speed", 9.0)
    again = ParameterNode(hubs[1], "/away_node", speed=ParameterValue(ParameterType.DOUBLE, 2.0))
    until(lambda: master.call("getParam", "/away/speed") == 2.0, "the node's value replaces ROS 1's")
    assert again.set == []


@pytest.mark.thorough
@needs_ros1
def test_the_node_is_withdrawn_when_the_master_exits(hubs: tuple[Hub, Hub]):
    with RosMaster() as master:
        master.call("setParam", "/gone/speed", 1.0)
        parameters = ParameterSharing(
            [rule("ros1", "/gone", "/gone_node")], hubs[0], REGISTRY, server(master), lambda: True, PERIOD
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
