"""A control board's interfaces as scripts use them, ``driver.viewIEncoders().getEncoders(encs)`` (``bindings/yarp.i``).

A method whose name differs between YARP 3 and 4 has both names: ``setRefSpeed`` is ``setTrajSpeed``, ``getLimits`` is
``getPosLimits``. Units: degrees, degrees per second, newton meters, percent, amperes; a mode is a vocab's number
(``VOCAB_CM_POSITION``).

Setters return whether they succeeded, and so do getters that store results in their last arguments (a ``DVector``, an
``IVector``, a ``Vector`` or its ``data()``). ``getEncoder(j)``, ``getControlMode(j)``, ``getAxisName(j)`` and the like
return the value itself, as the bindings do, or 0, the name ``unknown`` or a vocab such as ``VOCAB_CM_UNKNOWN`` if the
value is missing. Joints are given as ``(j, ...)``, ``(n, joints, ...)`` or ``(joints, ...)``; without joints, a
method applies to all of them.
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
    """The base class of a board's interfaces."""

    def __init__(self, board: ControlBoardClient) -> None:
        self._board = board

    def getAxes(self, axes: Any = None) -> Any:
        """Return the number of joints; or store it in ``axes`` and return True."""
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
    """Overwrite the first elements of a container; a list or a Vector that is too short grows."""
    if not hasattr(into, "__setitem__"):
        raise TypeError(f"{into!r} cannot be filled in: pass a DVector, an IVector, or a Vector")
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


def _split(arguments: tuple[Any, ...], values: int, name: str) -> tuple[str, list[Any], list[Any]]:
    """Split arguments into the kind (``One``, ``All`` or ``Group``), the joints, and the last ``values`` arguments."""
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
    """Make a method that sets ``values`` values of one joint, all or some, by the server's method for each case."""
    methods = {"One": one, "All": of_all, "Group": group}

    def do(self: BoardView, *arguments: Any) -> bool:
        kind, joints, given = _split(arguments, values, methods["One"] or methods["All"])
        if kind == "All":
            given = [_numbers(value)[: self._board.axes] for value in given]
            if any(len(value) != self._board.axes for value in given):
                log.error("%s: a board of %d joints needs one number for each", methods[kind], self._board.axes)
                return False
        elif kind == "Group":
            given = [_numbers(value)[: len(joints[0])] for value in given]
        if not methods[kind] or not (kind == "One" or all(_is_list(value) for value in given)):
            raise TypeError(f"{methods['One']}: wrong arguments {arguments!r}")
        return self._ok(methods[kind], *joints, *given)

    return do


def _getter(one: str = "", of_all: str = "", group: str = "", values: int = 1) -> Method:
    """Make a method that requests values from the server, and stores them in its last ``values`` arguments."""
    methods = {"One": one, "All": of_all, "Group": group}

    def ask(self: BoardView, *arguments: Any) -> bool:
        kind, joints, into = _split(arguments, values, methods["One"] or methods["All"])
        if not methods[kind]:
            raise TypeError(f"{methods['One']}: wrong arguments {arguments!r}")
        outcome, *returned = self._board.call(methods[kind], *joints)
        if not outcome:
            return False
        for place, value in zip(into, returned, strict=True):
            fill(place, value if isinstance(value, list) else [value])
        return True

    return ask


def _stream_getter(name: str, *, timed: bool = False) -> Method:
    """Make a method that stores a streamed quantity of one joint, some or all, in its last argument.

    ``timed``: the last two arguments receive the quantity and its times.
    """

    def ask(self: BoardView, *arguments: Any) -> bool:
        kind, joints, into = _split(arguments, 2 if timed else 1, name)
        state = self._board.state(name)
        if state is None:
            return False
        values, time = state
        chosen = range(len(values)) if kind == "All" else joints if kind == "One" else joints[0]
        if any(not 0 <= joint < len(values) for joint in chosen):
            log.error("%s: the board has no joint %s", name, list(chosen))
            return False
        fill(into[0], [values[joint].item() for joint in chosen])
        if timed:
            fill(into[1], [time] * len(chosen))
        return True

    return ask


def _stream_value_getter(name: str, default: Any) -> Method:
    """Make a method that returns a streamed quantity of one joint, or stores it like the method of `_stream_getter`."""
    filled = _stream_getter(name)

    def get(self: BoardView, *arguments: Any) -> Any:
        if len(arguments) != 1 or _is_list(arguments[0]):
            return filled(self, *arguments)
        state, joint = self._board.state(name), int(arguments[0])
        return state[0][joint].item() if state is not None and 0 <= joint < len(state[0]) else default

    return get


class IAxisInfo(BoardView):
    """Names and types of joints."""

    def getAxisName(self, axis: int) -> str:
        """Return the name of a joint; ``unknown`` if the board does not report it."""
        return str(self._value("getAxisNameRPC", axis, default="unknown"))

    def getJointType(self, axis: int) -> int:
        """Return the type of a joint, such as ``VOCAB_JOINTTYPE_REVOLUTE``."""
        return int(self._value("getJointTypeRPC", axis, default=VOCAB_JOINTTYPE_UNKNOWN))


class IEncoders(BoardView):
    """Positions, velocities and accelerations of joints."""

    resetEncoder = _setter("resetEncoderOneRPC", values=0)
    setEncoder = _setter("setEncoderOneRPC")
    setEncoders = _setter(of_all="setEncoderAllRPC")
    getEncoder = _stream_value_getter("jointPosition", 0.0)
    getEncoders = _stream_getter("jointPosition")
    getEncoderSpeed = _stream_value_getter("jointVelocity", 0.0)
    getEncoderSpeeds = _stream_getter("jointVelocity")
    getEncoderAcceleration = _stream_value_getter("jointAcceleration", 0.0)
    getEncoderAccelerations = _stream_getter("jointAcceleration")

    def resetEncoders(self) -> bool:
        """Set the encoders of all joints to 0."""
        return self._ok("resetEncoderAllRPC")


class IEncodersTimed(IEncoders):
    """Encoders with times in seconds."""

    getEncoderTimed = _stream_getter("jointPosition", timed=True)
    getEncodersTimed = _stream_getter("jointPosition", timed=True)


class IMotorEncoders(BoardView):
    """Positions, velocities and accelerations of motors."""

    resetMotorEncoder = _setter("resetMotorEncoderRPC", values=0)
    setMotorEncoder = _setter("setMotorEncoderRPC")
    setMotorEncoders = _setter(of_all="setMotorEncodersAllRPC")
    getMotorEncoder = _stream_value_getter("motorPosition", 0.0)
    getMotorEncoders = _stream_getter("motorPosition")
    getMotorEncoderTimed = _stream_getter("motorPosition", timed=True)
    getMotorEncodersTimed = _stream_getter("motorPosition", timed=True)
    getMotorEncoderSpeed = _stream_value_getter("motorVelocity", 0.0)
    getMotorEncoderSpeeds = _stream_getter("motorVelocity")
    getMotorEncoderAcceleration = _stream_getter("motorAcceleration")
    getMotorEncoderAccelerations = _stream_getter("motorAcceleration")

    def getNumberOfMotorEncoders(self) -> int:
        """Return the number of motor encoders."""
        return int(self._value("getNumberOfMotorEncodersRPC", default=0))

    def resetMotorEncoders(self) -> bool:
        """Set the encoders of all motors to 0."""
        return self._ok("resetMotorEncodersRPC")


class IPositionControl(BoardView):
    """Moves to a position along a trajectory."""

    positionMove = _setter("positionMoveOneRPC", "positionMoveAllRPC", "positionMoveGroupRPC")
    relativeMove = _setter("relativeMoveOneRPC", "relativeMoveAllRPC", "relativeMoveGroupRPC")
    setTrajSpeed = setRefSpeed = _setter("setTrajSpeedOneRPC")
    setTrajSpeeds = setRefSpeeds = _setter("", "setTrajSpeedAllRPC", "setTrajSpeedGroupRPC")
    getTrajSpeed = getRefSpeed = _getter("getTrajSpeedOneRPC")
    getTrajSpeeds = getRefSpeeds = _getter("", "getTrajSpeedsAllRPC", "getTrajSpeedsGroupRPC")
    setTrajAcceleration = setRefAcceleration = _setter("setTrajAccelerationOneRPC")
    setTrajAccelerations = setRefAccelerations = _setter(
        "", "setTrajAccelerationsAllRPC", "setTrajAccelerationsGroupRPC"
    )
    getTrajAcceleration = getRefAcceleration = _getter("getTrajAccelerationOneRPC")
    getTrajAccelerations = getRefAccelerations = _getter("", "getTrajAccelerationAllRPC", "getTrajAccelerationGroupRPC")
    getTargetPosition = _getter("getTargetPositionOneRPC")
    getTargetPositions = _getter("", "getTargetPositionAllRPC", "getTargetPositionGroupRPC")
    _stop = _setter("stopOneRPC", "", "stopGroupRPC", values=0)
    _motion_done = _getter("checkMotionDoneOneRPC", "checkMotionDoneAllRPC", "checkMotionDoneGroupRPC")

    def stop(self, *joints: Any) -> bool:
        """Stop one joint, some, or all."""
        return self._stop(*joints) if joints else self._ok("stopAllRPC")

    def checkMotionDone(self, *arguments: Any) -> bool:
        """Whether all motions are done; True if the board does not report it.

        With arguments, store the result for the given joints in the last one; return whether the board reports it.
        """
        if not arguments:
            return bool(self._value("checkMotionDoneAllRPC", default=True))
        return bool(self._motion_done(*arguments))

    def isMotionDone(self, joint: int | None = None) -> bool:
        """Whether the motion of a joint, or of all, is done; False if the board does not report it."""
        if joint is None:
            return bool(self._value("checkMotionDoneAllRPC", default=False))
        return bool(self._value("checkMotionDoneOneRPC", int(joint), default=False))


class IPositionDirect(BoardView):
    """Sets positions directly, without a trajectory."""

    setPosition = setRefPosition = _setter("setRefPositionOneRPC")
    setPositions = setRefPositions = _setter("", "setRefPositionAllRPC", "setRefPositionGroupRPC")
    getRefPosition = _getter("getRefPositionOneRPC")
    getRefPositions = _getter("", "getRefPositionAllRPC", "getRefPositionGroupRPC")


class IVelocityControl(BoardView):
    """Moves with a velocity. Midspan's own boards stop unless the command is repeated (`docs/yarp/boards.md`)."""

    velocityMove = _setter("velocityMoveOneRPC", "velocityMoveAllRPC", "velocityMoveGroupRPC")
    getTargetVelocity = getRefVelocity = _getter("getTargetVelocityOneRPC")
    getTargetVelocities = getRefVelocities = _getter("", "getTargetVelocityAllRPC", "getTargetVelocityGroupRPC")
    setTrajAcceleration = setRefAcceleration = IPositionControl.setTrajAcceleration
    setTrajAccelerations = setRefAccelerations = IPositionControl.setTrajAccelerations
    getTrajAcceleration = getRefAcceleration = IPositionControl.getTrajAcceleration
    getTrajAccelerations = getRefAccelerations = IPositionControl.getTrajAccelerations
    _stop = IPositionControl._stop
    stop = IPositionControl.stop


class ITorqueControl(BoardView):
    """Torques, in newton meters."""

    setRefTorque = _setter("setRefTorqueOneRPC")
    setRefTorques = _setter("", "setRefTorqueAllRPC", "setRefTorqueGroupRPC")
    getRefTorque = _getter("getRefTorqueOneRPC")
    getRefTorques = _getter("", "getRefTorqueAllRPC")
    getTorque = _stream_getter("torque")
    getTorques = _stream_getter("torque")
    getTorqueRange = _getter("getTorqueRangeOneRPC", values=2)
    getTorqueRanges = _getter("", "getTorqueRangeAllRPC", values=2)


class _Motors(BoardView):
    def getNumberOfMotors(self) -> int:
        return self._board.axes


class IPWMControl(_Motors):
    """Duty cycles, in percent."""

    setRefDutyCycle = _setter("setRefDutyCycleOneRPC")
    setRefDutyCycles = _setter("", "setRefDutyCycleAllRPC")
    getRefDutyCycle = _getter("getRefDutyCycleOneRPC")
    getRefDutyCycles = _getter("", "getRefDutyCycleAllRPC")
    getDutyCycle = _stream_getter("pwmDutycycle")
    getDutyCycles = _stream_getter("pwmDutycycle")


class ICurrentControl(_Motors):
    """Currents, in amperes."""

    setRefCurrent = _setter("setRefCurrentOneRPC")
    setRefCurrents = _setter("", "setRefCurrentAllRPC", "setRefCurrentGroupRPC")
    getRefCurrent = _getter("getRefCurrentOneRPC")
    getRefCurrents = _getter("", "getRefCurrentAllRPC")
    getCurrent = _stream_getter("current")
    getCurrents = _stream_getter("current")
    getCurrentRange = _getter("getCurrentRangeOneRPC", values=2)
    getCurrentRanges = _getter("", "getCurrentRangeAllRPC", values=2)


class IMotor(_Motors):
    """Temperatures (degrees Celsius) and gearbox ratios of motors."""

    getTemperature = _getter("getTemperatureOneRPC")
    getTemperatures = _getter("", "getTemperatureAllRPC")
    getTemperatureLimit = _getter("getTemperatureLimitRPC")
    setTemperatureLimit = _setter("setTemperatureLimitRPC")
    getGearboxRatio = _getter("getGearboxRatioRPC")
    setGearboxRatio = _setter("setGearboxRatioRPC")


class IAmplifierControl(BoardView):
    """The amplifiers of the motors: amperes, percent, volts."""

    enableAmp = _setter("enableAmpRPC", values=0)
    disableAmp = _setter("disableAmpRPC", values=0)
    getAmpStatus = _getter("getAmpStatusOneRPC", "getAmpStatusAllRPC")
    getCurrent = _stream_getter("current")
    getCurrents = _stream_getter("current")
    getMaxCurrent = _getter("getMaxCurrentRPC")
    setMaxCurrent = _setter("setMaxCurrentRPC")
    getNominalCurrent = _getter("getNominalCurrentRPC")
    setNominalCurrent = _setter("setNominalCurrentRPC")
    getPeakCurrent = _getter("getPeakCurrentRPC")
    setPeakCurrent = _setter("setPeakCurrentRPC")
    getPWM = _stream_getter("pwmDutycycle")
    getPWMLimit = _getter("getPWMLimitRPC")
    setPWMLimit = _setter("setPWMLimitRPC")
    getPowerSupplyVoltage = _getter("getPowerSupplyVoltageRPC")


class IControlLimits(BoardView):
    """The limits of position and velocity."""

    setPosLimits = setLimits = _setter("setPosLimitsRPC", values=2)
    getPosLimits = getLimits = _getter("getPosLimitsRPC", values=2)
    setVelLimits = _setter("setVelLimitsRPC", values=2)
    getVelLimits = _getter("getVelLimitsRPC", values=2)


class IControlMode(BoardView):
    """The control mode of joints: position, velocity, torque, ..."""

    setControlMode = _setter("setControlModeOneRPC")
    setControlModes = _setter("", "setControlModeAllRPC", "setControlModeGroupRPC")
    getControlModes = _stream_getter("controlMode")

    def getControlMode(self, joint: int) -> int:
        """Return the mode of a joint, such as ``VOCAB_CM_POSITION``."""
        return int(_CONTROL_MODE(self, joint))


class IInteractionMode(BoardView):
    """Whether joints are stiff or compliant."""

    setInteractionMode = _setter("setInteractionModeOneRPC")
    setInteractionModes = _setter("", "setInteractionModesAllRPC", "setInteractionModesGroupRPC")
    getInteractionModes = _stream_getter("interactionMode")

    def getInteractionMode(self, joint: int) -> int:
        """Return the mode of a joint, such as ``VOCAB_IM_STIFF``."""
        return int(_INTERACTION_MODE(self, joint))


_CONTROL_MODE = _stream_value_getter("controlMode", VOCAB_CM_UNKNOWN)
_INTERACTION_MODE = _stream_value_getter("interactionMode", VOCAB_IM_UNKNOWN)


class IRemoteVariables(BoardView):
    """Named variables of the board."""

    def getRemoteVariable(self, key: str, value: Bottle) -> bool:
        """Store a variable's value in a Bottle; return False if the board has no variable of this name."""
        variable = self._value("getRemoteVariableRPC", key, default=None)
        if variable is None:
            return False
        value.copy(variable)
        return True

    def setRemoteVariable(self, key: str, value: Bottle) -> bool:
        """Set a variable."""
        return self._ok("setRemoteVariableRPC", key, value)

    def getRemoteVariablesList(self, names: Bottle) -> bool:
        """Store the names of all variables in a Bottle."""
        variables = self._value("getRemoteVariablesListRPC", default=None)
        if variables is None:
            return False
        names.copy(variables[0] if variables else Bottle())
        return True


class IPreciselyTimed(BoardView):
    """The time stamp of the last state."""

    def getLastInputStamp(self) -> Stamp:
        """Return the sequence number and time of the newest state."""
        return self._board.stamp()


VIEWS = (
    IAxisInfo, IEncoders, IEncodersTimed, IMotorEncoders, IPositionControl, IPositionDirect, IVelocityControl,
    ITorqueControl, IPWMControl, ICurrentControl, IMotor, IAmplifierControl, IControlLimits, IControlMode,
    IInteractionMode, IRemoteVariables, IPreciselyTimed,
)  # fmt: skip
"""The interfaces of a board."""
