"""The priority class of a topic, by its rule or its names."""

from __future__ import annotations

import pytest

from bridge.config.sections.routing import RoutingSection
from bridge.routing.admission import TopicAdmission
from bridge.routing.counters import Counters
from bridge.routing.limits import Priority
from bridge.routing.rules import RoutePolicy, RuleSet
from bridge.routing.stall import StallDetector

TWIST = "geometry_msgs/msg/Twist"


@pytest.mark.parametrize(
    ("topics", "type_name", "rule", "latched", "expected"),
    [
        (("/teleop/twist", "/cmd_vel"), TWIST, None, False, Priority.COMMAND),
        (("/cmd_vel", "/base/twist"), TWIST, None, False, Priority.COMMAND),
        (("/teleop/twist", "/cmd_vel"), TWIST, None, True, Priority.COMMAND),
        (("/teleop/twist", "/base/twist"), TWIST, None, False, Priority.STREAM),
        (("/teleop/text", "/cmd_vel"), "std_msgs/msg/String", None, True, Priority.STATE),
        (("/teleop/twist", "/cmd_vel"), TWIST, "stream", False, Priority.STREAM),
        (("/cmd_vel",), TWIST, None, False, Priority.COMMAND),
    ],
)
def test_a_renamed_topic_carries_commands_if_either_name_implies_it(
    topics: tuple[str, ...], type_name: str, rule: str | None, latched: bool, expected: Priority
) -> None:
    policy = RoutePolicy(allowed=True, why="", name=topics[-1], priority=rule)
    admission = TopicAdmission(topics, type_name, policy, Counters(), StallDetector())
    assert admission.priority_of(latched=latched) is expected


FLOAT = "std_msgs/msg/Float64"


@pytest.mark.parametrize(
    ("topic", "type_name", "latched", "expected"),
    [
        ("/teleop/twist", TWIST, False, Priority.COMMAND),
        ("/teleop/twist", TWIST, True, Priority.COMMAND),
        ("/teleop/twist", FLOAT, False, Priority.STREAM),
        ("/wheels", FLOAT, False, Priority.COMMAND),
        ("/steering", FLOAT, False, Priority.COMMAND),
        ("/arm/cmd_vel", TWIST, False, Priority.STREAM),
        ("/cmd_vel", TWIST, False, Priority.COMMAND),
        ("/map", "nav_msgs/msg/OccupancyGrid", True, Priority.STATE),
    ],
)
def test_a_program_on_the_hub_sends_commands_if_they_are_commands_on_a_side(
    topic: str, type_name: str, latched: bool, expected: Priority
) -> None:
    rules = [
        {"topic": "/teleop/twist", "to": "ros1", "rename": "/cmd_vel"},
        {"topic": "/wheels", "priority": "command"},
        {"topic": "/steering", "to": "ros2", "priority": "command"},
        {"topic": "/arm/cmd_vel", "priority": "stream"},
    ]
    rule_set = RuleSet(RoutingSection.model_validate({"rules": rules}))
    assert rule_set.native_class(topic, type_name, latched=latched) is expected
