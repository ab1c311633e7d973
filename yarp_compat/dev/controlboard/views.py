"""A control board's interfaces as scripts use them, ``driver.viewIEncoders().getEncoders(encs)`` (``bindings/yarp.i``).

What YARP 3 and 4 call by two names has both: ``setRefSpeed`` is ``setTrajSpeed``, ``getLimits`` is ``getPosLimits``.
Degrees, degrees per second, newton metres, per cent, amperes; a mode is a vocab's number (``VOCAB_CM_POSITION``).

A method that sets returns whether it succeeded, and so does one that fills in: its last arguments become what is asked
for, a ``DVector``, an ``IVector``, a ``Vector`` or its ``data()``. ``getEncoder(j)``, ``getControlMode(j)``,
``getAxisName(j)`` and their like return the value itself, as the bindings have it, and 0 or ``unknown`` where there is
none. Joints are given as ``(j, ...)``, ``(n, joints, ...)`` or ``(joints, ...)``, or not at all: that is all of them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

from yarp_compat.dev.controlboard.client import ControlBoardClient
from yarp_compat.dev.controlboard.modes import VOCAB_CM_UNKNOWN, VOCAB_IM_UNKNOWN, VOCAB_JOINTTYPE_UNKNOWN
from yarp_compat.os.data.bottle import Bottle
from yarp_compat.os.data.stamp import Stamp

log = logging.getLogger("yarp.dev.ControlBoard")

Method = Callable[..., Any]


class BoardView:
    """One interface of a board."""

    def __init__(self, board: ControlBoardClient) -> None:
        self._board = board

    def getAxes(self, axes: Any = None) -> Any:
        """How many joints there are; or becomes it, and whether it is known."""
        if axes is None:
            return self._board.axes
        fill(axes, [self._board.axes])
        return True

    def _ok(self, method: str, *arguments: Any) -> bool:
        return bool(self._board.call(method, *arguments)[0])

    def _value(self, method: str, *arguments: Any, default: Any) -> Any:
        outcome, *values = self._board.call(method, *arguments)
        return values[0] if outcome and values else default


def fill(into: Any, values: Sequence[Any]) -> None:
    """Have the first elements of something be these; a list or a Vector that is too short becomes as long."""
    if not hasattr(into, "__setitem__"):
        raise TypeError(f"{into!r} cannot be filled in: give a DVector, an IVector, or a Vector")
    if len(into) < len(values) and hasattr(into, "resize"):
        into.resize(len(values))
    for i, value in enumerate(values):
        if isinstance(into, list) and i == len(into):
            into.append(value)
        else:
            into[i] = value


def _is_list(value: Any) -> bool:
    return hasattr(value, "__len__") and not isinstance(value, str)


def _numbers(values: Any) -> list[Any]:
    return [value.item() if hasattr(value, "item") else value for value in values]


def _chosen(arguments: tuple[Any, ...], values: int, name: str) -> tuple[str, list[Any], list[Any]]:
    """Which joints arguments are of, ``One``, ``All`` or ``Group``: the joints, and as many lists or values behind."""
    given = len(arguments) - values
    if given == 0 and all(map(_is_list, arguments)):
        return "All", [], list(arguments)
    if given == 1 and not _is_list(arguments[0]):
        return "One", [int(arguments[0])], list(arguments[1:])
    if given == 1:
        return "Group", [list(map(int, arguments[0]))], list(arguments[1:])
    if given == 2 and _is_list(arguments[1]):
        joints = list(map(int, arguments[1]))[: int(arguments[0])]
        return "Group", [joints], list(arguments[2:])
    raise TypeError(f"{name}: wrong arguments {arguments!r}")


def _setter(one: str = "", of_all: str = "", group: str = "", values: int = 1) -> Method:
    """A method that sets a value of one joint, of all, or of some."""
    methods = {"One": one, "All": of_all, "Group": group}

    def do(self: BoardView, *arguments: Any) -> bool:
        kind, joints, given = _chosen(arguments, values, methods["One"] or methods["All"])
        if kind == "All":
            given = [_numbers(value)[: self._board.axes] for value in given]
            if any(len(value) != self._board.axes for value in given):
                log.error("%s: %d joints want as many numbers", methods[kind], self._board.axes)
                return False
        elif kind == "Group":
            given = [_numbers(value)[: len(joints[0])] for value in given]
        if not methods[kind] or not (kind == "One" or all(_is_list(value) for value in given)):
            raise TypeError(f"{methods['One']}: wrong arguments {arguments!r}")
        return self._ok(methods[kind], *joints, *given)

    return do


def _asker(one: str = "", of_all: str = "", group: str = "", values: int = 1) -> Method:
    """A method that asks for values, which the last arguments become."""
    methods = {"One": one, "All": of_all, "Group": group}

    def ask(self: BoardView, *arguments: Any) -> bool:
        kind, joints, into = _chosen(arguments, values, methods["One"] or methods["All"])
        if not methods[kind]:
            raise TypeError(f"{methods['One']}: wrong arguments {arguments!r}")
        outcome, *found = self._board.call(methods[kind], *joints)
        if not outcome:
            return False
        for place, value in zip(into, found, strict=True):
            fill(place, value if isinstance(value, list) else [value])
        return True

    return ask


def _streamed(name: str, *, timed: bool = False) -> Method:
    """A method that fills in what the board streams, of all joints, of one or of some; ``timed``: and its times."""

    def ask(self: BoardView, *arguments: Any) -> bool:
        kind, joints, into = _chosen(arguments, 2 if timed else 1, name)
        found = self._board.state(name)
        if found is None:
            return False
        values, time = found
        chosen = range(len(values)) if kind == "All" else joints if kind == "One" else joints[0]
        if any(not 0 <= joint < len(values) for joint in chosen):
            log.error("%s: the board has no joint %s", name, list(chosen))
            return False
        fill(into[0], [values[joint].item() for joint in chosen])
        if timed:
            fill(into[1], [time] * len(chosen))
        return True

    return ask


def _streamed_value(name: str, default: Any) -> Method:
    """A method that returns what the board streams of one joint; or fills it in, as `_streamed` does."""
    filled = _streamed(name)

    def get(self: BoardView, *arguments: Any) -> Any:
        if len(arguments) != 1 or _is_list(arguments[0]):
            return filled(self, *arguments)
        found, joint = self._board.state(name), int(arguments[0])
        return found[0][joint].item() if found is not None and 0 <= joint < len(found[0]) else default

    return get


class IAxisInfo(BoardView):
    """Names and types of joints."""

    def getAxisName(self, axis: int) -> str:
        """The name of a joint; ``unknown`` where the board does not tell."""
        return str(self._value("getAxisNameRPC", axis, default="unknown"))

    def getJointType(self, axis: int) -> int:
        """The type of a joint, as ``VOCAB_JOINTTYPE_REVOLUTE``."""
        return int(self._value("getJointTypeRPC", axis, default=VOCAB_JOINTTYPE_UNKNOWN))


class IEncoders(BoardView):
    """Where joints are, and how they move."""

    resetEncoder = _setter("resetEncoderOneRPC", values=0)
    setEncoder = _setter("setEncoderOneRPC")
    setEncoders = _setter(of_all="setEncoderAllRPC")
    getEncoder = _streamed_value("jointPosition", 0.0)
    getEncoders = _streamed("jointPosition")
    getEncoderSpeed = _streamed_value("jointVelocity", 0.0)
    getEncoderSpeeds = _streamed("jointVelocity")
    getEncoderAcceleration = _streamed_value("jointAcceleration", 0.0)
    getEncoderAccelerations = _streamed("jointAcceleration")

    def resetEncoders(self) -> bool:
        """Let all joints be at 0."""
        return self._ok("resetEncoderAllRPC")


class IEncodersTimed(IEncoders):
    """The same, with times in seconds."""

    getEncoderTimed = _streamed("jointPosition", timed=True)
    getEncodersTimed = _streamed("jointPosition", timed=True)


class IMotorEncoders(BoardView):
    """Where motors are, and how they turn."""

    resetMotorEncoder = _setter("resetMotorEncoderRPC", values=0)
    setMotorEncoder = _setter("setMotorEncoderRPC")
    setMotorEncoders = _setter(of_all="setMotorEncodersAllRPC")
    getMotorEncoder = _streamed_value("motorPosition", 0.0)
    getMotorEncoders = _streamed("motorPosition")
    getMotorEncoderTimed = _streamed("motorPosition", timed=True)
    getMotorEncodersTimed = _streamed("motorPosition", timed=True)
    getMotorEncoderSpeed = _streamed_value("motorVelocity", 0.0)
    getMotorEncoderSpeeds = _streamed("motorVelocity")
    getMotorEncoderAcceleration = _streamed("motorAcceleration")
    getMotorEncoderAccelerations = _streamed("motorAcceleration")

    def getNumberOfMotorEncoders(self) -> int:
        """How many there are."""
        return int(self._value("getNumberOfMotorEncodersRPC", default=0))

    def resetMotorEncoders(self) -> bool:
        """Let all motors be at 0."""
        return self._ok("resetMotorEncodersRPC")


class IPositionControl(BoardView):
    """Moves along a trajectory to a position."""

    positionMove = _setter("positionMoveOneRPC", "positionMoveAllRPC", "positionMoveGroupRPC")
    relativeMove = _setter("relativeMoveOneRPC", "relativeMoveAllRPC", "relativeMoveGroupRPC")
    setTrajSpeed = setRefSpeed = _setter("setTrajSpeedOneRPC")
    setTrajSpeeds = setRefSpeeds = _setter("", "setTrajSpeedAllRPC", "setTrajSpeedGroupRPC")
    getTrajSpeed = getRefSpeed = _asker("getTrajSpeedOneRPC")
    getTrajSpeeds = getRefSpeeds = _asker("", "getTrajSpeedsAllRPC", "getTrajSpeedsGroupRPC")
    setTrajAcceleration = setRefAcceleration = _setter("setTrajAccelerationOneRPC")
    setTrajAccelerations = setRefAccelerations = _setter(
        "", "setTrajAccelerationsAllRPC", "setTrajAccelerationsGroupRPC"
    )
    getTrajAcceleration = getRefAcceleration = _asker("getTrajAccelerationOneRPC")
    getTrajAccelerations = getRefAccelerations = _asker("", "getTrajAccelerationAllRPC", "getTrajAccelerationGroupRPC")
    getTargetPosition = _asker("getTargetPositionOneRPC")
    getTargetPositions = _asker("", "getTargetPositionAllRPC", "getTargetPositionGroupRPC")
    _stop = _setter("stopOneRPC", "", "stopGroupRPC", values=0)
    _motion_done = _asker("checkMotionDoneOneRPC", "checkMotionDoneAllRPC", "checkMotionDoneGroupRPC")

    def stop(self, *joints: Any) -> bool:
        """Stop a joint, some, or all."""
        return self._stop(*joints) if joints else self._ok("stopAllRPC")

    def checkMotionDone(self, *arguments: Any) -> bool:
        """Whether all motions are done, also where the board does not tell; or a flag becomes it, of which joints."""
        if not arguments:
            return bool(self._value("checkMotionDoneAllRPC", default=True))
        return bool(self._motion_done(*arguments))

    def isMotionDone(self, joint: int | None = None) -> bool:
        """Whether the motion of a joint, or of all, is done; not, where the board does not tell."""
        if joint is None:
            return bool(self._value("checkMotionDoneAllRPC", default=False))
        return bool(self._value("checkMotionDoneOneRPC", int(joint), default=False))


class IPositionDirect(BoardView):
    """Sets positions at once, without a trajectory."""

    setPosition = setRefPosition = _setter("setRefPositionOneRPC")
    setPositions = setRefPositions = _setter("", "setRefPositionAllRPC", "setRefPositionGroupRPC")
    getRefPosition = _asker("getRefPositionOneRPC")
    getRefPositions = _asker("", "getRefPositionAllRPC", "getRefPositionGroupRPC")


class IVelocityControl(BoardView):
    """Moves with a velocity. Midspan's own boards stop where it is not said again (`docs/yarp/boards.md`)."""

    velocityMove = _setter("velocityMoveOneRPC", "velocityMoveAllRPC", "velocityMoveGroupRPC")
    getTargetVelocity = getRefVelocity = _asker("getTargetVelocityOneRPC")
    getTargetVelocities = getRefVelocities = _asker("", "getTargetVelocityAllRPC", "getTargetVelocityGroupRPC")
    setTrajAcceleration = setRefAcceleration = IPositionControl.setTrajAcceleration
    setTrajAccelerations = setRefAccelerations = IPositionControl.setTrajAccelerations
    getTrajAcceleration = getRefAcceleration = IPositionControl.getTrajAcceleration
    getTrajAccelerations = getRefAccelerations = IPositionControl.getTrajAccelerations
    _stop = IPositionControl._stop
    stop = IPositionControl.stop


class ITorqueControl(BoardView):
    """Torques, in newton metres."""

    setRefTorque = _setter("setRefTorqueOneRPC")
    setRefTorques = _setter("", "setRefTorqueAllRPC", "setRefTorqueGroupRPC")
    getRefTorque = _asker("getRefTorqueOneRPC")
    getRefTorques = _asker("", "getRefTorqueAllRPC")
    getTorque = _streamed("torque")
    getTorques = _streamed("torque")
    getTorqueRange = _asker("getTorqueRangeOneRPC", values=2)
    getTorqueRanges = _asker("", "getTorqueRangeAllRPC", values=2)


class _Motors(BoardView):
    def getNumberOfMotors(self) -> int:
        """How many motors there are."""
        return self._board.axes


class IPWMControl(_Motors):
    """Duty cycles, in per cent."""

    setRefDutyCycle = _setter("setRefDutyCycleOneRPC")
    setRefDutyCycles = _setter("", "setRefDutyCycleAllRPC")
    getRefDutyCycle = _asker("getRefDutyCycleOneRPC")
    getRefDutyCycles = _asker("", "getRefDutyCycleAllRPC")
    getDutyCycle = _streamed("pwmDutycycle")
    getDutyCycles = _streamed("pwmDutycycle")


class ICurrentControl(_Motors):
    """Currents, in amperes."""

    setRefCurrent = _setter("setRefCurrentOneRPC")
    setRefCurrents = _setter("", "setRefCurrentAllRPC", "setRefCurrentGroupRPC")
    getRefCurrent = _asker("getRefCurrentOneRPC")
    getRefCurrents = _asker("", "getRefCurrentAllRPC")
    getCurrent = _streamed("current")
    getCurrents = _streamed("current")
    getCurrentRange = _asker("getCurrentRangeOneRPC", values=2)
    getCurrentRanges = _asker("", "getCurrentRangeAllRPC", values=2)


class IMotor(_Motors):
    """The motors themselves: degrees Celsius."""

    getTemperature = _asker("getTemperatureOneRPC")
    getTemperatures = _asker("", "getTemperatureAllRPC")
    getTemperatureLimit = _asker("getTemperatureLimitRPC")
    setTemperatureLimit = _setter("setTemperatureLimitRPC")
    getGearboxRatio = _asker("getGearboxRatioRPC")
    setGearboxRatio = _setter("setGearboxRatioRPC")


class IAmplifierControl(BoardView):
    """What drives the motors: amperes, per cent, volts."""

    enableAmp = _setter("enableAmpRPC", values=0)
    disableAmp = _setter("disableAmpRPC", values=0)
    getAmpStatus = _asker("getAmpStatusOneRPC", "getAmpStatusAllRPC")
    getCurrent = _streamed("current")
    getCurrents = _streamed("current")
    getMaxCurrent = _asker("getMaxCurrentRPC")
    setMaxCurrent = _setter("setMaxCurrentRPC")
    getNominalCurrent = _asker("getNominalCurrentRPC")
    setNominalCurrent = _setter("setNominalCurrentRPC")
    getPeakCurrent = _asker("getPeakCurrentRPC")
    setPeakCurrent = _setter("setPeakCurrentRPC")
    getPWM = _streamed("pwmDutycycle")
    getPWMLimit = _asker("getPWMLimitRPC")
    setPWMLimit = _setter("setPWMLimitRPC")
    getPowerSupplyVoltage = _asker("getPowerSupplyVoltageRPC")


class IControlLimits(BoardView):
    """The least and the greatest position and velocity."""

    setPosLimits = setLimits = _setter("setPosLimitsRPC", values=2)
    getPosLimits = getLimits = _asker("getPosLimitsRPC", values=2)
    setVelLimits = _setter("setVelLimitsRPC", values=2)
    getVelLimits = _asker("getVelLimitsRPC", values=2)


class IControlMode(BoardView):
    """What joints are driven by: position, velocity, torque, ..."""

    setControlMode = _setter("setControlModeOneRPC")
    setControlModes = _setter("", "setControlModeAllRPC", "setControlModeGroupRPC")
    getControlModes = _streamed("controlMode")

    def getControlMode(self, joint: int) -> int:
        """The mode of a joint, as ``VOCAB_CM_POSITION``."""
        return int(_CONTROL_MODE(self, joint))


class IInteractionMode(BoardView):
    """Whether joints are stiff or compliant."""

    setInteractionMode = _setter("setInteractionModeOneRPC")
    setInteractionModes = _setter("", "setInteractionModesAllRPC", "setInteractionModesGroupRPC")
    getInteractionModes = _streamed("interactionMode")

    def getInteractionMode(self, joint: int) -> int:
        """The mode of a joint, as ``VOCAB_IM_STIFF``."""
        return int(_INTERACTION_MODE(self, joint))


_CONTROL_MODE = _streamed_value("controlMode", VOCAB_CM_UNKNOWN)
_INTERACTION_MODE = _streamed_value("interactionMode", VOCAB_IM_UNKNOWN)


class IRemoteVariables(BoardView):
    """Values of the board under names."""

    def getRemoteVariable(self, key: str, value: Bottle) -> bool:
        """A Bottle becomes the value of this name; whether there is one."""
        found = self._value("getRemoteVariableRPC", key, default=None)
        if found is None:
            return False
        value.copy(found)
        return True

    def setRemoteVariable(self, key: str, value: Bottle) -> bool:
        """Change a value."""
        return self._ok("setRemoteVariableRPC", key, value)

    def getRemoteVariablesList(self, names: Bottle) -> bool:
        """A Bottle becomes the names."""
        found = self._value("getRemoteVariablesListRPC", default=None)
        if found is None:
            return False
        names.copy(found[0] if found else Bottle())
        return True


class IPreciselyTimed(BoardView):
    """The time of what was read."""

    def getLastInputStamp(self) -> Stamp:
        """Of the newest state."""
        return self._board.stamp()


VIEWS = (
    IAxisInfo, IEncoders, IEncodersTimed, IMotorEncoders, IPositionControl, IPositionDirect, IVelocityControl,
    ITorqueControl, IPWMControl, ICurrentControl, IMotor, IAmplifierControl, IControlLimits, IControlMode,
    IInteractionMode, IRemoteVariables, IPreciselyTimed,
)  # fmt: skip
"""The interfaces that a board is viewed as."""
