"""Short Bottles of chosen fields, converted in both directions."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.messages.yarp.fields import BottleEntry, FieldsCodec
from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile

REGISTRY = Registry()
TWIST = "geometry_msgs/msg/Twist"


def codec(name: str, *entries: float | str, profile: Profile = Profile.YARP3, frame: str = "") -> FieldsCodec:
    return FieldsCodec(REGISTRY.schema(name), [BottleEntry.parse(entry) for entry in entries], profile, frame)


def out(known: FieldsCodec, name: str, message: dict[str, Any]) -> list[Any]:
    return binary.decode(b"".join(known.to_yarp(from_json(REGISTRY, name, message)).payload))


def back(known: FieldsCodec, name: str, values: list[Any], stamp_ns: int | None = None) -> dict[str, Any]:
    payload = binary.encode(values, Profile.YARP3)
    return to_json(REGISTRY, name, known.to_hub(payload, None, stamp_ns))


numbers = st.floats(-1e6, 1e6)


@given(st.sampled_from(list(Profile)), numbers, numbers, numbers)
def test_a_velocity_survives_the_round_trip_through_its_short_bottle(
    profile: Profile, x: float, y: float, turn: float
) -> None:
    known = codec(TWIST, "linear.x", "linear.y", "angular.z", profile=profile)
    cdr = from_json(REGISTRY, TWIST, {"linear": {"x": x, "y": y}, "angular": {"z": turn}})
    payload = b"".join(known.to_yarp(cdr).payload)
    assert binary.decode(payload, profile) == [x, y, turn]
    assert known.to_hub(payload, profile, None) == cdr


def test_constants_and_degrees_form_a_command_of_robot_goto() -> None:
    """``(3 vx vy vtheta gain)``, as the modules of robotology/navigation send it."""
    known = codec(TWIST, 3, "linear.x", "linear.y", "deg(angular.z)", 100.0)
    message = {"linear": {"x": 0.5}, "angular": {"z": math.pi}}
    assert out(known, TWIST, message) == [3, 0.5, 0.0, pytest.approx(180.0), 100.0]
    assert back(known, TWIST, [3, 0.5, 0, 90, 100])["angular"]["z"] == pytest.approx(math.pi / 2)
    with pytest.raises(ConversionError, match=r"a value of the Bottle is 2, but the rule requires 3"):
        back(known, TWIST, [2, 0.0, 0.5, 90.0, 100.0])


def test_a_bottle_of_integers_only_is_accepted() -> None:
    """YARP sends ``0 0 0``, with which a person stops a robot, as a list of integers."""
    known = codec(TWIST, "linear.x", "linear.y", "deg(angular.z)")
    assert back(known, TWIST, [0, 0, 0]) == back(known, TWIST, [0.0, 0.0, 0.0])
    assert back(known, TWIST, [1, 2, 180])["angular"]["z"] == pytest.approx(math.pi)
    command = codec(TWIST, 3, "linear.x", "linear.y", "deg(angular.z)", 100.0)
    assert back(command, TWIST, [3, 0, 0, 0, 100]) == back(known, TWIST, [0, 0, 0])
    assert back(codec("std_msgs/msg/ColorRGBA", "r", "g"), "std_msgs/msg/ColorRGBA", [1, 0])["r"] == 1.0
    assert back(codec("std_msgs/msg/Int64", "data"), "std_msgs/msg/Int64", [1 << 40]) == {"data": 1 << 40}
    assert back(codec("std_msgs/msg/Bool", "data"), "std_msgs/msg/Bool", [1]) == {"data": True}


def test_times_texts_arrays_and_elements_become_values_of_the_bottle() -> None:
    name = "sensor_msgs/msg/JointState"
    known = codec(name, "header.stamp", "name", "position", "velocity[1]", "'end'")
    message = {
        "header": {"stamp": {"sec": 2, "nanosec": 500_000_000}},
        "name": ["a", "b"],
        "position": [1.0, 2.0],
        "velocity": [3.0, 4.0],
    }
    assert out(known, name, message) == [2.5, ["a", "b"], [1.0, 2.0], 4.0, "end"]
    whole = codec(name, "header.stamp", "name", "position")
    got = back(whole, name, [2.5, ["a", "b"], [1, 2]])
    assert (got["header"]["stamp"], got["name"], got["position"]) == (
        {"sec": 2, "nanosec": 500_000_000}, ["a", "b"], [1.0, 2.0],
    )  # fmt: skip
    with pytest.raises(ConversionError, match=r"velocity\[1\]: the message's array has 0 elements"):
        out(codec(name, "velocity[1]"), name, {})


def test_a_header_gets_the_envelopes_time_and_the_rules_frame() -> None:
    name = "geometry_msgs/msg/PointStamped"
    known = codec(name, "point.x", frame="map")
    assert back(known, name, [1.0], 7_000_000_008)["header"] == {
        "stamp": {"sec": 7, "nanosec": 8}, "frame_id": "map",
    }  # fmt: skip
    stamped = from_json(REGISTRY, name, {"header": {"stamp": {"sec": 3, "nanosec": 4}}})
    assert known.to_yarp(stamped).stamp_ns == 3_000_000_004


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ([1.0, 2.0], r"the Bottle has 2 values, not the 3 of \(linear.x linear.y angular.z\): 1.0 2.0"),
        ([1.0, "fast", 0.0], "linear.y must be float64, not 'fast'"),
        ([1.0, [2.0], 0.0], "linear.y must be float64"),
        ([1.0, True, 0.0], "linear.y must be float64, not True"),
    ],
)
def test_a_wrong_bottle_is_refused(values: list[Any], error: str) -> None:
    with pytest.raises(ConversionError, match=error):
        back(codec(TWIST, "linear.x", "linear.y", "angular.z"), TWIST, values)


@pytest.mark.parametrize("value", [1e300, math.inf, math.nan, -1e12, True, "now"])
def test_an_invalid_time_is_refused(value: Any) -> None:
    with pytest.raises(ConversionError, match=r"header\.stamp must be a time in seconds"):
        back(codec("sensor_msgs/msg/JointState", "header.stamp"), "sensor_msgs/msg/JointState", [value])


def test_a_list_in_place_of_a_constant_is_refused() -> None:
    with pytest.raises(ConversionError, match="but the rule requires 3"):
        back(codec(TWIST, 3, "linear.x"), TWIST, [[1.0, 2.0], 1.0])


@given(st.binary(max_size=100))
def test_any_bytes_are_rejected_or_accepted(junk: bytes) -> None:
    known = codec("sensor_msgs/msg/JointState", "name", "position", "header.stamp")
    try:
        cdr = known.to_hub(junk, None, None)
    except ConversionError:
        return
    assert to_json(REGISTRY, "sensor_msgs/msg/JointState", cdr)


@pytest.mark.parametrize(
    ("entry", "error"),
    [
        ("linear.w", "has no field 'w'"),
        ("linear", "is a whole geometry_msgs/msg/Vector3"),
        ("linear.x.y", "has no fields"),
        ("linear.x[0]", "no such element"),
    ],
)
def test_entries_of_missing_fields_are_rejected(entry: str, error: str) -> None:
    with pytest.raises(MessageTypeError, match=error):
        codec(TWIST, entry)


@pytest.mark.parametrize("entry", ["", "linear..x", "rad(linear.x)", "deg(linear.x", "'a", "a b"])
def test_invalid_entries_are_rejected(entry: str) -> None:
    with pytest.raises(ValueError, match="is not a field"):
        BottleEntry.parse(entry)


def test_the_envelope_stamps_a_header_of_any_name() -> None:
    registry = Registry()
    name = "y_msgs/msg/Reading"
    registry.learn_ros2(name, "std_msgs/Header h\nfloat64 value")
    known = FieldsCodec(registry.schema(name), [BottleEntry.parse("value")], Profile.YARP3, "lab")
    message = to_json(registry, name, known.to_hub(binary.encode([1.5], Profile.YARP3), None, 3_000_000_004))
    assert message == {"h": {"stamp": {"sec": 3, "nanosec": 4}, "frame_id": "lab"}, "value": 1.5}


def test_a_double_beyond_float32_is_refused_in_lists_as_elsewhere() -> None:
    name = "sensor_msgs/msg/LaserScan"
    with pytest.raises(ConversionError, match=r"range_max must be float32, not 1e\+39"):
        back(codec(name, "range_max"), name, [1e39])
    with pytest.raises(ConversionError, match=r"ranges\[1\] must be float32, not 1e\+39"):
        back(codec(name, "ranges"), name, [[math.inf, 1e39]])
