"""A hub node's parameters are copied to a real roscore, and deleted there when they are no longer shared."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from bridge.adapters.ros1.parameters.store import (
    ParameterServer,
    TakenNames,
    copies_parameter,
    namespaces_parameter,
)
from bridge.adapters.ros1.parameters.values import MAX_DEPTH, NOT_SET, ParameterType, ParameterValue
from bridge.hub.node import Hub
from tests.peers.ros1.adapter import edge_on
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.peers.ros1.parameters import (
    COPIES,
    NOBODY,
    OWNER,
    ParameterNode,
    RecordingServer,
    Share,
    double,
    integer,
    rule,
)
from tests.support.wait import until


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
        rule("ros2", "/top/below", "/top_node"),
        rule("ros2", "/robots/base", "/base_node"),
        store=RecordingServer(master.uri),
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
def test_a_value_that_is_also_a_prefix_is_copied_without_the_names_below_it(
    master: RosMaster, hubs: tuple[Hub, Hub], share: Share
):
    hdr = ParameterNode(hubs[1], "/hdr", exposure=integer(7500), exposure__1=integer(100), exposure__a__b=integer(5))
    single = ParameterNode(hubs[1], "/single", limits__speed=double(1.5), limits__speed__max=double(2.0))
    unset = ParameterNode(hubs[1], "/unset_above", exposure=NOT_SET, exposure__1=integer(100))
    huge = ParameterNode(hubs[1], "/huge_above", exposure=integer(2**40), exposure__1=integer(100))
    store = RecordingServer(master.uri)
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
    store = RecordingServer(master.uri)
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
    share(rule("ros2", "/taken", "/taken_node"), active=first.is_set, store=RecordingServer(master.uri, "dead"))
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


class BusyServer(RecordingServer):
    """A parameter server on which ``program`` runs after each read of the names, before anything is deleted."""

    program: Callable[[], object] = staticmethod(lambda: None)

    def taken(self, without: Collection[str] = ()) -> TakenNames:
        taken = super().taken(without)
        self.program()
        return taken


@needs_ros1
def test_a_value_that_is_set_just_before_its_namespace_is_deleted_stays(master: RosMaster):
    store = BusyServer(master.uri)
    copies = ["/busy/a/b/copy", "/busy/c"]
    assert store.copy({"/busy/a/b/copy": 1, "/busy/c": 2}, copies) == []
    assert sorted(master.call("getParam", namespaces_parameter(OWNER))) == ["/busy", "/busy/a", "/busy/a/b"]

    def program() -> None:
        master.call("setParam", "/busy/a/b", {"own": 3, "list": [1, 2], "inner": {"text": "x"}})
        master.call("setParam", "/busy/d", 4)

    store.program = program
    assert store.copy(dict.fromkeys(copies), ()) == []
    assert master.call("getParam", "/busy") == {"a": {"b": {"own": 3, "list": [1, 2], "inner": {"text": "x"}}}, "d": 4}
    assert master.call("getParam", namespaces_parameter(OWNER)) is None
    store.close()
    master.call("deleteParam", "/busy")
