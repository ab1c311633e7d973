"""The wheels as a YARP control board, for scripts that command a robot's ``/cer/mobile_base`` (`docs/yarp/boards.md`).

Units are degrees, degrees per second and, for duty cycles, percent; the modes are position, position direct, velocity,
PWM and idle. A velocity or duty cycle expires after the same time as a command on ``/cmd_vel``; a wheel that reaches
its position stays there. While the board has an active command for any wheel, other command sources are ignored. The
emergency stop cancels all commands.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from typing_extensions import override

from sim.base import Base, Encoders, Floats
from yarp_compat.dev.controlboard import modes
from yarp_compat.dev.controlboard.board import JointBoard
from yarp_compat.dev.controlboard.streams import JointData
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue

_SPEED, _RAMP = 30.0, 60.0  # defaults of position moves: degrees per second, and per second squared
_THERE = 0.2  # degrees from its target within which a wheel has reached it
_MODES = frozenset(
    (
        modes.VOCAB_CM_POSITION,
        modes.VOCAB_CM_POSITION_DIRECT,
        modes.VOCAB_CM_VELOCITY,
        modes.VOCAB_CM_PWM,
        modes.VOCAB_CM_IDLE,
    )
)
_TO_POSITIONS = (modes.VOCAB_CM_POSITION, modes.VOCAB_CM_POSITION_DIRECT)


class WheelCommands:
    """The board's commands, and the wheel velocities that follow from them. Used only on the simulation's thread."""

    def __init__(self, base: Base, now_ns: int = 0) -> None:
        count = len(base.names)
        self.names = base.names
        self.greatest = math.degrees(base.robot.wheels.max_velocity)
        self._timeout = round(base.robot.limits.timeout * 1e9)
        self.modes = [modes.VOCAB_CM_VELOCITY] * count
        self.speeds, self.ramps = np.full(count, _SPEED), np.full(count, _RAMP)
        self.targets: list[float | None] = [None] * count  # targets of position moves, degrees
        self.velocities = np.zeros(count)  # last commanded, degrees per second
        self._until = [0] * count
        self.zero = np.zeros(count)  # wheel angles at which the reported positions are 0, degrees
        self.now_ns = now_ns
        self._encoders = Encoders(0, np.zeros(count), np.zeros(count))
        self._output = np.zeros(count)  # velocities for the motors, degrees per second

    def read(self, encoders: Encoders) -> None:
        """Store a reading of the encoders."""
        self._encoders = encoders

    def positions(self) -> Floats:
        """Return the wheels' angles, in degrees."""
        return np.degrees(self._encoders.positions) - self.zero

    def measured_velocities(self) -> Floats:
        """Return the wheels' velocities, in degrees per second."""
        return np.degrees(self._encoders.velocities)

    def mode(self, wheel: int, mode: int) -> None:
        """Set a wheel's control mode, and cancel its command."""
        self.modes[wheel] = mode
        self.release(wheel)

    def release(self, wheel: int) -> None:
        """Cancel a wheel's command."""
        self.targets[wheel] = None
        self.velocities[wheel] = self._output[wheel] = 0.0
        self._until[wheel] = 0

    def halt(self) -> None:
        """Cancel the commands of all wheels."""
        for wheel in range(len(self.names)):
            self.release(wheel)

    def turn(self, wheel: int, velocity: float) -> None:
        """Command a velocity, which expires after the timeout."""
        self.velocities[wheel] = min(self.greatest, max(-self.greatest, velocity))
        self._until[wheel] = self.now_ns + self._timeout

    def duties(self) -> Floats:
        """Return the commanded duty cycles in percent; 0 for expired commands and wheels in other modes."""
        driven = [self.modes[w] == modes.VOCAB_CM_PWM and self._has_command(w) for w in range(len(self.names))]
        return np.where(driven, 100.0 * self.velocities / self.greatest, 0.0)

    def next_velocities(self, seconds: float) -> Floats | None:
        """Return wheel velocities (radians per second) for the next ``seconds``; None if no command is active."""
        if not any(self._has_command(wheel) for wheel in range(len(self.names))):
            return None
        positions = self.positions()
        for wheel, target in enumerate(self.targets):
            if self.modes[wheel] in _TO_POSITIONS:
                self._output[wheel] = 0.0 if target is None else self._toward(wheel, target - positions[wheel], seconds)
            else:
                self._output[wheel] = self.velocities[wheel] if self.now_ns < self._until[wheel] else 0.0
        return np.radians(self._output)

    def is_done(self, wheel: int) -> bool:
        """Return whether a wheel has reached its target, or has no target."""
        target = self.targets[wheel]
        return target is None or abs(target - self.positions()[wheel]) <= _THERE

    def _has_command(self, wheel: int) -> bool:
        if self.modes[wheel] in _TO_POSITIONS:
            return self.targets[wheel] is not None
        return self.now_ns < self._until[wheel]

    def _toward(self, wheel: int, distance: float, seconds: float) -> float:
        """Return the velocity (degrees per second) of a trapezoidal move over ``distance`` (degrees).

        In position direct mode, return the velocity of the fastest possible move.
        """
        if self.modes[wheel] == modes.VOCAB_CM_POSITION_DIRECT:
            fastest = self.greatest
        else:
            ramp = self.ramps[wheel]
            fastest = min(
                self.speeds[wheel], math.sqrt(2.0 * ramp * abs(distance)), abs(self._output[wheel]) + ramp * seconds
            )
        return math.copysign(min(fastest, self.greatest, abs(distance) / seconds), distance)


class WheelBoard(JointBoard):
    """The control board's methods, which YARP clients call; ``call`` runs them on the simulation's thread."""

    def __init__(self, commands: Callable[[], WheelCommands], call: Callable[[Callable[[], Any]], Any]) -> None:
        super().__init__(len(commands().names))
        self._commands, self._call = commands, call

    @override
    def run(self, call: Callable[[], Any]) -> Any:
        return self._call(call)

    @override
    def control_mode(self, joint: int) -> int:
        return self._commands().modes[joint]

    @override
    def state(self) -> JointData:
        commands = self._commands()
        values = {
            "jointPosition": commands.positions(),
            "jointVelocity": commands.measured_velocities(),
            "motorPosition": commands.positions(),
            "motorVelocity": commands.measured_velocities(),
            "pwmDutycycle": commands.duties(),
            "controlMode": np.array(commands.modes),
            "interactionMode": np.full(self.axes, modes.VOCAB_IM_STIFF),
        }
        return JointData(self.axes, values)

    @override
    def getAxisNameRPC(self, j: int) -> tuple[ReturnValue, str]:
        return OK, self._commands().names[j]

    @override
    def getJointTypeRPC(self, j: int) -> tuple[ReturnValue, int]:
        return OK, modes.VOCAB_JOINTTYPE_REVOLUTE

    @override
    def setControlModeOneRPC(self, j: int, mod: int) -> ReturnValue:
        mode = modes.VOCAB_CM_IDLE if mod == modes.VOCAB_CM_FORCE_IDLE else mod
        if mode not in _MODES:
            raise CallFailed(ReturnCode.METHOD_FAILED, "a wheel does not support this control mode")
        self._commands().mode(j, mode)
        return OK

    @override
    def getInteractionModeOneRPC(self, axis: int) -> tuple[ReturnValue, int]:
        return OK, modes.VOCAB_IM_STIFF

    @override
    def getEncoderOneRPC(self, j: int) -> tuple[ReturnValue, float]:
        return OK, float(self._commands().positions()[j])

    @override
    def getEncoderSpeedOneRPC(self, j: int) -> tuple[ReturnValue, float]:
        return OK, float(self._commands().measured_velocities()[j])

    @override
    def getMotorEncoderOneRPC(self, j: int) -> tuple[ReturnValue, float]:
        return self.getEncoderOneRPC(j)

    @override
    def getNumberOfMotorEncodersRPC(self) -> tuple[ReturnValue, int]:
        return OK, self.axes

    @override
    def setEncoderOneRPC(self, j: int, val: float) -> ReturnValue:
        commands = self._commands()
        commands.zero[j] += commands.positions()[j] - _finite(val)
        commands.release(j)
        return OK

    @override
    def resetEncoderOneRPC(self, j: int) -> ReturnValue:
        return self.setEncoderOneRPC(j, 0.0)

    @override
    def positionMoveOneRPC(self, j: int, ref: float) -> ReturnValue:
        return self._aim(j, ref, modes.VOCAB_CM_POSITION)

    @override
    def relativeMoveOneRPC(self, j: int, delta: float) -> ReturnValue:
        commands = self._commands()
        target = commands.targets[j]
        return self.positionMoveOneRPC(j, (commands.positions()[j] if target is None else target) + delta)

    @override
    def getTargetPositionOneRPC(self, j: int) -> tuple[ReturnValue, float]:
        commands = self._commands()
        target = commands.targets[j]
        return OK, float(commands.positions()[j]) if target is None else target

    @override
    def checkMotionDoneOneRPC(self, j: int) -> tuple[ReturnValue, bool]:
        return OK, self._commands().is_done(j)

    @override
    def setTrajSpeedOneRPC(self, j: int, sp: float) -> ReturnValue:
        self._commands().speeds[j] = abs(_finite(sp))
        return OK

    @override
    def getTrajSpeedOneRPC(self, j: int) -> tuple[ReturnValue, float]:
        return OK, float(self._commands().speeds[j])

    @override
    def setTrajAccelerationOneRPC(self, j: int, acc: float) -> ReturnValue:
        self._commands().ramps[j] = abs(_finite(acc))
        return OK

    @override
    def getTrajAccelerationOneRPC(self, j: int) -> tuple[ReturnValue, float]:
        return OK, float(self._commands().ramps[j])

    @override
    def stopOneRPC(self, j: int) -> ReturnValue:
        self._commands().release(j)
        return OK

    @override
    def setRefPositionOneRPC(self, j: int, value: float) -> ReturnValue:
        return self._aim(j, value, modes.VOCAB_CM_POSITION_DIRECT)

    @override
    def getRefPositionOneRPC(self, j: int) -> tuple[ReturnValue, float]:
        return self.getTargetPositionOneRPC(j)

    @override
    def velocityMoveOneRPC(self, j: int, ref: float) -> ReturnValue:
        self._in(j, modes.VOCAB_CM_VELOCITY).turn(j, _finite(ref))
        return OK

    @override
    def getTargetVelocityOneRPC(self, j: int) -> tuple[ReturnValue, float]:
        return OK, float(self._commands().velocities[j])

    @override
    def setRefDutyCycleOneRPC(self, j: int, v: float) -> ReturnValue:
        duty = min(100.0, max(-100.0, _finite(v)))
        commands = self._in(j, modes.VOCAB_CM_PWM)
        commands.turn(j, duty / 100.0 * commands.greatest)
        return OK

    @override
    def getRefDutyCycleOneRPC(self, j: int) -> tuple[ReturnValue, float]:
        return OK, float(self._commands().duties()[j])

    @override
    def getDutyCycleOneRPC(self, j: int) -> tuple[ReturnValue, float]:
        return self.getRefDutyCycleOneRPC(j)

    @override
    def getPosLimitsRPC(self, j: int) -> tuple[ReturnValue, float, float]:
        return OK, -math.inf, math.inf

    @override
    def getVelLimitsRPC(self, j: int) -> tuple[ReturnValue, float, float]:
        return OK, 0.0, self._commands().greatest

    def _aim(self, wheel: int, target: float, mode: int) -> ReturnValue:
        self._in(wheel, mode).targets[wheel] = _finite(target)
        return OK

    def _in(self, wheel: int, mode: int) -> WheelCommands:
        commands = self._commands()
        if commands.modes[wheel] != mode:
            raise CallFailed(
                ReturnCode.METHOD_FAILED, f"{commands.names[wheel]} is in another control mode; set the mode first"
            )
        return commands


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise CallFailed(ReturnCode.OUT_OF_BOUNDS, f"{value} is not finite")
    return value
