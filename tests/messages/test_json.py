"""Conversion of messages to JSON and back."""

from __future__ import annotations

import base64
import json
import math
import struct
from typing import Any

import pytest

from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.json import CallCodec, from_json, to_json
from bridge.messages.registry import Registry
from tests.messages.samples import sample, standard_pairs


@pytest.mark.parametrize("name", standard_pairs())
def test_every_standard_type_goes_through_json(registry: Registry, name: str):
    cdr = from_json(registry, name, sample(registry.schema(name)))
    assert from_json(registry, name, json.loads(json.dumps(to_json(registry, name, cdr), allow_nan=False))) == cdr


def test_missing_fields_have_their_defaults(registry: Registry):
    pose = to_json(registry, "geometry_msgs/msg/Pose", from_json(registry, "geometry_msgs/msg/Pose", {}))
    assert pose["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def test_octets_are_base64_and_may_be_given_as_numbers(registry: Registry):
    name = "std_msgs/msg/UInt8MultiArray"
    cdr = from_json(registry, name, {"data": [1, 2, 255]})
    shown = to_json(registry, name, cdr)
    assert base64.b64decode(shown["data"]) == b"\1\2\xff"
    assert from_json(registry, name, shown) == cdr == from_json(registry, name, {"data": b"\1\2\xff"})


@pytest.mark.parametrize("name", ["std_msgs/msg/Float32", "std_msgs/msg/Float64"])
@pytest.mark.parametrize(("text", "number"), [("NaN", math.nan), ("Infinity", math.inf), ("-Infinity", -math.inf)])
def test_nan_and_infinities_are_texts(registry: Registry, name: str, text: str, number: float):
    cdr = from_json(registry, name, {"data": number})
    assert to_json(registry, name, cdr) == {"data": text}
    assert from_json(registry, name, {"data": text}) == cdr


def test_float32_shows_no_more_digits_than_it_has(registry: Registry):
    name = "std_msgs/msg/Float32MultiArray"
    cdr = from_json(registry, name, {"data": [0.1, 1e-7, 16777216]})
    assert to_json(registry, name, cdr)["data"] == [0.1, 1e-07, 16777216.0]


def test_text_beyond_ascii_survives_the_round_trip():
    registry = Registry()
    registry.learn_ros2("my_msgs/msg/Wide", "string s\nwstring w\nuint8 n\n")
    value = {"s": "Küche 😀", "w": "Küche 😀", "n": 3}
    assert to_json(registry, "my_msgs/msg/Wide", from_json(registry, "my_msgs/msg/Wide", value)) == value


SCAN = "sensor_msgs/msg/LaserScan"
BAD = [
    (SCAN, {"hedaer": {}}, "no field 'hedaer'; did you mean 'header'"),
    (SCAN, {"header": {"stmap": {}}}, "no field 'header.stmap'; did you mean 'stamp'"),
    (SCAN, {"header": 3}, "header must be an object"),
    (SCAN, {"ranges": 3}, "ranges must be a list"),
    (SCAN, {"ranges": [1, "x"]}, r"ranges\[1\] must be float32, not 'x'"),
    (SCAN, {"angle_min": True}, "angle_min must be float32"),
    (SCAN, {"angle_min": 1e300}, "angle_min must be float32"),
    (SCAN, [], "the message must be an object"),
    ("std_msgs/msg/Int8", {"data": 128}, "data must be int8, not 128"),
    ("std_msgs/msg/Int8", {"data": 1.5}, "data must be int8"),
    ("std_msgs/msg/Int8", {"data": None}, "data must be int8"),
    ("std_msgs/msg/Bool", {"data": 1}, "data must be bool"),
    ("std_msgs/msg/String", {"data": 5}, "data must be text"),
    ("std_msgs/msg/String", {"data": "\ud800"}, "cannot be encoded"),
    ("std_msgs/msg/UInt8MultiArray", {"data": "***"}, "not base64"),
    ("geometry_msgs/msg/PoseWithCovariance", {"covariance": [1.0]}, "covariance must have 36 elements, not 1"),
]


@pytest.mark.parametrize(("name", "value", "reason"), BAD)
def test_invalid_value_names_its_field(registry: Registry, name: str, value: Any, reason: str):
    with pytest.raises(ConversionError, match=reason):
        from_json(registry, name, value)


@pytest.mark.parametrize("value", [{"text": "toolong"}, {"numbers": [1, 2, 3]}, {"wide": "four"}])
def test_values_beyond_a_bound_are_refused(value: dict[str, Any]):
    registry = Registry()
    registry.learn_ros2("my_msgs/msg/Bounded", "string<=5 text\nint32[<=2] numbers\nwstring<=3 wide\n")
    with pytest.raises(ConversionError, match="at most"):
        from_json(registry, "my_msgs/msg/Bounded", value)


def test_bad_bytes_are_refused(registry: Registry):
    with pytest.raises(ConversionError, match="ends before"):
        to_json(registry, SCAN, b"\0\1\0\0" + struct.pack("<I", 5))
    with pytest.raises(MessageTypeError):
        to_json(registry, "nobody_msgs/msg/Knows", b"\0\1\0\0")


def test_trailing_bytes_of_rclpy_are_accepted(registry: Registry):
    cdr = from_json(registry, "std_msgs/msg/Bool", {"data": True})
    assert to_json(registry, "std_msgs/msg/Bool", cdr + b"\xff\xff\xff") == {"data": True}


def test_service_messages_survive_the_round_trip(registry: Registry):
    codec = CallCodec(registry, "nav_msgs/srv/LoadMap", registry.service_ros2("nav_msgs/srv/LoadMap").type_id)
    assert codec.request_value(codec.request({"map_url": "file:///a"})) == {"map_url": "file:///a"}
    values = codec.response_value(codec.response({"result": 3, "map": {"data": [1, -1]}}))
    assert (values["result"], values["map"]["data"]) == (3, [1, -1])
    with pytest.raises(ConversionError, match=r"nav_msgs/srv/LoadMap_Request has no field 'mapurl'; did you mean"):
        codec.request({"mapurl": ""})
    with pytest.raises(ConversionError):
        codec.response_value(codec.request({"map_url": "file:///a"}))
    goal = CallCodec(registry, "nav2_msgs/action/Spin_SendGoal")
    uuid = base64.b64encode(bytes(range(16))).decode()
    sent = goal.request_value(goal.request({"goal_id": {"uuid": uuid}, "goal": {"target_yaw": 1.5}}))
    assert (sent["goal_id"]["uuid"], sent["goal"]["target_yaw"]) == (uuid, 1.5)
