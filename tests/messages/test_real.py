"""Conversions agree with genpy and rclpy byte for byte, for every installed type."""

from __future__ import annotations

import base64
import sys
from pathlib import Path

import pytest

from bridge.messages.definitions.schema import Schema, Shape
from bridge.messages.errors import MessageTypeError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from tests.messages.samples import genpy_types, sample
from tests.peers.codecs import base64_text, genpy, needs_genpy, rclpy

LENGTHS = (0, 1, 2, 3)
RENAMED = {"std_msgs/Time", "std_msgs/Duration", "rosgraph_msgs/Log"}


def ros2_names() -> list[str]:
    share = Path(sys.prefix) / "share"
    return sorted(f"{path.parts[-3]}/msg/{path.stem}" for path in share.glob("*/msg/*.msg"))


@needs_genpy
def test_ros1_bytes_are_those_of_genpy(registry: Registry):
    """CDR converted to ROS 1 equals genpy's output byte for byte, and is converted back to the same CDR."""
    items, cdrs = [], []
    for name in sorted({*genpy_types(), *convertible_ros2_types(registry)} - RENAMED):
        to_ros1 = registry.hub_to_ros1(registry.ros1_to_hub(name).target.name)
        assert to_ros1.target.name == name
        for length in LENGTHS:
            values = sample(registry.schema(to_ros1.source.name), length)
            cdrs.append(from_json(registry, to_ros1.source.name, values))
            items.append(
                {
                    "type": name,
                    "definition": to_ros1.target.definition,
                    "values": values,
                    "ros1": base64_text(to_ros1.convert(cdrs[-1])),
                }
            )
    assert len({item["type"] for item in items}) > 150
    for item, cdr, answer in zip(items, cdrs, genpy(items), strict=True):
        name = item["type"]
        assert "error" not in answer, (name, answer)
        back = registry.ros1_to_hub(name)
        assert answer["md5"] == back.source.type_id, name
        assert answer["bytes"] == item["ros1"], name
        assert answer["same"], name
        if not has_ros2_only_fields(registry, back.target.name, name):
            assert back.convert(base64.b64decode(answer["bytes"])) == cdr, name


def convertible_ros2_types(registry: Registry) -> list[str]:
    """Return the ROS 1 name of each installed ROS 2 type; types with wstring must be refused."""
    names = []
    for name in ros2_names():
        if has_wstring(registry, name):
            with pytest.raises(MessageTypeError, match="wstring"):
                registry.hub_to_ros1(name)
        else:
            names.append(registry.hub_to_ros1(name).target.name)
    return names


def has_ros2_only_fields(registry: Registry, ros2_name: str, ros1_name: str) -> bool:
    """Return whether the ROS 2 type has fields that the ROS 1 type lacks."""

    def fields(schema: Schema, name: str, expand: bool) -> set[str]:
        names = set()
        for field in schema.types[name].fields:
            names.add(field.name.lower())
            if expand and field.type.nested and not field.type.base.startswith("builtin_interfaces/"):
                inner = fields(schema, field.type.base, expand)
                names |= {f"{field.name.lower()}.{inner_name}" for inner_name in inner}
        return names

    ros1 = registry.ros1_schema(ros1_name)
    return bool(fields(registry.schema(ros2_name), ros2_name, True) - fields(ros1, ros1_name, True))


@needs_genpy
@pytest.mark.parametrize("name", ["std_msgs/Time", "std_msgs/Duration"])
def test_time_messages_keep_their_ros1_name_and_value(name: str, registry: Registry):
    conversion = registry.ros1_to_hub(name)
    cdr = conversion.convert(b"\1\0\0\0\2\0\0\0")
    assert to_json(registry, conversion.target.name, cdr) == {"sec": 1, "nanosec": 2}
    back = registry.hub_to_ros1(conversion.target.name)
    assert back.target.name == name
    assert back.convert(cdr) == b"\1\0\0\0\2\0\0\0"


def test_log_messages_cross_to_ros1_and_back(registry: Registry):
    conversion = registry.hub_to_ros1("rcl_interfaces/msg/Log")
    assert conversion.target.name == "rosgraph_msgs/Log"
    values = sample(registry.schema("rcl_interfaces/msg/Log"))
    back = registry.ros1_to_hub("rosgraph_msgs/Log")
    ros1 = conversion.convert(from_json(registry, "rcl_interfaces/msg/Log", values))
    assert to_json(registry, "rcl_interfaces/msg/Log", back.convert(ros1)) == values


def test_cdr_bytes_are_those_of_rclpy(registry: Registry):
    """Rclpy can read our CDR, and CDR from rclpy (without trailing padding) is accepted and has the same values."""
    items = []
    for name in ros2_names():
        for length in LENGTHS:
            values = sample(registry.schema(name), length)
            items.append({"type": name, "values": values, "cdr": base64_text(from_json(registry, name, values))})
    answers = rclpy(items)
    checked = 0
    for item, answer in zip(items, answers, strict=True):
        name = item["type"]
        if answer.get("missing"):
            continue
        assert "error" not in answer, (name, answer)
        assert answer["same"], name
        ours = base64.b64decode(item["cdr"])
        theirs = registry.hub_check(name)(base64.b64decode(answer["bytes"]))
        assert len(theirs) == len(ours), name
        assert to_json(registry, name, theirs) == to_json(registry, name, ours), name
        if has_wstring(registry, name):
            continue
        ros1 = registry.hub_to_ros1(name)
        assert ros1.convert(base64.b64decode(answer["bytes"])) == ros1.convert(ours), name
        checked += 1
    assert checked > 400


def has_wstring(registry: Registry, name: str) -> bool:
    return any(f.type.base == "wstring" for d in registry.schema(name).types.values() for f in d.fields)


def test_samples_are_distinct(registry: Registry):
    values = sample(registry.schema("sensor_msgs/msg/CameraInfo"))
    assert len(set(values["p"])) == 12
    kinds = {field.type.shape for field in registry.schema("sensor_msgs/msg/CameraInfo").root.fields}
    assert kinds == {Shape.SINGLE, Shape.ARRAY, Shape.SEQUENCE}
