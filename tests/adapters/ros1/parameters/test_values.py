"""Values, names and rules of shared parameters."""

from __future__ import annotations

import xmlrpc.client
from typing import Any

import pytest

from bridge.adapters.ros1.parameters.values import (
    NOT_SET,
    ParameterNames,
    ParameterType,
    ParameterValue,
    UnrepresentableError,
    flatten,
    to_ros1,
    to_ros2,
)
from bridge.config.sections.routing import RoutingSection
from bridge.routing.rules import RuleSet
from tests.peers.ros1.parameters import CODECS, rule

VALUES = [
    (True, ParameterValue(ParameterType.BOOL, True)),
    (-7, ParameterValue(ParameterType.INTEGER, -7)),
    (2.5, ParameterValue(ParameterType.DOUBLE, 2.5)),
    (float("nan"), ParameterValue(ParameterType.DOUBLE, float("nan"))),
    ("base <&> link é😀\n", ParameterValue(ParameterType.STRING, "base <&> link é😀\n")),
    (xmlrpc.client.Binary(b"\0\xff"), ParameterValue(ParameterType.BYTE_ARRAY, b"\0\xff")),
    ([True, False], ParameterValue(ParameterType.BOOL_ARRAY, [True, False])),
    ([1, 2], ParameterValue(ParameterType.INTEGER_ARRAY, [1, 2])),
    ([1.5, 2.0], ParameterValue(ParameterType.DOUBLE_ARRAY, [1.5, 2.0])),
    (["a", ""], ParameterValue(ParameterType.STRING_ARRAY, ["a", ""])),
]


@pytest.mark.parametrize(("ros1", "ros2"), VALUES)
def test_values_are_converted_in_both_directions(ros1: Any, ros2: ParameterValue):
    assert to_ros2(ros1) == ros2
    assert repr(to_ros1(ros2)) == repr(ros1) or to_ros1(ros2) == ros1
    codec = CODECS["get_parameters"]
    sent = codec.response({"values": [ros2.message()]})
    assert ParameterValue.read(codec.response_value(sent)["values"][0]) == ros2
    assert ros2 != NOT_SET


@pytest.mark.parametrize(
    ("ros1", "like", "ros2"),
    [
        (1, ParameterType.DOUBLE, ParameterValue(ParameterType.DOUBLE, 1.0)),
        (2.0, ParameterType.INTEGER, ParameterValue(ParameterType.INTEGER, 2)),
        (2.5, ParameterType.INTEGER, ParameterValue(ParameterType.DOUBLE, 2.5)),
        (True, ParameterType.INTEGER, ParameterValue(ParameterType.BOOL, True)),
        ([1, 2], ParameterType.DOUBLE_ARRAY, ParameterValue(ParameterType.DOUBLE_ARRAY, [1.0, 2.0])),
        ([1, 2.5], ParameterType.NOT_SET, ParameterValue(ParameterType.DOUBLE_ARRAY, [1.0, 2.5])),
        ([], ParameterType.BOOL_ARRAY, ParameterValue(ParameterType.BOOL_ARRAY, [])),
        ([], ParameterType.DOUBLE, ParameterValue(ParameterType.STRING_ARRAY, [])),
    ],
)
def test_numbers_are_converted_to_the_nodes_type(ros1: Any, like: ParameterType, ros2: ParameterValue):
    assert to_ros2(ros1, like) == ros2


def test_values_that_the_other_network_lacks_are_rejected():
    for ros1 in ({"a": 1}, [[1], [2]], [1, "a"], [True, 1], None, xmlrpc.client.DateTime(), 2**63):
        with pytest.raises(UnrepresentableError):
            to_ros2(ros1)
    for ros2 in (
        ParameterValue(ParameterType.INTEGER, 2**31),
        ParameterValue(ParameterType.STRING, "a\0"),
        ParameterValue(ParameterType.STRING_ARRAY, ["\r"]),
        NOT_SET,
    ):
        with pytest.raises(UnrepresentableError):
            to_ros1(ros2)


def test_names_follow_the_rule():
    names = ParameterNames(rule("ros2", "/move_base/dwa", "/controller", prefix="FollowPath", names=["*", "deep/**"]))
    for remaining, ros1, ros2 in (
        ("x", "/move_base/dwa/x", "FollowPath.x"),
        ("deep/a/b", "/move_base/dwa/deep/a/b", "FollowPath.deep.a.b"),
    ):
        assert (names.ros1(remaining), names.ros2(remaining), names.rest(ros2)) == (ros1, ros2, remaining)
    assert [names.rest(other) for other in ("FollowPathX.x", "x", "FollowPath.a.b", "FollowPath.q/.x")] == [None] * 4
    item = ParameterNames(rule("ros2", "/speed", "/base", prefix="limits.speed"))
    assert (item.ros1(""), item.ros2(""), item.rest("limits.speed")) == ("/speed", "limits.speed", "")
    assert dict(flatten({"a": {"b": 1, "c": {}}, "d": [2]})) == {"a/b": 1, "d": [2]}
    assert dict(flatten(3)) == {"": 3}


@pytest.mark.parametrize(
    ("rules", "reason"),
    [
        ([{"ros1": "move_base"}], "write it as /move_base"),
        ([{"node": "controller"}], "write it as /controller_server"),
        ([{"prefix": "a/b"}], "write it as FollowPath"),
        ([{"owner": "yarp"}], "'ros1' or 'ros2'"),
        ([{}, {"ros1": "/b", "owner": "ros1"}], "give /n two owners"),
        ([{}, {"ros1": "/a/b", "node": "/m"}], "both share the parameters in /a/b"),
    ],
)
def test_an_invalid_rule_is_rejected(rules: list[dict[str, Any]], reason: str):
    whole = [{"ros1": "/a", "node": "/n", "owner": "ros2", **item} for item in rules]
    with pytest.raises(ValueError, match=reason):
        RoutingSection.model_validate({"parameters": whole})


def test_parameter_services_cross_for_nodes_in_a_rule():
    section = RoutingSection.model_validate({"parameters": [{"ros1": "/a", "node": "/ns/n", "owner": "ros2"}]})
    rules, kind = RuleSet(section), "rcl_interfaces/srv/GetParameters"
    assert rules.enter("ros2", "/ns/n/get_parameters", kind, "service").allowed
    assert not rules.enter("ros2", "/ns/other/get_parameters", kind, "service").allowed
    assert not rules.enter("ros2", "/ns/n/change_state", "lifecycle_msgs/srv/ChangeState", "service").allowed
    assert not rules.leave("ros2", "ros1", "/ns/n/get_parameters", kind, "service").allowed
    assert rules.leave("ros1", "ros2", "/ns/n/get_parameters", kind, "service").allowed
    event = "rcl_interfaces/msg/ParameterEvent"
    assert [rules.leave("ros1", side, "/parameter_events", event).allowed for side in ("ros2", "yarp")] == [True, False]
    denied = section.model_copy(update={"rules": (section.__class__.model_validate(
        {"rules": [{"topic": "/ns/**", "deny": True}]}
    ).rules)})  # fmt: skip
    assert not RuleSet(denied).enter("ros2", "/ns/n/get_parameters", kind, "service").allowed
