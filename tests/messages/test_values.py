"""Missing fields have their default values, wherever the text before them ends."""

from __future__ import annotations

from typing import Any

import pytest

from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter

MARKER = "visualization_msgs/msg/Marker"


@pytest.mark.parametrize("type_name", [MARKER, "sensor_msgs/msg/JointState", "rcl_interfaces/msg/ParameterDescriptor"])
def test_kept_defaults_are_the_same_as_written_ones(type_name: str) -> None:
    schema = Registry().schema(type_name)
    first = next(field.name for field in schema.root.fields)
    for length in [*range(9), *range(9)]:
        message: dict[str, Any] = {"header": {"frame_id": length * "f"}} if first == "header" else {first: length * "f"}
        fresh = Registry().schema(type_name)
        assert not fresh.defaults
        assert MessageWriter(schema).message(message) == MessageWriter(fresh).message(message)
    assert schema.defaults


def test_defaults_of_the_definition_are_written() -> None:
    schema = Registry().schema("geometry_msgs/msg/Pose")
    for _ in range(2):
        pose = MessageReader(schema, MessageWriter(schema).message({})).message()
        assert pose["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
