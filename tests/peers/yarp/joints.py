"""A joint board that reaches every commanded position at once."""

# ruff: noqa: ARG002 - names and arguments are those of the interface

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from yarp_compat.dev.controlboard.board import JointBoard
from yarp_compat.dev.controlboard.modes import (
    VOCAB_CM_IDLE,
    VOCAB_CM_POSITION,
    VOCAB_CM_VELOCITY,
    VOCAB_IM_STIFF,
    VOCAB_JOINTTYPE_REVOLUTE,
)
from yarp_compat.dev.controlboard.streams import JointData
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.os.data.bottle import Bottle

AXES = 3


class Joints(JointBoard):
    """A board that stores every quantity of its joints. A move in position mode ends at once."""

    def __init__(self, axes: int = AXES) -> None:
        super().__init__(axes)
        self.quantities: dict[str, list[float]] = {}
        self.modes = [VOCAB_CM_POSITION] * axes
        self.interaction = [VOCAB_IM_STIFF] * axes
        self.variables: dict[str, Bottle] = {}
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self._lock = threading.RLock()

    def run(self, call: Callable[[], Any]) -> Any:
        """Run a call under the board's lock."""
        with self._lock:
            return call()

    def of(self, quantity: str) -> list[float]:
        """Return a quantity's values for all joints."""
        return self.quantities.setdefault(quantity, [0.0] * self.axes)

    def control_mode(self, joint: int) -> int:
        """Return the control mode of a joint."""
        return self.modes[joint]

    def state(self) -> JointData:
        """Return those stored quantities that are streamed."""
        values = {name: np.array(self.of(quantity)) for name, quantity in STREAMED.items()}
        values |= {"controlMode": np.array(self.modes), "interactionMode": np.array(self.interaction)}
        return JointData(self.axes, values)

    def getAxisNameRPC(self, j: int) -> tuple[ReturnValue, str]:
        return OK, f"joint{j}"

    def getJointTypeRPC(self, j: int) -> tuple[ReturnValue, int]:
        return OK, VOCAB_JOINTTYPE_REVOLUTE

    def setControlModeOneRPC(self, j: int, mod: int) -> ReturnValue:
        if mod not in (VOCAB_CM_IDLE, VOCAB_CM_POSITION, VOCAB_CM_VELOCITY) and mod < 1000:
            raise CallFailed(ReturnCode.METHOD_FAILED, f"no mode {mod}")
        self.modes[j] = mod
        return OK

    def setInteractionModeOneRPC(self, axis: int, mode: int) -> ReturnValue:
        self.interaction[axis] = mode
        return OK

    def getInteractionModeOneRPC(self, axis: int) -> tuple[ReturnValue, int]:
        return OK, self.interaction[axis]

    def positionMoveOneRPC(self, j: int, ref: float) -> ReturnValue:
        if self.modes[j] != VOCAB_CM_POSITION:
            raise CallFailed(ReturnCode.METHOD_FAILED, f"joint {j} is not in position mode")
        self.of("target")[j] = ref
        self.of("position")[j] = ref
        return OK

    def relativeMoveOneRPC(self, j: int, delta: float) -> ReturnValue:
        return self.positionMoveOneRPC(j, self.of("position")[j] + delta)

    def checkMotionDoneOneRPC(self, j: int) -> tuple[ReturnValue, bool]:
        return OK, self.of("target")[j] == self.of("position")[j]

    def stopOneRPC(self, j: int) -> ReturnValue:
        self.of("velocity")[j] = 0.0
        return OK

    def setPosLimitsRPC(self, j: int, min: float, max: float) -> ReturnValue:  # noqa: A002
        self.of("least")[j], self.of("greatest")[j] = min, max
        return OK

    def getPosLimitsRPC(self, j: int) -> tuple[ReturnValue, float, float]:
        return OK, self.of("least")[j], self.of("greatest")[j]

    def getVelLimitsRPC(self, j: int) -> tuple[ReturnValue, float, float]:
        return OK, 0.0, 100.0

    def getTorqueRangeOneRPC(self, j: int) -> tuple[ReturnValue, float, float]:
        return OK, -1.0, 1.0

    def resetEncoderOneRPC(self, j: int) -> ReturnValue:
        self.of("position")[j] = 0.0
        return OK

    def getRemoteVariableRPC(self, key: str) -> tuple[ReturnValue, Bottle]:
        if key not in self.variables:
            raise CallFailed(ReturnCode.METHOD_FAILED, key)
        return OK, self.variables[key]

    def setRemoteVariableRPC(self, key: str, val: Bottle) -> ReturnValue:
        self.variables[key] = Bottle(val)
        return OK

    def getRemoteVariablesListRPC(self) -> tuple[ReturnValue, list[Bottle]]:
        return OK, [Bottle(sorted(self.variables))]


STREAMED = {
    "jointPosition": "position", "jointVelocity": "velocity", "jointAcceleration": "acceleration",
    "torque": "torque", "pwmDutycycle": "pwm", "current": "current",
}  # fmt: skip


def _define(name: str, quantity: str) -> None:
    def set_one(self: Joints, j: int, value: float) -> ReturnValue:
        self.of(quantity)[j] = value
        return OK

    def get_one(self: Joints, j: int) -> tuple[ReturnValue, float]:
        return OK, self.of(quantity)[j]

    setattr(Joints, name, set_one if name.startswith(("set", "velocity")) else get_one)


for _name, _quantity in {
    "setTrajSpeedOneRPC": "speed", "getTrajSpeedOneRPC": "speed",
    "setTrajAccelerationOneRPC": "ramp", "getTrajAccelerationOneRPC": "ramp",
    "getTargetPositionOneRPC": "target",
    "setRefPositionOneRPC": "position", "getRefPositionOneRPC": "position",
    "velocityMoveOneRPC": "velocity", "getTargetVelocityOneRPC": "velocity",
    "setRefTorqueOneRPC": "torque", "getRefTorqueOneRPC": "torque",
    "setRefDutyCycleOneRPC": "pwm", "getRefDutyCycleOneRPC": "pwm", "getDutyCycleOneRPC": "pwm",
    "setRefCurrentOneRPC": "current", "getRefCurrentOneRPC": "current", "getCurrentOneRPC": "current",
    "setEncoderOneRPC": "position", "getEncoderOneRPC": "position", "getEncoderSpeedOneRPC": "velocity",
}.items():  # fmt: skip
    _define(_name, _quantity)
