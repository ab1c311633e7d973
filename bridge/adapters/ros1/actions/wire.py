"""Serializes and parses actionlib's messages and the parts of a ROS 2 action; goals, feedback and results stay bytes.

ROS 1 (actionlib_msgs 1.13, https://github.com/ros/common_msgs/tree/noetic-devel/actionlib_msgs/msg): an ActionGoal is
Header, GoalID, goal; an ActionResult and an ActionFeedback are Header, GoalStatus, body. ROS 2's parts
(https://design.ros2.org/articles/actions.html, action_msgs 2.0) are serialized as ROS 1 would do it: without alignment,
a UUID as 16 bytes, and a time as two 32-bit integers. In a GetResult response, the text of the status precedes the
result (`bridge.messages.definitions.parts.STATUS_TEXT`).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

from bridge.messages.errors import ConversionError

MAX_STATUSES = 20_000
"""Maximum number of goals that one status message may name."""

MAX_TEXT = 1000
"""Maximum number of characters of a status's text that are bridged; the rest is cut off."""

_TIME = struct.Struct("<II")
_LENGTH = struct.Struct("<I")
_STATUS_ENTRY = struct.Struct("<16sIIb")
_GOAL_INFO = struct.Struct("<16sII")
UUID_SIZE = 16


class RosTime(NamedTuple):
    """A time in whole seconds and nanoseconds."""

    secs: int
    nsecs: int

    @classmethod
    def of(cls, nanoseconds: int) -> RosTime:
        """Convert a clock's time, limited to the range of 32 bits."""
        return cls(*divmod(min(max(nanoseconds, 0), (1 << 32) * 10**9 - 1), 10**9))


ZERO = RosTime(0, 0)


class GoalId(NamedTuple):
    """actionlib_msgs/GoalID; bytes of the id that are not UTF-8 are kept as surrogates."""

    stamp: RosTime
    id: str


class GoalStatus(NamedTuple):
    """actionlib_msgs/GoalStatus; ``state`` is its ``status`` number."""

    goal: GoalId
    state: int
    text: str


class GoalInfo(NamedTuple):
    """action_msgs/GoalInfo."""

    uuid: bytes
    stamp: RosTime


class _Cursor:
    """Reads fields in order; raises `ConversionError` if the bytes end within a field."""

    def __init__(self, data: bytes, what: str) -> None:
        self._data, self._what = data, what
        self.at = 0

    def take(self, count: int) -> bytes:
        if count > len(self._data) - self.at:
            raise ConversionError(f"{self._what} is truncated: {len(self._data)} bytes")
        self.at += count
        return self._data[self.at - count : self.at]

    def number(self) -> int:
        return int(_LENGTH.unpack(self.take(4))[0])

    def stamp(self) -> RosTime:
        return RosTime(*_TIME.unpack(self.take(8)))

    def text(self) -> str:
        return self.take(self.number()).decode(errors="surrogateescape")

    def header(self) -> None:
        """Skip a std_msgs/Header."""
        self.take(12)
        self.take(self.number())

    def goal_id(self) -> GoalId:
        return GoalId(self.stamp(), self.text())

    def status(self) -> GoalStatus:
        return GoalStatus(self.goal_id(), self.take(1)[0], self.text())

    def rest(self) -> bytes:
        return self._data[self.at :]

    def end(self) -> None:
        if self.at != len(self._data):
            raise ConversionError(f"{self._what} has {len(self._data) - self.at} bytes too many")


def _text(text: str) -> bytes:
    data = text.encode(errors="surrogateescape")
    return _LENGTH.pack(len(data)) + data


def _header(seq: int, stamp: RosTime) -> bytes:
    return struct.pack("<IIII", seq & 0xFFFFFFFF, *stamp, 0)


def _status(status: GoalStatus) -> bytes:
    return goal_id(status.goal) + bytes((status.state,)) + _text(status.text)


def goal_id(goal: GoalId) -> bytes:
    """Serialize an actionlib_msgs/GoalID, for example a cancel request."""
    return _TIME.pack(*goal.stamp) + _text(goal.id)


def read_goal_id(payload: bytes) -> GoalId:
    """Parse an actionlib_msgs/GoalID."""
    cursor = _Cursor(payload, "a GoalID")
    goal = cursor.goal_id()
    cursor.end()
    return goal


def action_goal(goal: GoalId, body: bytes) -> bytes:
    """Serialize an ActionGoal. The header's stamp is zero: no server reads it, and the clock may be simulated."""
    return _header(0, ZERO) + goal_id(goal) + body


def read_action_goal(payload: bytes) -> tuple[GoalId, bytes]:
    """Return id and body of an ActionGoal."""
    cursor = _Cursor(payload, "an ActionGoal")
    cursor.header()
    return cursor.goal_id(), cursor.rest()


def action_outcome(seq: int, stamp: RosTime, status: GoalStatus, body: bytes) -> bytes:
    """Serialize an ActionResult or ActionFeedback."""
    return _header(seq, stamp) + _status(status) + body


def read_action_outcome(payload: bytes) -> tuple[GoalStatus, bytes]:
    """Return status and body of an ActionResult or ActionFeedback."""
    cursor = _Cursor(payload, "an ActionResult or ActionFeedback")
    cursor.header()
    return cursor.status(), cursor.rest()


def statuses(seq: int, stamp: RosTime, goals: Iterable[GoalStatus]) -> bytes:
    """Serialize an actionlib_msgs/GoalStatusArray."""
    entries = [_status(goal) for goal in goals]
    return b"".join((_header(seq, stamp), _LENGTH.pack(len(entries)), *entries))


def read_statuses(payload: bytes) -> list[GoalStatus]:
    """Return the entries of an actionlib_msgs/GoalStatusArray."""
    cursor = _Cursor(payload, "a GoalStatusArray")
    cursor.header()
    count = cursor.number()
    if count > MAX_STATUSES:
        raise ConversionError(f"a GoalStatusArray names {count} goals, but at most {MAX_STATUSES} are read")
    entries = [cursor.status() for _ in range(count)]
    cursor.end()
    return entries


def read_with_uuid(payload: bytes) -> tuple[bytes, bytes]:
    """Return UUID and body of a SendGoal request, FeedbackMessage or GetResult request (whose body is empty)."""
    if len(payload) < UUID_SIZE:
        raise ConversionError(f"a goal's UUID has {UUID_SIZE} bytes, the message {len(payload)}")
    return payload[:UUID_SIZE], payload[UUID_SIZE:]


def goal_response(stamp: RosTime, *, accepted: bool) -> bytes:
    """Serialize a SendGoal response."""
    return bytes((accepted,)) + _TIME.pack(*stamp)


def read_goal_response(payload: bytes) -> bool:
    """Return whether a SendGoal response accepts the goal."""
    cursor = _Cursor(payload, "a SendGoal response")
    accepted = cursor.take(1) != b"\0"
    cursor.stamp()
    cursor.end()
    return accepted


def result_response(state: int, body: bytes, text: str = "") -> bytes:
    """Serialize a GetResult response; bytes of the text that are not UTF-8 become question marks for ROS 2."""
    encoded = text[:MAX_TEXT].encode(errors="replace")
    return struct.pack("<bI", state, len(encoded)) + encoded + body


def read_result_response(payload: bytes) -> tuple[int, bytes, str]:
    """Return state, body and text of a GetResult response."""
    cursor = _Cursor(payload, "a GetResult response")
    state, text = int.from_bytes(cursor.take(1), signed=True), cursor.text()[:MAX_TEXT]
    return state, cursor.rest(), text


def cancel_request(info: GoalInfo) -> bytes:
    """Serialize a CancelGoal request."""
    return _GOAL_INFO.pack(info.uuid, *info.stamp)


def read_cancel_request(payload: bytes) -> GoalInfo:
    """Parse a CancelGoal request."""
    cursor = _Cursor(payload, "a CancelGoal request")
    info = GoalInfo(cursor.take(UUID_SIZE), cursor.stamp())
    cursor.end()
    return info


def cancel_response(code: int, goals: Iterable[GoalInfo]) -> bytes:
    """Serialize a CancelGoal response."""
    infos = [_GOAL_INFO.pack(info.uuid, *info.stamp) for info in goals]
    return b"".join((struct.pack("<bI", code, len(infos)), *infos))


def read_cancel_response(payload: bytes) -> tuple[int, list[GoalInfo]]:
    """Return code and goals of a CancelGoal response."""
    cursor = _Cursor(payload, "a CancelGoal response")
    code = int.from_bytes(cursor.take(1), signed=True)
    count = cursor.number()
    infos = [_GOAL_INFO.unpack(entry) for entry in _entries(cursor, count, _GOAL_INFO)]
    return code, [GoalInfo(uuid, RosTime(secs, nsecs)) for uuid, secs, nsecs in infos]


def goal_states(goals: Iterable[tuple[GoalInfo, int]]) -> bytes:
    """Serialize an action_msgs/GoalStatusArray."""
    entries = [_STATUS_ENTRY.pack(info.uuid, *info.stamp, state) for info, state in goals]
    return b"".join((_LENGTH.pack(len(entries)), *entries))


def read_goal_states(payload: bytes) -> list[tuple[GoalInfo, int]]:
    """Return the entries of an action_msgs/GoalStatusArray."""
    cursor = _Cursor(payload, "an action_msgs/GoalStatusArray")
    entries = [_STATUS_ENTRY.unpack(entry) for entry in _entries(cursor, cursor.number(), _STATUS_ENTRY)]
    return [(GoalInfo(uuid, RosTime(secs, nsecs)), state) for uuid, secs, nsecs, state in entries]


def _entries(cursor: _Cursor, count: int, entry: struct.Struct) -> list[bytes]:
    data = cursor.take(count * entry.size)
    cursor.end()
    return [data[at : at + entry.size] for at in range(0, len(data), entry.size)]
