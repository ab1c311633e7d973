"""The priority class of a topic, by its rule or its names."""

from __future__ import annotations

import pytest

from bridge.routing.admission import TopicAdmission
from bridge.routing.counters import Counters
from bridge.routing.limits import Priority
from bridge.routing.rules import RoutePolicy
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
