"""Values that programs set on a real roscore for the parameters of a hub node."""

from __future__ import annotations

import math
import re

import pytest

from bridge.adapters.ros1.parameters import node_calls
from bridge.adapters.ros1.parameters.values import NOT_SET, ParameterType, ParameterValue, to_ros2
from bridge.hub.node import Hub
from tests.peers.ros1.network import RosMaster, needs_ros1
from tests.peers.ros1.parameters import (
    COPIES,
    ParameterClient,
    ParameterNode,
    Share,
    double,
    integer,
    rule,
)
from tests.support.wait import until


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
@pytest.mark.parametrize("lost", [False, True])
def test_a_node_that_hangs_is_reported(
    master: RosMaster, hubs: tuple[Hub, Hub], share: Share, caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch, lost: bool,
):  # fmt: skip
    """Its executor may be busy, or nobody spins it; a reply may also be lost, when a node of its name ends."""
    caplog.set_level("INFO")
    monkeypatch.setattr(node_calls, "REPEAT_SECONDS", 0.6 if lost else 1e9)
    name = f"/hanging_{lost}".lower()
    node = ParameterNode(hubs[1], f"{name}_node", gain=double(1.0))
    parameters = share(rule("ros2", name, f"{name}_node"))
    until(lambda: master.call("getParam", name) == {"gain": 1.0}, "the parameter is in ROS 1")
    assert parameters.warnings() == []
    node.hangs = True
    monkeypatch.setattr(node_calls, "ANSWER_SECONDS", 0.3)  # only now: other replies may be late, too
    want = (
        f"{name}: not shared at present: {name}_node has not replied for 0.3 s; if it hangs or spins"
        " no executor, restart it"
    )
    until(lambda: parameters.warnings() == [f"parameter {want}"], "the node is reported")
    until(lambda: node.kept >= 3 if lost else node.kept == 1, "it is asked again only if the reply may be lost")
    monkeypatch.setattr(node_calls, "ANSWER_SECONDS", 60.0)
    node.resume(lost=lost)
    master.call("setParam", f"{name}/gain", 2.0)
    until(lambda: node.values["gain"] == double(2.0), "the node has ROS 1's value")
    until(lambda: parameters.warnings() == [], "the warning disappears")
    assert [text for text in caplog.messages if f"parameters in {name} " in text] == [
        f"parameters in {name} are{want.partition(':')[2]}",
        f"parameters in {name} are shared again: {name}_node replies",
    ]


@needs_ros1
def test_nodes_of_one_name_on_the_hub_are_reported(
    master: RosMaster, hubs: tuple[Hub, Hub], share: Share, caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(node_calls, "NAMESAKE_SECONDS", 0.3)
    first = ParameterNode(hubs[1], "/double_node", gain=double(1.0))
    parameters = share(rule("ros2", "/double", "/double_node"))
    until(lambda: master.call("getParam", "/double") == {"gain": 1.0}, "the parameter is in ROS 1")
    assert parameters.warnings() == []
    second = ParameterNode(hubs[1], "/double_node", gain=double(1.0))
    text = "/double: 2 nodes on the hub are named /double_node, and any of them replies; rename or stop all but one"
    until(
        lambda: [warning.partition(" (ros2 run")[0] for warning in parameters.warnings()] == [f"parameter {text}"],
        "both nodes are reported",
    )
    second.close()
    until(lambda: parameters.warnings() == [], "one is left")
    first.close()
    assert sum("named /double_node" in message for message in caplog.messages) == 1


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
