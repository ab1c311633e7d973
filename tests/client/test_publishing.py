"""Publishers of client programs."""

from __future__ import annotations

from typing import Any
from unittest.mock import MagicMock

import pytest

from bridge.client.publishing import Publisher
from bridge.config.model import Config


@pytest.mark.parametrize(
    ("topic", "type_name", "asked", "priority"),
    [
        ("/teleop/twist", "geometry_msgs/msg/Twist", "", "command"),
        ("/base/twist", "geometry_msgs/msg/Twist", "", "stream"),
        ("/steering", "std_msgs/msg/Float64", "", "command"),
        ("/base/twist", "geometry_msgs/msg/Twist", "command", "command"),
    ],
)
def test_messages_that_a_rule_makes_commands_have_their_priority(
    topic: str, type_name: str, asked: str, priority: str
) -> None:
    rules = [
        {"topic": "/teleop/twist", "to": "ros1", "rename": "/cmd_vel"},
        {"topic": "/steering", "priority": "command"},
    ]
    client: Any = MagicMock(config=Config.model_validate({"routing": {"rules": rules}}))
    types: Any = MagicMock()
    types.name.return_value = type_name
    Publisher(client, types, topic, type_name, priority=asked)
    assert client.hub.publisher.call_args.kwargs == {"priority": priority}
