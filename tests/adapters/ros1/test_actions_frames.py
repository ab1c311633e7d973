"""The frames that goals name."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.adapters.ros1.actions.frames import Frames, empty, frames_in, names_frames, without_slashes
from bridge.messages.definition import World
from bridge.messages.errors import ConversionError
from bridge.messages.parser import closure, parse_full

LINE = "=" * 80
HEADER = f"{LINE}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
POSE = f"""{LINE}
MSG: geometry_msgs/PoseStamped
Header header
float64[3] at
"""
GOAL = f"""string name
geometry_msgs/PoseStamped target
geometry_msgs/PoseStamped[] via
float64[] weights
string[2] words
Nothing[] nothings
std_msgs/Header other
{POSE}{HEADER}{LINE}
MSG: test_msgs/Nothing
uint8 CONSTANT=3
"""


def schema(text, name="test_msgs/Goal"):
    found = parse_full(text, name, World.ROS1)
    return closure(found[name], found)


SCHEMA = schema(GOAL)


def string(data):
    return struct.pack("<I", len(data)) + data


def header(frame):
    return struct.pack("<III", 1, 2, 3) + string(frame)


def goal(target=b"map", via=(), other=b""):
    poses = b"".join(header(frame) + bytes(24) for frame in via)
    return b"".join((
        string(b"name"), header(target), bytes(24), struct.pack("<I", len(via)), poses,
        struct.pack("<I", 2), bytes(16), string(b"one"), string(b""), struct.pack("<I", 1 << 30), header(other),
    ))  # fmt: skip


def test_all_headers_are_found():
    found = frames_in(SCHEMA, goal(b"map", [b"odom", b"/base"], b"x"))
    assert [(f.frame, f.where, f.pose) for f in found] == [
        (b"map", "target.header.frame_id", True), (b"odom", "via.header.frame_id", True),
        (b"/base", "via.header.frame_id", True), (b"x", "other.frame_id", False),
    ]  # fmt: skip
    assert names_frames(SCHEMA)
    assert not names_frames(schema("int32 order\n", "actionlib_tutorials/FibonacciGoal"))


@given(st.lists(st.sampled_from([b"", b"map", b"/map", b"//odom", b"/"]), min_size=2, max_size=6))
def test_slashes_go_and_the_rest_stays(names):
    target, other, *via = names
    data = goal(target, via, other)
    stripped = without_slashes(data, frames_in(SCHEMA, data))
    assert stripped == goal(target.lstrip(b"/"), [v.lstrip(b"/") for v in via], other.lstrip(b"/"))


@given(st.integers(0, 200))
def test_a_message_that_is_cut_short_is_refused(length):
    data = goal(b"map", [b"odom"])
    with pytest.raises(ConversionError):
        frames_in(SCHEMA, data[: min(length, len(data) - 1)])
    with pytest.raises(ConversionError):
        frames_in(SCHEMA, data + b"x")


def test_an_empty_message():
    assert [f.frame for f in frames_in(SCHEMA, empty(SCHEMA))] == [b"", b""]
    assert len(empty(SCHEMA)) == 4 + 16 + 24 + 4 + 4 + 8 + 4 + 16
    assert empty(schema("", "move_base_msgs/MoveBaseResult")) == b""
    assert empty(schema("time t\nduration[2] d\nbool b\nstring s\n")) == bytes(8 + 16 + 1 + 4)


def transforms(*pairs: tuple):
    parts = [header(parent) + string(child) + bytes(56) for parent, child in pairs]
    return struct.pack("<I", len(parts)) + b"".join(parts)


def test_frames_that_transforms_name():
    frames = Frames()
    wrong = frames_in(SCHEMA, goal(b"mpa"))
    assert not frames
    frames.learn(transforms((b"map", b"odom"), (b"/odom", b"/base")))
    frames.learn(b"\xff\xff\xff\xff nonsense")
    assert frames
    assert "'mpa' of target.header.frame_id" in frames.trouble(wrong)
    for name in (b"map", b"odom", b"base"):
        assert frames.trouble(frames_in(SCHEMA, goal(name))) == ""
    assert frames.trouble(frames_in(SCHEMA, goal(b""))) == "target.header.frame_id is empty"
    assert frames.trouble(frames_in(SCHEMA, goal(b"map", [], b""))) == "", "a header that nobody uses"
