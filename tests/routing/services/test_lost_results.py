"""The reply to a hub client whose get_result call failed: the goal may still be executing."""

from __future__ import annotations

import pytest

from bridge.messages.actions import GoalState
from bridge.messages.registry import Registry
from bridge.messages.services import unknown_result
from bridge.messages.values import MessageReader


@pytest.mark.parametrize(
    ("action", "result"),
    [
        ("nav2_msgs/action/NavigateToPose", {"error_code": 0, "error_msg": "the bridge stood still"}),
        ("nav2_msgs/action/Wait", {"total_elapsed_time": {"sec": 0, "nanosec": 0}}),
    ],
)
def test_lost_result_is_unknown_with_its_reason(action: str, result: dict[str, object]) -> None:
    registry, name = Registry(), f"{action}_GetResult"
    _, response = registry.service_schemas(name)
    reply = MessageReader(response, unknown_result(registry, name)("the bridge stood still")).message()
    assert reply["status"] == GoalState.UNKNOWN
    assert {key: reply["result"][key] for key in result} == result
