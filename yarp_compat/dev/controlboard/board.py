"""A board of independent joints, for `yarp_compat.dev.controlboard.server`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

from yarp_compat.dev.controlboard.messages import ControlBoardMsgs
from yarp_compat.dev.controlboard.streams import JointData
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.overriding import override

_MULTI_JOINT = re.compile(r"(?P<base>\w+)(?P<kind>All|Group)RPC")


class JointBoard(ControlBoardMsgs):
    """Numbered joints: a derived class defines the methods for one joint, such as ``getEncoderOneRPC``.

    The methods for all joints or for a group of joints call these one after the other, and fail if one of them fails. A
    method that is not defined fails as not implemented. A call with a list of the wrong length or an unknown joint
    fails and does nothing.
    """

    def __init__(self, axes: int) -> None:
        super().__init__()
        self.axes = axes

    @override
    def getAxesRPC(self) -> tuple[ReturnValue, int]:
        return OK, self.axes

    def control_mode(self, joint: int) -> int:
        """Return the control mode of a joint, as the number of a YARP vocab."""
        raise NotImplementedError(f"{type(self).__name__} does not report its control modes")

    def state(self) -> JointData:
        """Return the state of the joints, for the stream of states."""
        raise NotImplementedError(f"{type(self).__name__} does not report its joints' state")

    def is_joint(self, joint: int) -> bool:
        """Whether a joint has this number."""
        return 0 <= joint < self.axes

    def run(self, call: Callable[[], Any]) -> Any:
        """Run a whole call; override it if the joints belong to another thread."""
        return call()


def answer(board: JointBoard, method: str, arguments: Sequence[Any]) -> Any:
    """Call a method of a board; a method for several joints calls the method for one joint, for each of them.

    Raises `CallFailed` or `NotImplementedError`.
    """
    return board.run(lambda: _answer(board, method, arguments))


def _answer(board: JointBoard, method: str, arguments: Sequence[Any]) -> Any:
    single = _single_joint_method(method)
    if single is None or method in vars(type(board)):
        _check(board, method, arguments)
        return getattr(board, method)(*arguments)
    method_of_one, grouped = single
    joints = arguments[0] if grouped else range(board.axes)
    values = arguments[1:] if grouped else arguments
    if any(not board.is_joint(joint) for joint in joints):
        raise CallFailed(ReturnCode.OUT_OF_BOUNDS, f"{method}: joints {list(joints)}, but the board has {board.axes}")
    if any(len(listed) != len(joints) for listed in values):
        raise CallFailed(ReturnCode.METHOD_FAILED, f"{method}: expected {len(joints)} numbers, one for each joint")
    call = getattr(board, method_of_one)
    return _joined(method, [call(joint, *(listed[i] for listed in values)) for i, joint in enumerate(joints)])


def _joined(method: str, results: Sequence[Any]) -> Any:
    for returned in results:
        outcome = returned[0] if isinstance(returned, tuple) else returned
        if not outcome:
            raise CallFailed(outcome.code, f"{method}: a joint failed")
    if not results or not isinstance(results[0], tuple):
        return OK
    columns = list(zip(*(returned[1:] for returned in results), strict=True))
    if method.startswith("checkMotionDone"):
        return OK, all(columns[0])
    return OK, *(list(column) for column in columns)


def _check(board: JointBoard, method: str, arguments: Sequence[Any]) -> None:
    call = ControlBoardMsgs.calls()[method]
    first = arguments[0] if call.arguments and call.arguments[0][0] in ("j", "m", "axis") else 0
    if isinstance(first, int) and not board.is_joint(first):
        raise CallFailed(ReturnCode.OUT_OF_BOUNDS, f"{method}: no joint {arguments[0]}, the board has {board.axes}")


def _single_joint_method(method: str) -> tuple[str, bool] | None:
    """Return the single-joint method that a multi-joint method calls; None for other methods.

    The second value is whether the first argument of the multi-joint method is a list of joints.
    """
    match = _MULTI_JOINT.fullmatch(method)
    if match is None:
        return {"resetMotorEncodersRPC": ("resetMotorEncoderRPC", False)}.get(method)
    base = match["base"].removesuffix("s") if match["base"] != "getAmpStatus" else match["base"]
    base = base.replace("Encoders", "Encoder")
    for candidate in (f"{base}OneRPC", f"{base}RPC"):
        if candidate in ControlBoardMsgs.calls():
            return candidate, match["kind"] == "Group"
    raise LookupError(f"{method} has no method for one joint")
