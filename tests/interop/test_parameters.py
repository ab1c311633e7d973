"""Parameters of real rospy and rclpy programs, shared by rules through the real daemon."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bridge.hub.node import Hub
from bridge.messages.registry import Registry
from tests.peers.daemon.deployment import Deployment
from tests.peers.hub.parameters import HubParameters
from tests.peers.peer import Peer
from tests.peers.ros2.network import ros2_environment, ros2_python
from tests.support.wait import until

PROGRAM = Path(__file__).parents[1] / "peers" / "ros2" / "parameters.py"
RULES = [
    {"ros1": "/robot", "node": "/ns/robot_parameters", "owner": "ros1"},
    {"ros1": "/nav/controller", "node": "/controller_server", "owner": "ros2"},
]
EVENT = "rcl_interfaces/ParameterEvent"


def test_parameters_are_shared_in_both_directions(deployment: Deployment) -> None:
    deployment.master.start()
    deployment.configure(routing={"parameters": RULES})
    ros1 = deployment.ros1()
    ros1.ask("set_param", name="/robot", value={"speed": 1.5, "name": "r1", "limits": {"turn": 2}, "ranges": [1, 2.5]})
    ros2 = deployment.keep(Peer(PROGRAM, ros2_python(), ros2_environment(), "controller_server"))
    declared = {"FollowPath.speed": 0.5, "mode": "slow", "tries": 3, "weights": [1.0, 2.0]}
    unusual = {"exposure": 7500, "exposure.1": 100, "stamp": 2**40, "a-b": 1}
    ros2.ask("declare", parameters=declared | unusual, unset={"late": "DOUBLE"})
    deployment.run()

    assert_ros1_parameters_appear_on_a_node(ros1, ros2)
    assert_node_parameters_appear_in_ros1(ros1, ros2)
    _unusual_names_are_reported(deployment, ros1, ros2)
    parameters = {item["ros1"]: item for item in deployment.answer("ros1")["parameters"]}
    assert parameters["/robot"]["shared"] == 5
    assert parameters["/nav/controller"]["shared"] >= 4
    assert "a-b" in parameters["/nav/controller"]["skipped"]
    # a busy worker may not respond to the command in time
    until(lambda: "a-b" in deployment.command("status", seconds=60).stdout, "midspan status names the parameter")
    _a_value_that_ros1_cannot_represent_has_no_copy(ros1, ros2)
    # parameter services do not cross to ROS 1
    assert not [name for name in deployment.master.state()["services"] if "get_parameters" in name]
    _a_reload_applies_other_rules(deployment, ros1, ros2)
    assert deployment.stop_daemon() == 0
    assert ros1.ask("get_param", name="/nav")["value"] == {"controller": {"trise": 3}}, "only the copies are deleted"
    assert ros1.ask("get_param", name="/midspan")["value"] is None
    assert ros1.ask("get_param", name="/robot/speed")["value"] == 2.5


def assert_ros1_parameters_appear_on_a_node(ros1: Peer, ros2: Peer) -> None:
    """ROS 1 owns the parameters: a ROS 2 program discovers their node, reads and sets them, and receives events."""
    node = "/ns/robot_parameters"
    names = ["speed", "name", "limits.turn", "ranges"]
    assert ros2.ask("get_of", node=node, names=names)["values"] == [1.5, "r1", 2, [1.0, 2.5]]
    assert sorted(ros2.ask("list_of", node=node)["names"]) == sorted(names)
    until(lambda: node in ros2.ask("nodes")["names"], "the node is on the ROS 2 graph", 30)
    assert ros2.ask("set_of", node=node, parameters={"speed": 2.5, "limits": 1})["reasons"] == [
        "",
        "/robot/limits is a namespace in ROS 1",
    ]
    assert ros1.ask("get_param", name="/robot/speed")["value"] == 2.5
    received = ros2.subscribe("/parameter_events", EVENT, depth=1000)

    def changes() -> bool:
        value = ros1.ask("get_param", name="/robot/limits/turn")["value"] + 1
        ros1.ask("set_param", name="/robot/limits/turn", value=value)
        events = ros2.wait(received, 1, 0.5)
        return any(_changed(event, node, "limits.turn") for event in events)

    until(changes, "an event reports the change", 30)
    ros1.ask("set_param", name="/robot/extra", value="new")
    assert ros2.ask("get_of", node=node, names=["extra"])["values"] == ["new"]


def _changed(event: dict[str, Any], node: str, name: str) -> bool:
    return event["node"] == node and any(item["name"] == name for item in event["changed_parameters"])


def assert_node_parameters_appear_in_ros1(ros1: Peer, ros2: Peer) -> None:
    """A ROS 2 node owns the parameters: rospy reads and sets them, and the node can reject and change values."""

    def in_ros1(name: str) -> Any:
        return ros1.ask("get_param", name=f"/nav/controller/{name}")["value"]

    names, values = ("FollowPath/speed", "mode", "tries", "weights"), [0.5, "slow", 3, [1.0, 2.0]]
    # the master sets one after the other
    until(lambda: [in_ros1(name) for name in names] == values, "the node's parameters are in ROS 1", 30)
    ros1.ask("set_param", name="/nav/controller/FollowPath/speed", value=2)  # `rosparam set` writes 2.0 like this
    until(lambda: ros2.ask("own", name="FollowPath.speed")["value"] == 2.0, "the node has ROS 1's value", 30)
    ros2.ask("refuse", names=["mode"])
    ros1.ask("set_param", name="/nav/controller/mode", value="fast")
    until(lambda: in_ros1("mode") == "slow", "ROS 1 has the old value again after a rejection", 30)
    ros2.ask("refuse", names=[])
    assert ros2.ask("change", name="tries", value=9)["successful"]
    until(lambda: in_ros1("tries") == 9, "ROS 1 has the value that the node changed", 30)


def _unusual_names_are_reported(deployment: Deployment, ros1: Peer, ros2: Peer) -> None:
    """ROS 1 sets a parameter without a value and one that the node lacks; a node's parameter is named below another."""
    namespace = "/nav/controller"
    until(
        lambda: ros1.ask("get_param", name=f"{namespace}/exposure")["value"] == 7500, "ROS 1 has the other values", 30
    )
    ros1.ask("set_param", name=f"{namespace}/late", value=3)
    until(lambda: ros2.ask("own", name="late")["value"] == 3.0, "the node has the value of its declared type", 30)
    ros1.ask("set_param", name=f"{namespace}/trise", value=3)

    def reported() -> set[str]:
        warnings = deployment.worker("ros1").get("warnings", [])
        return {item.partition(": ")[0] for item in warnings if item.startswith(f"parameter {namespace}")}

    wanted = {f"parameter {namespace}/exposure/1", f"parameter {namespace}/trise"}
    until(lambda: wanted <= reported(), "status reports both", 30)


def _a_value_that_ros1_cannot_represent_has_no_copy(ros1: Peer, ros2: Peer) -> None:
    name = "/nav/controller/stamp"
    assert ros1.ask("get_param", name=name)["value"] is None
    ros2.ask("refuse", names=["stamp"])
    ros1.ask("set_param", name=name, value=5)
    until(lambda: ros1.ask("get_param", name=name)["value"] is None, "ROS 1 does not keep a value that is rejected", 30)
    ros2.ask("refuse", names=[])
    ros1.ask("set_param", name=name, value=6)
    until(lambda: ros2.ask("own", name="stamp")["value"] == 6, "the node has ROS 1's value", 30)
    assert ros2.ask("change", name="stamp", value=-(2**40))["successful"]
    until(lambda: ros1.ask("get_param", name=name)["value"] is None, "the copy is deleted", 30)


def _a_reload_applies_other_rules(deployment: Deployment, ros1: Peer, ros2: Peer) -> None:
    deployment.configure(routing={"parameters": [{**RULES[0], "node": "/renamed"}, RULES[1]]})
    deployment.hang_up()
    assert ros2.ask("get_of", node="/renamed", names=["speed"])["values"] == [2.5]
    until(lambda: "/ns/robot_parameters" not in ros2.ask("nodes")["names"], "the old node is gone", 30)
    until(lambda: ros1.ask("get_param", name="/nav/controller/tries")["value"] == 9, "the new rule applies", 30)


@pytest.mark.parametrize("owner", ["ros2", "ros1"])
def test_parameters_of_a_hub_node_are_shared_only_by_a_rule(deployment: Deployment, owner: str) -> None:
    """Of two native hub nodes, declared as rmw_zenoh does, one has a rule, and the other has none."""
    deployment.master.start()
    deployment.configure(routing={"parameters": [{"ros1": "/copy", "node": "/ns/named", "owner": owner}]})
    ros1 = deployment.ros1()
    deployment.run()
    named, unnamed = _hub_node(deployment, "named"), _hub_node(deployment, "unnamed")
    for service in [*named.services, *unnamed.services]:
        until(lambda service=service: "private" in _decisions(named, "ros1", service), f"a decision on {service}", 30)
    if owner == "ros2":
        whole = {"speed": 0.5, "limits": {"top": 1.5}, "mode": "slow"}
        # the master sets one after the other, and a late copy would replace the value that ROS 1 sets next
        until(lambda: ros1.ask("get_param", name="/copy")["value"] == whole, "ROS 1 has all copies", 30)
        ros1.ask("set_param", name="/copy/speed", value=0.75)
        until(lambda: named.values["speed"] == 0.75, "the node has the value that ROS 1 set", 30)
        ros2 = deployment.keep(Peer(PROGRAM, ros2_python(), ros2_environment(), "reader"))
        assert ros2.ask("get_of", node="/ns/named", names=["speed", "mode"])["values"] == [0.75, "slow"]
    offered = deployment.master.state()["services"]
    assert not [name for name in offered if name.startswith("/ns/")]
    for service in unnamed.services:
        until(lambda service=service: _decisions(named, "ros2", service) == {"private"}, f"a decision on {service}", 30)


def _hub_node(deployment: Deployment, name: str) -> HubParameters:
    hub = Hub.open(replace(deployment.settings(name, "far"), namespace="/ns"))
    node: HubParameters = deployment.keep(
        HubParameters(hub, f"/ns/{name}", Registry(), {"speed": 0.5, "limits.top": 1.5, "mode": "slow"})
    )
    return node


def _decisions(node: HubParameters, worker: str, service: str) -> set[str]:
    answers = node.hub.ask("explain", {"topic": service}, worker=worker)
    return {line["decision"] for answer in answers if isinstance(answer.value, list) for line in answer.value}
