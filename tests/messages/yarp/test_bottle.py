"""The default content equals the output of yarpidl_rosmsg's code byte for byte; other Bottles are read, too."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from bridge.messages.yarp.bottle import BottleCodec
from tests.messages.samples import sample
from yarp_compat.wire import binary
from yarp_compat.wire.profile import Profile

REGISTRY = Registry()
TYPES = (
    "std_msgs/msg/String",
    "std_msgs/msg/Empty",
    "std_msgs/msg/UInt8MultiArray",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Path",
    "nav_msgs/msg/OccupancyGrid",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/CameraInfo",
    "tf2_msgs/msg/TFMessage",
    "diagnostic_msgs/msg/DiagnosticArray",
)


def codec(name: str, profile: Profile = Profile.YARP3) -> BottleCodec:
    return BottleCodec(REGISTRY, name, "", profile)


def payload(name: str, message: dict[str, Any], profile: Profile = Profile.YARP3) -> bytes:
    return b"".join(codec(name, profile).to_yarp(from_json(REGISTRY, name, message)).payload)


def words(*numbers: int) -> bytes:
    return struct.pack(f"<{len(numbers)}i", *numbers)


def test_a_laser_scan_is_encoded_byte_for_byte_as_by_yarp() -> None:
    """Messages are lists, with tags before fields and arrays of one type, as RosTypeCodeGenYarp.cpp writes them."""
    scan = {
        "header": {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": "ab"},
        "angle_min": 1.5,
        "ranges": [1.0, 2.0],
    }
    measured, zero = struct.pack("<if", 128, 1.5), struct.pack("<if", 128, 0.0)
    assert payload("sensor_msgs/msg/LaserScan", scan) == b"".join((
        words(256, 10),
        words(256, 3), words(1, 0), words(256, 2, 1, 5, 1, 7), words(4, 2), b"ab",
        measured, *(zero,) * 6,
        words(256 | 128, 2), struct.pack("<2f", 1.0, 2.0),
        words(256 | 128, 0),
    ))  # fmt: skip


def test_octets_and_arrays_of_fixed_length_are_encoded_as_lists() -> None:
    info = payload("sensor_msgs/msg/CameraInfo", {"k": [float(n) for n in range(9)]}, Profile.YARP4)
    assert words(256 | 20, 9) + struct.pack("<9d", *range(9)) in info
    array = payload("std_msgs/msg/UInt8MultiArray", {"data": [1, 255]})
    assert array == words(256, 2, 256, 2, 256, 0, 1, 0, 256 | 32, 2) + b"\x01\xff"


@pytest.mark.parametrize("profile", Profile)
@pytest.mark.parametrize("name", TYPES)
@pytest.mark.parametrize("length", [0, 2, 40])
def test_every_field_survives_the_round_trip(name: str, profile: Profile, length: int) -> None:
    cdr = from_json(REGISTRY, name, sample(REGISTRY.schema(name), length))
    known = codec(name, profile)
    bottle = b"".join(known.to_yarp(cdr).payload)
    assert known.to_hub(bottle, profile, None) == cdr
    values = binary.decode(bottle, profile)
    if not _has_empty_list(values):  # without empty lists, the profile does not matter
        assert known.to_hub(binary.encode(values, profile), profile, None) == cdr
    assert codec(name, _other(profile)).to_hub(bottle, profile, None) == cdr


def _other(profile: Profile) -> Profile:
    return Profile.YARP4 if profile is Profile.YARP3 else Profile.YARP3


def _has_empty_list(values: list[Any]) -> bool:
    return any(isinstance(v, list) and (not v or _has_empty_list(v)) for v in values)


@settings(max_examples=100)
@given(
    st.sampled_from(list(Profile)),
    st.lists(st.tuples(st.text(st.characters(exclude_characters="\0", codec="utf-8")), st.floats(width=64))),
    st.integers(-(2**31), 2**31 - 1),
    st.integers(0, 999_999_999),
)
def test_any_joint_state_survives_the_round_trip(
    profile: Profile, joints: list[tuple[str, float]], sec: int, nanosec: int
) -> None:
    value = {
        "header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "é"},
        "name": [name for name, _ in joints],
        "position": [_json(position) for _, position in joints],
    }
    name = "sensor_msgs/msg/JointState"
    cdr = from_json(REGISTRY, name, value)
    known = codec(name, profile)
    out = known.to_yarp(cdr)
    assert out.stamp_ns == ((sec * 10**9 + nanosec) or None)
    assert to_json(REGISTRY, name, known.to_hub(b"".join(out.payload), profile, None)) == to_json(REGISTRY, name, cdr)


def _json(number: float) -> Any:
    return number if abs(number) < float("inf") else str(number)


@given(st.binary(max_size=200), st.sampled_from([None, *Profile]))
def test_any_bytes_are_refused_or_are_a_message(junk: bytes, profile: Profile | None) -> None:
    known = codec("tf2_msgs/msg/TFMessage")
    try:
        cdr = known.to_hub(junk, profile, None)
    except ConversionError:
        return
    assert to_json(REGISTRY, "tf2_msgs/msg/TFMessage", cdr)


@given(st.data())
def test_a_bottle_with_a_changed_byte_is_refused_or_converts(data: st.DataObject) -> None:
    whole = payload("nav_msgs/msg/Path", sample(REGISTRY.schema("nav_msgs/msg/Path"), 3))
    at = data.draw(st.integers(0, len(whole) - 1))
    changed = whole[:at] + data.draw(st.binary(min_size=0, max_size=3)) + whole[at + 1 :]
    try:
        cdr = codec("nav_msgs/msg/Path").to_hub(changed, None, None)
    except ConversionError:
        return
    assert to_json(REGISTRY, "nav_msgs/msg/Path", cdr)


def test_handwritten_bottle_is_accepted() -> None:
    """``yarp write`` sends ``(1 0 0)`` in the line ``(1 0 0) (0 0 0.5)`` as a list of one type, integers."""
    twist = codec("geometry_msgs/msg/Twist").to_hub(binary.encode([[1, 0, 0], [0, 0, 0.5]], Profile.YARP3), None, None)
    assert to_json(REGISTRY, "geometry_msgs/msg/Twist", twist)["linear"] == {"x": 1.0, "y": 0.0, "z": 0.0}
    hello = codec("std_msgs/msg/String").to_hub(binary.encode(["hello"], Profile.YARP4), Profile.YARP4, None)
    assert to_json(REGISTRY, "std_msgs/msg/String", hello) == {"data": "hello"}


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ([[1, 0], [0, 0, 0]], r"linear has 2 values, but geometry_msgs/Vector3 has 3 fields \(x y z\): 1 0"),
        ([[1, 0, 0]], "the Bottle has 1 values"),
        ([[1, "a", 0], [0, 0, 0]], "linear.y must be float64, not 'a'"),
        ([5, [0, 0, 0]], "linear must be a list of the fields of geometry_msgs/Vector3, not 5"),
    ],
)
def test_a_wrong_bottle_is_refused_with_its_field(values: list[Any], error: str) -> None:
    with pytest.raises(ConversionError, match=error):
        codec("geometry_msgs/msg/Twist").to_hub(binary.encode(values, Profile.YARP3), None, None)


def test_numbers_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ConversionError, match="data must be int16, not 70000"):
        codec("std_msgs/msg/Int16").to_hub(binary.encode([70000], Profile.YARP3), None, None)
    unsigned = codec("std_msgs/msg/UInt16").to_hub(binary.encode([-1], Profile.YARP3), None, None)
    assert to_json(REGISTRY, "std_msgs/msg/UInt16", unsigned) == {"data": 65535}


def test_the_envelope_stamps_a_header_that_has_no_time() -> None:
    name = "geometry_msgs/msg/PoseStamped"
    known = codec(name)
    bare = b"".join(known.to_yarp(from_json(REGISTRY, name, {})).payload)
    stamped = to_json(REGISTRY, name, known.to_hub(bare, None, 3_000_000_004))
    assert stamped["header"]["stamp"] == {"sec": 3, "nanosec": 4}
    timed = from_json(REGISTRY, name, {"header": {"stamp": {"sec": 1}}})
    assert known.to_hub(b"".join(known.to_yarp(timed).payload), None, 3_000_000_004) == timed


def test_values_without_a_yarp_form_are_reported() -> None:
    registry = Registry()
    registry.learn_ros2("y_msgs/msg/Wide", "wstring data")
    with pytest.raises(MessageTypeError, match="wstring"):
        BottleCodec(registry, "y_msgs/msg/Wide", "", Profile.YARP3)


@pytest.mark.parametrize(("shape", "count"), [("[]", 1), ("[]", 0), ("[2]", 2), ("[<=3]", 2)])
def test_a_list_of_headers_at_the_beginning_is_not_the_messages_stamp(shape: str, count: int) -> None:
    registry = Registry()
    name = "y_msgs/msg/Headers"
    registry.learn_ros2(name, f"std_msgs/Header{shape} headers")
    known = BottleCodec(registry, name, "", Profile.YARP3)
    cdr = from_json(registry, name, {"headers": [{"frame_id": "map"}] * count})
    message = known.to_yarp(cdr)
    assert message.stamp_ns is None
    assert known.to_hub(b"".join(message.payload), Profile.YARP3, 3_000_000_004) == cdr


def test_a_double_beyond_float32_in_a_list_is_refused_with_its_index() -> None:
    name = "sensor_msgs/msg/LaserScan"
    empty = codec(name).to_hub(payload(name, {}), None, None)
    scan = binary.decode(b"".join(codec(name).to_yarp(empty).payload), Profile.YARP3)
    allowed = [*scan[:8], [1.5, math.inf, math.nan, 3.0e38], *scan[9:]]
    result = codec(name).to_hub(binary.encode(allowed, Profile.YARP4), Profile.YARP4, None)
    assert to_json(REGISTRY, name, result)["ranges"][1:3] == ["Infinity", "NaN"]
    wrong = [*scan[:8], [1.5, math.inf, -1e39], *scan[9:]]
    with pytest.raises(ConversionError, match=r"ranges\[2\] must be float32, not -1e\+39"):
        codec(name).to_hub(binary.encode(wrong, Profile.YARP4), Profile.YARP4, None)
