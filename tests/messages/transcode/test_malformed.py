"""All invalid bytes raise a ConversionError."""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.messages.errors import ConversionError
from bridge.messages.json import from_json, to_json
from bridge.messages.registry import Registry
from tests.messages.samples import sample

REGISTRY = Registry()
TYPES = [
    "std_msgs/msg/String",
    "std_msgs/msg/Empty",
    "std_msgs/msg/Bool",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/JointState",
    "diagnostic_msgs/msg/DiagnosticArray",
    "visualization_msgs/msg/MarkerArray",
    "std_msgs/msg/Float64MultiArray",
    "rcl_interfaces/msg/ParameterEvent",
]
FUZZ = settings(max_examples=60)


def converters(name: str) -> dict[str, tuple[Callable[[bytes], bytes], bytes]]:
    """Return each direction's converter and a valid message for it."""
    cdr = from_json(REGISTRY, name, sample(REGISTRY.schema(name)))
    to_ros1 = REGISTRY.hub_to_ros1(name)
    to_cdr = REGISTRY.ros1_to_hub(to_ros1.target.name, to_ros1.target.type_id)
    assert to_ros1.convert is not None
    assert to_cdr.convert is not None
    return {
        "to ROS 1": (to_ros1.convert, cdr),
        "to CDR": (to_cdr.convert, to_ros1.convert(cdr)),
        "check": (REGISTRY.hub_check(name), cdr),
    }


CASES = {(name, direction): pair for name in TYPES for direction, pair in converters(name).items()}
each_case = pytest.mark.parametrize("case", CASES, ids=" ".join)


@each_case
def test_every_truncation_is_refused(case: tuple[str, str]):
    convert, good = CASES[case]
    for end in range(len(good)):
        with pytest.raises(ConversionError):
            convert(good[:end])


@each_case
@FUZZ
@given(data=st.data())
def test_any_changed_word_is_refused_or_converts(case: tuple[str, str], data: st.DataObject):
    convert, good = CASES[case]
    if len(good) < 4:
        return
    at = data.draw(st.integers(0, len(good) - 4))
    value = data.draw(st.sampled_from([0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF]) | st.integers(0, 2**32 - 1))
    assert_refused_or_converted(convert, good[:at] + struct.pack("<I", value) + good[at + 4 :])


@each_case
@FUZZ
@given(noise=st.binary(max_size=400))
def test_noise_is_refused_or_converts(case: tuple[str, str], noise: bytes):
    convert, _ = CASES[case]
    assert_refused_or_converted(convert, noise)
    assert_refused_or_converted(convert, b"\0\1\0\0" + noise)


def assert_refused_or_converted(convert: Callable[[bytes], bytes], message: bytes) -> None:
    """Check that the message is converted, or refused with an error that names the position."""
    try:
        outcome: bytes | ConversionError = convert(message)
    except ConversionError as err:
        outcome = err
    assert isinstance(outcome, bytes) or "byte" in str(outcome)


@pytest.mark.parametrize("name", TYPES)
def test_round_trip_keeps_the_message(name: str):
    convert, good = CASES[name, "to CDR"]
    to_ros1, cdr = CASES[name, "to ROS 1"]
    assert to_ros1(from_json(REGISTRY, name, to_json(REGISTRY, name, convert(good)))) == to_ros1(cdr)


@pytest.mark.parametrize("count", [3, 0x10000000, 0x7FFFFFFF, 0xFFFFFFFF])
@pytest.mark.parametrize(
    "name",
    ["tf2_msgs/TFMessage", "std_msgs/String", "nav_msgs/Path", "geometry_msgs/Polygon", "sensor_msgs/JointState"],
)
def test_huge_counts_are_refused_at_once(name: str, count: int):
    convert = REGISTRY.ros1_to_hub(name).convert
    assert convert is not None
    header = b"" if name in ("tf2_msgs/TFMessage", "std_msgs/String", "geometry_msgs/Polygon") else bytes(16)
    with pytest.raises(ConversionError, match=rf"\(field [a-z]+(\[\])?, byte {len(header)}\)"):
        convert(header + struct.pack("<I", count))


def test_the_error_names_type_field_and_byte():
    convert, good = CASES["tf2_msgs/msg/TFMessage", "to CDR"]
    broken = bytearray(good)
    broken[16:20] = struct.pack("<I", 10_000)
    with pytest.raises(ConversionError) as caught:
        convert(bytes(broken))
    assert "tf2_msgs/TFMessage" in str(caught.value)
    assert "transforms[].header.frame_id" in str(caught.value)
    assert "byte 16" in str(caught.value)


def test_trailing_bytes_in_ros1_are_refused():
    convert, good = CASES["std_msgs/msg/String", "to CDR"]
    with pytest.raises(ConversionError, match="left over"):
        convert(good + b"\0")


@pytest.mark.parametrize("head", [b"\0\0\0\0", b"\0\3\0\0", b"\0\7\0\0", b"\1\1\0\0"])
@pytest.mark.parametrize("direction", ["to ROS 1", "check"])
def test_other_encapsulations_are_refused(head: bytes, direction: str):
    convert, good = CASES["std_msgs/msg/String", direction]
    with pytest.raises(ConversionError, match="little-endian CDR"):
        convert(head + good[4:])


def test_slack_is_trimmed_but_further_bytes_are_refused():
    check, good = CASES["sensor_msgs/msg/JointState", "check"]
    assert check(good) is good
    assert check(good + b"\xff\xff\xff") == good
    with pytest.raises(ConversionError, match="left over"):
        check(good + bytes(8))


def test_slack_of_empty_sequences_is_trimmed():
    """Rclpy leaves space for the padding before the missing elements."""
    name = "sensor_msgs/msg/JointState"
    good = from_json(REGISTRY, name, {"name": ["a"], "position": [1.0]})
    assert REGISTRY.hub_check(name)(good + bytes(8)) == good


def test_messages_are_normalized():
    check = REGISTRY.hub_check("std_msgs/msg/Bool")
    assert check(b"\0\1\0\0\5") == b"\0\1\0\0\1"
    text = REGISTRY.hub_check("std_msgs/msg/String")
    assert text(b"\0\1\0\0\0\0\0\0") == b"\0\1\0\0\1\0\0\0\0"
    to_ros1 = REGISTRY.hub_to_ros1("std_msgs/msg/Bool").convert
    assert to_ros1 is not None
    assert to_ros1(b"\0\1\0\0\5") == b"\1"


def test_a_string_without_nul_is_refused():
    with pytest.raises(ConversionError, match="closing NUL"):
        REGISTRY.hub_check("std_msgs/msg/String")(b"\0\1\0\0\3\0\0\0abc")


def test_any_bytes_like_object_is_accepted():
    convert, good = CASES["std_msgs/msg/String", "to CDR"]
    assert convert(memoryview(good)) == convert(bytearray(good)) == convert(good)  # type: ignore[arg-type]


def test_elements_without_bytes_do_not_run_for_ever():
    registry = Registry()
    registry.learn_ros1("my_msgs/Voids", "std_msgs/Empty[] voids\n" + "=" * 80 + "\nMSG: std_msgs/Empty\n")
    convert = registry.ros1_to_hub("my_msgs/Voids").convert
    assert convert is not None
    assert convert(struct.pack("<I", 3)) == b"\0\1\0\0\3\0\0\0\0\0\0"
    with pytest.raises(ConversionError, match="elements without content"):
        convert(struct.pack("<I", 0xFFFFFFFF))


def test_bounds_are_checked_both_ways():
    registry = Registry()
    registry.learn_ros2("my_msgs/msg/Bounded", "string<=5 text\nint32[<=2] numbers\nstring<=3[<=2] names\n")
    to_ros1, to_hub = registry.hub_to_ros1("my_msgs/msg/Bounded"), registry.ros1_to_hub("my_msgs/Bounded")
    assert to_ros1.convert is not None
    assert to_hub.convert is not None
    good = from_json(registry, "my_msgs/msg/Bounded", {"text": "five5", "numbers": [1, 2], "names": ["abc"]})
    ros1 = to_ros1.convert(good)
    assert to_hub.convert(ros1) == good
    for bad, field in (
        (struct.pack("<I6sII", 6, b"sixsix", 0, 0), "text"),
        (struct.pack("<II3iI", 0, 3, 1, 2, 3, 0), "numbers"),
        (struct.pack("<IIII4s", 0, 0, 1, 4, b"four"), "names"),
        (struct.pack("<IIIIII", 0, 0, 3, 0, 0, 0), "names"),
    ):
        with pytest.raises(ConversionError, match=f"type allows.*field {field}"):
            to_hub.convert(bad)


def test_a_small_message_cannot_become_a_huge_one():
    """A field that only ROS 2 has would be created for each of the elements."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a_msgs" / "msg"
        path.mkdir(parents=True)
        (path / "One.msg").write_text("uint8 one\nfloat64[<=5] more\nfloat64[1000000] zeros\n")
        (path / "Many.msg").write_text("a_msgs/One[<=1000] ones\n")
        registry = Registry(folders=[Path(folder)])
        registry.learn_ros1("a_msgs/Many", "a_msgs/One[] ones\n" + "=" * 80 + "\nMSG: a_msgs/One\nuint8 one\n")
        convert = registry.ros1_to_hub("a_msgs/Many").convert
    assert convert is not None
    assert len(convert(struct.pack("<IB", 1, 7))) > 8_000_000
    with pytest.raises(ConversionError, match="larger than"):
        convert(struct.pack("<I", 900) + bytes(900))
