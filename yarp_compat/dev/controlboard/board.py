"""A board of joints that each do for themselves, for `yarp_compat.dev.controlboard.server`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

from yarp_compat.dev.controlboard.messages import ControlBoardMsgs
from yarp_compat.dev.controlboard.streams import JointData
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue

_OF_MORE = re.compile(r"(?P<base>\w+)(?P<kind>All|Group)RPC")


class JointBoard(ControlBoardMsgs):
    """Joints by number: a derived class defines methods of one joint, ``getEncoderOneRPC`` and such.

    Those of all joints, or of some, call them one after the other, and fail where one does. What is not defined fails
    as not implemented. Where a list has another length than it should, or a joint does not exist, a call fails and does
    nothing.
    """

    def __init__(self, axes: int) -> None:
        super().__init__()
        self.axes = axes

    def getAxesRPC(self) -> tuple[ReturnValue, int]:
        """How many joints there are."""
        return OK, self.axes

    def control_mode(self, joint: int) -> int:
        """The mode of a joint, a vocab's number."""
        raise NotImplementedError(f"{type(self).__name__} does not tell its control modes")

    def state(self) -> JointData:
        """What the joints do, for the stream of states."""
        raise NotImplementedError(f"{type(self).__name__} does not tell its joints' state")

    def is_joint(self, joint: int) -> bool:
        """Whether a joint of this number exists."""
        return 0 <= joint < self.axes

    def run(self, call: Callable[[], Any]) -> Any:
        """Do a whole call; a class whose joints live in a thread does it there."""
        return call()


def answer(board: JointBoard, method: str, arguments: Sequence[Any]) -> Any:
    """Call a method of a board; of all joints or of some by that of one. Raises `CallFailed`, `NotImplementedError`."""
    return board.run(lambda: _answer(board, method, arguments))


def _answer(board: JointBoard, method: str, arguments: Sequence[Any]) -> Any:
    single = _single(method)
    if single is None or method in vars(type(board)):
        _check(board, method, arguments)
        return getattr(board, method)(*arguments)
    one, grouped = single
    joints = arguments[0] if grouped else range(board.axes)
    values = arguments[1:] if grouped else arguments
    if any(not board.is_joint(joint) for joint in joints):
        raise CallFailed(ReturnCode.OUT_OF_BOUNDS, f"{method} of joints {list(joints)}, of {board.axes}")
    if any(len(listed) != len(joints) for listed in values):
        raise CallFailed(ReturnCode.METHOD_FAILED, f"{method} of {len(joints)} joints has as many numbers")
    found = [getattr(board, one)(joint, *(listed[i] for listed in values)) for i, joint in enumerate(joints)]
    return _joined(method, found)


def _joined(method: str, found: Sequence[Any]) -> Any:
    for returned in found:
        outcome = returned[0] if isinstance(returned, tuple) else returned
        if not outcome:
            raise CallFailed(outcome.code, f"{method}: a joint fails")
    if not found or not isinstance(found[0], tuple):
        return OK
    columns = list(zip(*(returned[1:] for returned in found), strict=True))
    if method.startswith("checkMotionDone"):
        return OK, all(columns[0])
    return OK, *(list(column) for column in columns)


def _check(board: JointBoard, method: str, arguments: Sequence[Any]) -> None:
    call = ControlBoardMsgs.calls()[method]
    first = arguments[0] if call.arguments and call.arguments[0][0] in ("j", "m", "axis") else 0
    if isinstance(first, int) and not board.is_joint(first):
        raise CallFailed(ReturnCode.OUT_OF_BOUNDS, f"{method} of joint {arguments[0]}, of {board.axes}")


def _single(method: str) -> tuple[str, bool] | None:
    """The method of one joint that one of several stands on, and whether that is of some; None for other methods."""
    found = _OF_MORE.fullmatch(method)
    if found is None:
        return {"resetMotorEncodersRPC": ("resetMotorEncoderRPC", False)}.get(method)
    base = found["base"].removesuffix("s") if found["base"] != "getAmpStatus" else found["base"]
    base = base.replace("Encoders", "Encoder")
    for one in (f"{base}OneRPC", f"{base}RPC"):
        if one in ControlBoardMsgs.calls():
            return one, found["kind"] == "Group"
    raise LookupError(f"{method} stands on no method of one joint")
