"""Publishers of client programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from unittest.mock import MagicMock

import pytest

from bridge.client.errors import ClientError
from bridge.client.publishing import Publisher
from bridge.config.model import Config
from bridge.hub.wire.qos import LATCHED


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


@pytest.mark.parametrize(
    ("rules", "asked"), [((), ""), (({"topic": "/go", "priority": "command"},), ""), ((), "command")]
)
def test_commands_are_never_latched(rules: Sequence[dict[str, Any]], asked: str) -> None:
    topic = "/go" if rules or asked else "/robot/cmd_vel"
    client: Any = MagicMock(config=Config.model_validate({"routing": {"rules": rules}}))
    types: Any = MagicMock()
    types.name.return_value = "geometry_msgs/msg/Twist"
    with pytest.raises(ClientError, match=f"the messages on {topic} are commands, which are never latched"):
        Publisher(client, types, topic, "geometry_msgs/Twist", LATCHED, priority=asked)
    assert not client.hub.publisher.called
