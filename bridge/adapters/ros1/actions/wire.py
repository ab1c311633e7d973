"""The bytes of actionlib's messages and of a ROS 2 action's parts, around a goal, feedback or result left as it is.

ROS 1 (actionlib_msgs 1.13, https://github.com/ros/common_msgs/tree/noetic-devel/actionlib_msgs/msg): an ActionGoal is
Header, GoalID, goal; an ActionResult and an ActionFeedback are Header, GoalStatus, body. Of ROS 2's parts
(https://design.ros2.org/articles/actions.html, action_msgs 2.0) these are the bytes that ROS 1 would give them: no
alignment, a UUID is 16 bytes, a time two 32-bit integers. A result has the status's text before it
(`bridge.messages.definitions.parts.STATUS_TEXT`).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

from bridge.messages.errors import ConversionError

MAX_STATUSES = 20_000
"""Goals that one status message may name."""

MAX_TEXT = 1000
"""Characters of a status's text that cross; what is beyond is cut off."""

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
        """The time of a clock; what 32 bits cannot say is cut off."""
        return cls(*divmod(min(max(nanoseconds, 0), (1 << 32) * 10**9 - 1), 10**9))


ZERO = RosTime(0, 0)


class GoalId(NamedTuple):
    """actionlib_msgs/GoalID; the id keeps bytes that are no UTF-8 as surrogates."""

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
    """Reads fields one after the other; raises `ConversionError` where the bytes end before a field does."""

    def __init__(self, data: bytes, what: str) -> None:
        self._data, self._what = data, what
        self.at = 0

    def take(self, count: int) -> bytes:
        if count > len(self._data) - self.at:
            raise ConversionError(f"{self._what} is cut short: {len(self._data)} bytes")
        self.at += count
        return self._data[self.at - count : self.at]

    def number(self) -> int:
        return int(_LENGTH.unpack(self.take(4))[0])

    def stamp(self) -> RosTime:
        return RosTime(*_TIME.unpack(self.take(8)))

    def text(self) -> str:
        return self.take(self.number()).decode(errors="surrogateescape")

    def header(self) -> None:
        """A std_msgs/Header, of which nothing is wanted."""
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
    """An actionlib_msgs/GoalID: a cancel request, for example."""
    return _TIME.pack(*goal.stamp) + _text(goal.id)


def read_goal_id(payload: bytes) -> GoalId:
    """The reverse of `goal_id`."""
    cursor = _Cursor(payload, "a GoalID")
    found = cursor.goal_id()
    cursor.end()
    return found


def action_goal(goal: GoalId, body: bytes) -> bytes:
    """An ActionGoal. Its header's stamp is zero: nobody reads it, and the side's clock may be a simulated one."""
    return _header(0, ZERO) + goal_id(goal) + body


def read_action_goal(payload: bytes) -> tuple[GoalId, bytes]:
    """Id and body of an ActionGoal."""
    cursor = _Cursor(payload, "an ActionGoal")
    cursor.header()
    return cursor.goal_id(), cursor.rest()


def action_outcome(seq: int, stamp: RosTime, status: GoalStatus, body: bytes) -> bytes:
    """An ActionResult or ActionFeedback."""
    return _header(seq, stamp) + _status(status) + body


def read_action_outcome(payload: bytes) -> tuple[GoalStatus, bytes]:
    """Status and body of an ActionResult or ActionFeedback."""
    cursor = _Cursor(payload, "an ActionResult or ActionFeedback")
    cursor.header()
    return cursor.status(), cursor.rest()


def statuses(seq: int, stamp: RosTime, goals: Iterable[GoalStatus]) -> bytes:
    """An actionlib_msgs/GoalStatusArray."""
    entries = [_status(goal) for goal in goals]
    return b"".join((_header(seq, stamp), _LENGTH.pack(len(entries)), *entries))


def read_statuses(payload: bytes) -> list[GoalStatus]:
    """The entries of an actionlib_msgs/GoalStatusArray."""
    cursor = _Cursor(payload, "a GoalStatusArray")
    cursor.header()
    count = cursor.number()
    if count > MAX_STATUSES:
        raise ConversionError(f"a GoalStatusArray names {count} goals, at most {MAX_STATUSES} are read")
    found = [cursor.status() for _ in range(count)]
    cursor.end()
    return found


def read_with_uuid(payload: bytes) -> tuple[bytes, bytes]:
    """UUID and body of a SendGoal request or a FeedbackMessage; of a GetResult request, whose body is empty."""
    if len(payload) < UUID_SIZE:
        raise ConversionError(f"a goal's UUID has {UUID_SIZE} bytes, these are {len(payload)}")
    return payload[:UUID_SIZE], payload[UUID_SIZE:]


def goal_response(stamp: RosTime, *, accepted: bool) -> bytes:
    """A SendGoal response."""
    return bytes((accepted,)) + _TIME.pack(*stamp)


def read_goal_response(payload: bytes) -> bool:
    """Whether a SendGoal response accepts."""
    cursor = _Cursor(payload, "a SendGoal response")
    accepted = cursor.take(1) != b"\0"
    cursor.stamp()
    cursor.end()
    return accepted


def result_response(state: int, body: bytes, text: str = "") -> bytes:
    """A GetResult response; bytes of the text that are no UTF-8 become question marks, since ROS 2 has none such."""
    said = text[:MAX_TEXT].encode(errors="replace")
    return struct.pack("<bI", state, len(said)) + said + body


def read_result_response(payload: bytes) -> tuple[int, bytes, str]:
    """State, body and text of a GetResult response."""
    cursor = _Cursor(payload, "a GetResult response")
    state, text = int.from_bytes(cursor.take(1), signed=True), cursor.text()[:MAX_TEXT]
    return state, cursor.rest(), text


def cancel_request(info: GoalInfo) -> bytes:
    """A CancelGoal request."""
    return _GOAL_INFO.pack(info.uuid, *info.stamp)


def read_cancel_request(payload: bytes) -> GoalInfo:
    """The reverse of `cancel_request`."""
    cursor = _Cursor(payload, "a CancelGoal request")
    info = GoalInfo(cursor.take(UUID_SIZE), cursor.stamp())
    cursor.end()
    return info


def cancel_response(code: int, goals: Iterable[GoalInfo]) -> bytes:
    """A CancelGoal response."""
    infos = [_GOAL_INFO.pack(info.uuid, *info.stamp) for info in goals]
    return b"".join((struct.pack("<bI", code, len(infos)), *infos))


def read_cancel_response(payload: bytes) -> tuple[int, list[GoalInfo]]:
    """The reverse of `cancel_response`."""
    cursor = _Cursor(payload, "a CancelGoal response")
    code = int.from_bytes(cursor.take(1), signed=True)
    count = cursor.number()
    infos = [_GOAL_INFO.unpack(entry) for entry in _entries(cursor, count, _GOAL_INFO)]
    return code, [GoalInfo(uuid, RosTime(secs, nsecs)) for uuid, secs, nsecs in infos]


def goal_states(goals: Iterable[tuple[GoalInfo, int]]) -> bytes:
    """An action_msgs/GoalStatusArray."""
    entries = [_STATUS_ENTRY.pack(info.uuid, *info.stamp, state) for info, state in goals]
    return b"".join((_LENGTH.pack(len(entries)), *entries))


def read_goal_states(payload: bytes) -> list[tuple[GoalInfo, int]]:
    """The entries of an action_msgs/GoalStatusArray."""
    cursor = _Cursor(payload, "an action_msgs/GoalStatusArray")
    found = [_STATUS_ENTRY.unpack(entry) for entry in _entries(cursor, cursor.number(), _STATUS_ENTRY)]
    return [(GoalInfo(uuid, RosTime(secs, nsecs)), state) for uuid, secs, nsecs, state in found]


def _entries(cursor: _Cursor, count: int, entry: struct.Struct) -> list[bytes]:
    data = cursor.take(count * entry.size)
    cursor.end()
    return [data[at : at + entry.size] for at in range(0, len(data), entry.size)]
