"""Conversion programs for tests, with messages for them."""

from __future__ import annotations

import random

from bridge.messages.json import from_json
from bridge.messages.mapping.fields import pair_types
from bridge.messages.mapping.rules import Rules
from bridge.messages.registry import Registry
from bridge.messages.transcode.compiler import compile_check, compile_pair
from bridge.messages.transcode.program import ConversionProgram
from tests.messages.samples import sample

TYPES = [
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/JointState",
    "diagnostic_msgs/msg/DiagnosticArray",
    "visualization_msgs/msg/MarkerArray",
    "rcl_interfaces/msg/Log",
    "rcl_interfaces/msg/ParameterEvent",
    "std_msgs/msg/Bool",
]


def programs(registry: Registry, name: str) -> list[tuple[ConversionProgram, bytes]]:
    """Return the three programs of a type, each with a valid message."""
    rules = Rules()
    ros2 = registry.schema(name)
    back = registry.hub_to_ros1(name)
    ros1 = registry.ros1_schema(back.target.name, back.target.type_id)
    table = pair_types(ros1, ros2, rules)
    cdr = from_json(registry, name, sample(ros2))
    assert back.convert is not None
    return [
        (compile_check(ros2), cdr),
        (
            compile_pair(
                ros2,
                ros1,
                lambda a, b: [(target_field, source_field) for source_field, target_field in table[b, a].fields],
            ),
            cdr,
        ),
        (compile_pair(ros1, ros2, lambda a, b: table[a, b].fields), back.convert(cdr)),
    ]


def damaged(good: bytes, dice: random.Random) -> bytes:
    """Return the message, cut short or with some words changed."""
    content = bytearray(good)
    for _ in range(dice.randint(0, 3)):
        if len(content) >= 4:
            at = dice.randrange(len(content) - 3)
            value = dice.choice([0, 1, 2, dice.randrange(64), dice.randrange(2**32), 2**32 - 1, 2**31])
            content[at : at + 4] = value.to_bytes(4, "little")
    return bytes(content[: dice.randint(0, len(content))] if dice.random() < 0.5 else content)
