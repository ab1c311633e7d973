"""The bytes of actions are compared with rosbags' serializers."""

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from bridge.adapters.ros1.actions import states, wire
from bridge.adapters.ros1.actions.states import TO_ROS1, TO_ROS2, Ros1State
from bridge.adapters.ros1.actions.wire import GoalId, GoalInfo, GoalStatus, RosTime
from bridge.messages.actions import GoalState
from bridge.messages.errors import ConversionError

ROS1 = get_typestore(Stores.ROS1_NOETIC)

stamps = st.builds(RosTime, st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1))
texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)
goals = st.builds(GoalId, stamps, texts)
statuses = st.builds(GoalStatus, goals, st.sampled_from(list(Ros1State)), texts)
uuids = st.binary(min_size=16, max_size=16)
infos = st.builds(GoalInfo, uuids, stamps)


def native(name, **fields: object):
    return ROS1.types[f"actionlib_msgs/msg/{name}"](**fields)


def native_stamp(stamp):
    return ROS1.types["builtin_interfaces/msg/Time"](stamp.secs, stamp.nsecs)


def native_goal(goal):
    return native("GoalID", stamp=native_stamp(goal.stamp), id=goal.id)


def native_status(status):
    return native(
        "GoalStatus", goal_id=native_goal(status.goal), status=np.uint8(status.state), text=status.text,
    )  # fmt: skip


def ros1_bytes(message):
    return bytes(ROS1.serialize_ros1(message, message.__msgtype__))


@given(goals)
def test_goal_ids_equal_ros_1s_bytes(goal):
    payload = wire.goal_id(goal)
    assert payload == ros1_bytes(native_goal(goal))
    assert wire.read_goal_id(payload) == goal


@given(st.integers(0, 2**32 - 1), stamps, st.lists(statuses, max_size=5))
def test_status_lists_equal_ros_1s_bytes(seq, stamp, found):
    payload = wire.statuses(seq, stamp, found)
    header = ROS1.types["std_msgs/msg/Header"](seq=seq, stamp=native_stamp(stamp), frame_id="")
    assert payload == ros1_bytes(
        native("GoalStatusArray", header=header, status_list=[native_status(s) for s in found])
    )
    assert wire.read_statuses(payload) == found


@given(goals, statuses, st.binary(max_size=50))
def test_bodies_are_unchanged(goal, status, body):
    assert wire.read_action_goal(wire.action_goal(goal, body)) == (goal, body)
    assert wire.read_action_outcome(wire.action_outcome(7, RosTime(1, 2), status, body)) == (status, body)


@given(
    uuids, stamps, st.booleans(), st.integers(-128, 127), st.lists(infos, max_size=4), st.binary(max_size=20), st.text()
)
def test_the_parts_of_a_ros_2_action_survive_the_round_trip(uuid, stamp, accepted, number, found, body, text):
    assert wire.read_with_uuid(uuid + body) == (uuid, body)
    assert wire.read_goal_response(wire.goal_response(stamp, accepted=accepted)) is accepted
    assert wire.read_result_response(wire.result_response(number, body, text)) == (number, body, text)
    assert wire.read_cancel_request(wire.cancel_request(GoalInfo(uuid, stamp))) == (uuid, stamp)
    assert wire.read_cancel_response(wire.cancel_response(number, found)) == (number, found)
    states = [(info, number) for info in found]
    assert wire.read_goal_states(wire.goal_states(states)) == states


def test_a_long_text_is_cut_and_invalid_utf_8_is_replaced():
    """This also applies when reading, because another machine's bridge may send any text."""
    long = wire.result_response(6, b"body", "é" * 3000)
    assert len(long) == 1 + 4 + 2 * wire.MAX_TEXT + len(b"body")
    assert wire.read_result_response(long) == (6, b"body", "é" * wire.MAX_TEXT)
    foreign = b"\6" + struct.pack("<I", 3000) + b"x" * 3000 + b"body"
    assert wire.read_result_response(foreign) == (6, b"body", "x" * wire.MAX_TEXT)
    odd = wire.result_response(6, b"body", b"no \xff way".decode(errors="surrogateescape"))
    assert wire.read_result_response(odd) == (6, b"body", "no ? way")


READERS = [
    wire.read_goal_id, wire.read_action_goal, wire.read_action_outcome, wire.read_statuses, wire.read_with_uuid,
    wire.read_goal_response, wire.read_result_response, wire.read_cancel_request, wire.read_cancel_response,
    wire.read_goal_states,
]  # fmt: skip


@given(st.sampled_from(READERS), st.binary(max_size=80))
def test_arbitrary_bytes_are_refused_or_parsed(read, data):
    with contextlib.suppress(ConversionError):
        assert read(data) is not None


@pytest.mark.parametrize("read", READERS)
def test_empty_bytes_are_refused(read):
    with pytest.raises(ConversionError):
        read(b"")


def test_a_status_list_that_announces_too_many_goals_is_refused():
    payload = bytearray(wire.statuses(0, wire.ZERO, []))
    payload[-4:] = b"\xff\xff\xff\x7f"
    with pytest.raises(ConversionError, match="at most"):
        wire.read_statuses(bytes(payload))


@given(uuids)
def test_a_goal_of_the_hub_is_recognized_by_its_text(uuid):
    assert states.uuid_of("/any", states.text_of(uuid)) == uuid


@given(texts, texts)
def test_each_ros_1_id_has_one_uuid(one, other):
    assert (states.uuid_of("/a", one) == states.uuid_of("/a", other)) == (one == other)
    assert states.uuid_of("/a", one) != states.uuid_of("/b", one) or states.uuid_in(one)


def test_every_state_is_mapped():
    assert set(TO_ROS2) == set(Ros1State)
    assert set(TO_ROS1) == set(GoalState)
    assert all(TO_ROS2[s].ended == s.ended for s in Ros1State)
    assert all(TO_ROS1[s].ended == s.ended for s in GoalState if s is not GoalState.UNKNOWN)
    back = {s for s in GoalState if TO_ROS2[TO_ROS1[s]] is s}
    assert back == set(GoalState) - {GoalState.UNKNOWN}
