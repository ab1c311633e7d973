"""The frames of goals are checked."""

import struct
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.adapters.ros1.actions import frames as frames_module
from bridge.adapters.ros1.actions.frames import FrameGuard, KnownFrames, empty, frames_in, has_headers, without_slashes
from bridge.adapters.ros1.graph.state import MasterState
from bridge.messages.definitions.schema import World
from bridge.messages.definitions.text import closure, parse_full
from bridge.messages.errors import ConversionError

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
    result = parse_full(text, name, World.ROS1)
    return closure(result[name], result)


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
    result = frames_in(SCHEMA, goal(b"map", [b"odom", b"/base"], b"x"))
    assert [(f.frame, f.where, f.pose) for f in result] == [
        (b"map", "target.header.frame_id", True), (b"odom", "via.header.frame_id", True),
        (b"/base", "via.header.frame_id", True), (b"x", "other.frame_id", False),
    ]  # fmt: skip
    assert has_headers(SCHEMA)
    assert not has_headers(schema("int32 order\n", "actionlib_tutorials/FibonacciGoal"))


@given(st.lists(st.sampled_from([b"", b"map", b"/map", b"//odom", b"/"]), min_size=2, max_size=6))
def test_leading_slashes_are_removed(names):
    target, other, *via = names
    data = goal(target, via, other)
    stripped = without_slashes(data, frames_in(SCHEMA, data))
    assert stripped == goal(target.lstrip(b"/"), [v.lstrip(b"/") for v in via], other.lstrip(b"/"))


@given(st.integers(0, 200))
def test_a_truncated_message_is_refused(length):
    data = goal(b"map", [b"odom"])
    with pytest.raises(ConversionError):
        frames_in(SCHEMA, data[: min(length, len(data) - 1)])
    with pytest.raises(ConversionError):
        frames_in(SCHEMA, data + b"x")


def test_all_fields_of_an_empty_message_are_zero():
    assert [f.frame for f in frames_in(SCHEMA, empty(SCHEMA))] == [b"", b""]
    assert len(empty(SCHEMA)) == 4 + 16 + 24 + 4 + 4 + 8 + 4 + 16
    assert empty(schema("", "move_base_msgs/MoveBaseResult")) == b""
    assert empty(schema("time t\nduration[2] d\nbool b\nstring s\n")) == bytes(8 + 16 + 1 + 4)


def transforms(*pairs: tuple):
    parts = [header(parent) + string(child) + bytes(56) for parent, child in pairs]
    return struct.pack("<I", len(parts)) + b"".join(parts)


def test_frames_in_transforms_are_known():
    frames = KnownFrames()
    wrong = frames_in(SCHEMA, goal(b"mpa"))
    assert not frames
    frames.learn(transforms((b"map", b"odom"), (b"/odom", b"/base")))
    frames.learn(b"\xff\xff\xff\xff nonsense")
    assert frames
    assert "'mpa' of target.header.frame_id" in frames.trouble(wrong)
    for name in (b"map", b"odom", b"base"):
        assert frames.trouble(frames_in(SCHEMA, goal(name))) == ""
    assert frames.trouble(frames_in(SCHEMA, goal(b""))) == "target.header.frame_id is empty"
    assert frames.trouble(frames_in(SCHEMA, goal(b"map", [], b""))) == "", (
        "an empty frame in an unused header must be accepted"
    )


class TopicSubscription:
    def close(self):
        """Do nothing."""


class GuardFixture:
    """A guard with its network and its clock."""

    def __init__(self, monkeypatch, *, check=True) -> None:
        self.now, self.callbacks = 100.0, {}
        monkeypatch.setattr(frames_module, "time", SimpleNamespace(monotonic=lambda: self.now))

        def subscribe(topic, _type, deliver, suffix) -> TopicSubscription:
            assert suffix, "the guard must not share a route's connection: a suffix is expected"
            self.callbacks[topic] = deliver
            return TopicSubscription()

        self.guard = FrameGuard(SimpleNamespace(subscribe=subscribe, check_frames=check))
        types = {"/tf": "tf2_msgs/TFMessage", "/old": "tf/tfMessage", "/other": "std_msgs/String"}
        self.guard.seen(MasterState("run", "net", types=types))

    def check(self, frame):
        return self.guard.check(SCHEMA, goal(frame))[1]


def test_a_guard_waits_for_transforms(monkeypatch):
    side = GuardFixture(monkeypatch)
    assert side.callbacks == {}, "no action is open"
    side.guard.open("me")
    assert set(side.callbacks) == {"/tf", "/old"}
    assert side.check(b"map") is None
    side.now += 5.0
    assert side.check(b"map") is None
    side.callbacks["/tf"](transforms((b"map", b"odom")), "", None)
    assert (side.check(b"map"), side.check(b"mpa")) == ("", None)
    side.now += frames_module.KNOW_SECONDS + 0.1
    assert side.check(b"map") == ""
    assert "mpa" in side.check(b"mpa")
    side.guard.report("/act", "why")
    assert side.guard.warnings() == ["/act: a goal was rejected: why"]
    side.now += 100.0
    assert side.guard.warnings() == []


def test_the_first_transform_may_arrive_long_after_the_action_opened(monkeypatch):
    side = GuardFixture(monkeypatch)
    side.guard.open("me")
    side.now += 3 * frames_module.SILENT_SECONDS
    side.callbacks["/tf"](transforms((b"odom", b"base")), "", None)
    assert side.check(b"map") is None, "the guard must wait, because the frame may be in the next message"
    side.now += frames_module.KNOW_SECONDS + 0.1
    assert "map" in side.check(b"map")


def test_an_action_that_opens_while_the_last_one_closes_subscribes_again(monkeypatch):
    """Only a new subscription receives the latched transforms again."""
    side = GuardFixture(monkeypatch)
    side.guard.open("old")
    side.callbacks["/tf"](transforms((b"map", b"odom")), "", None)
    side.callbacks.clear()

    class Interrupted:
        """A lock; the other action opens as soon as the lock is released for the first time."""

        released = False

        def __enter__(self) -> None:
            """Do nothing, because the test has one thread."""

        def __exit__(self, *_: object) -> None:
            if not self.released:
                self.released = True
                side.guard.open("new")

    monkeypatch.setattr(side.guard, "_lock", Interrupted())
    side.guard.close("old")
    assert set(side.callbacks) == {"/tf", "/old"}


def test_after_too_many_frames_every_frame_is_accepted(monkeypatch):
    monkeypatch.setattr(frames_module, "MAX_FRAMES", 3)
    frames = KnownFrames()
    frames.learn(transforms((b"map", b"odom"), (b"odom", b"laser")))
    assert frames.trouble(frames_in(SCHEMA, goal(b"mpa")))
    frames.learn(transforms((b"map", b"x1"), (b"map", b"x2")))
    frames.learn(transforms((b"odom", b"base")))
    assert frames
    for name in (b"laser", b"base", b"mpa"):
        assert frames.trouble(frames_in(SCHEMA, goal(name))) == ""
    assert "empty" in frames.trouble(frames_in(SCHEMA, goal(b"")))


def test_a_side_without_transforms_accepts_all_frames(monkeypatch):
    side = GuardFixture(monkeypatch)
    side.guard.open("me")
    side.now += frames_module.SILENT_SECONDS + 0.1
    assert side.check(b"mpa") == ""
    bare = GuardFixture(monkeypatch)
    bare.guard.open("me")
    bare.guard.seen(MasterState("run", "net"))
    assert bare.check(b"mpa") == "", "without transform topics, all frames must be accepted"


def test_frames_are_not_checked_if_disabled(monkeypatch):
    side = GuardFixture(monkeypatch, check=False)
    side.guard.open("me")
    assert side.callbacks == {}
    assert side.guard.check(SCHEMA, goal(b"/mpa")) == (goal(b"/mpa"), "")
