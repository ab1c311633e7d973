"""The command sources of the simulated wheels: the motors that BaseControl drives, a velocity, the control board."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sim.base import Base, Encoders, Floats, Twist
from sim.board import WheelCommands
from sim.environment import SimError

_ABSURD = 100.0  # greater velocities (meters or radians per second) are rejected as mistakes


class Motors:
    """The wheels' motors, which BaseControl drives with these methods in one process, or over two topics of the hub."""

    def __init__(self, names: tuple[str, ...], timeout: float) -> None:
        self.names = names  # names of the wheels' joints, in the order of all velocities and positions
        self._timeout = round(timeout * 1e9)
        self._wanted = np.zeros(len(names))
        self._until = 0
        self.now = 0
        self._encoders = Encoders(0, np.zeros(len(names)), np.zeros(len(names)))

    def drive(self, velocities: Sequence[float]) -> None:
        """Set the wheels' velocities (radians per second); the wheels stop after the motors' time-out.

        Raises `SimError` if there is not one finite velocity per wheel.
        """
        wanted = np.asarray(velocities, float)
        if wanted.shape != (len(self.names),) or not np.isfinite(wanted).all():
            raise SimError(f"invalid velocities {list(velocities)} for the wheels {', '.join(self.names)}")
        self._wanted, self._until = wanted, self.now + self._timeout

    def encoders(self) -> Encoders:
        """Return the last reading of the encoders."""
        return self._encoders

    def read(self, encoders: Encoders) -> None:
        """Store a reading of the encoders."""
        self._encoders = encoders

    def wheels(self) -> np.ndarray:
        """Return the target velocity of each wheel in radians per second, zero after the commands' timeout."""
        return self._wanted if self.now < self._until else np.zeros(len(self.names))


class VelocityDrive:
    """Converts velocity commands to wheel velocities within the robot's limits, if the simulator itself drives.

    Each command replaces the previous one, and expires after the time-out.
    """

    def __init__(self, base: Base) -> None:
        self._limits = base.robot.limits
        believed = base.robot.believed
        self._matrix = base.matrix(believed.radius, believed.separation)
        self._greatest = base.robot.wheels.max_velocity
        self._lateral = base.robot.kinematics != "differential"
        self._wanted = np.zeros(3)
        self._until = 0
        self._now = np.zeros(3)

    def command(self, twist: Twist, now_ns: int) -> None:
        """Set the velocity until the time-out; raises `SimError` if it is invalid, and keeps the last command."""
        if not all(math.isfinite(v) and abs(v) <= _ABSURD for v in twist):
            raise SimError(f"velocity {tuple(twist)} rejected: not finite, or greater than {_ABSURD:g}")
        angular = math.radians(self._limits.angular)
        x, y = twist.x, twist.y if self._lateral else 0.0
        speed = math.hypot(x, y)
        share = min(1.0, self._limits.linear / speed) if speed else 1.0
        self._wanted = np.array([x * share, y * share, min(angular, max(-angular, twist.yaw))])
        self._until = now_ns + round(self._limits.timeout * 1e9)

    def halt(self) -> None:
        """Cancel the command; the base brakes."""
        self._until = 0

    def stand(self) -> None:
        """Start again from rest, because something else holds the wheels."""
        self._now = np.zeros(3)

    def wheels(self, now_ns: int, seconds: float) -> Floats:
        """Return wheel velocities (radians per second) for the next ``seconds``."""
        wanted = self._wanted if now_ns < self._until else np.zeros(3)
        linear = self._limits.linear_acceleration * seconds
        change = wanted - self._now
        along = math.hypot(change[0], change[1])
        if along > linear:
            change[:2] *= linear / along
        angular = math.radians(self._limits.angular_acceleration) * seconds
        change[2] = min(angular, max(-angular, change[2]))
        self._now = self._now + change
        wheels: Floats = self._matrix @ self._now
        fastest = float(np.abs(wheels).max())
        return wheels * (self._greatest / fastest) if fastest > self._greatest else wheels


class WheelControls:
    """All command sources. A command to the control board takes precedence.

    Attributes:
        motors: the motors that BaseControl drives.
        drive: the simulator's own velocity drive.
        board: the control board.
        stopped: whether the emergency stop is on.
    """

    def __init__(self, base: Base, time_ns: int, *, velocity: bool) -> None:
        self.motors = Motors(base.names, base.robot.motor_timeout)
        self.drive = VelocityDrive(base)
        self.board = WheelCommands(base, time_ns)
        self.stopped = False
        self._velocity = velocity

    def targets(self, time_ns: int, seconds: float) -> list[float]:
        """Return the wheels' target velocities (radians per second) for the next ``seconds``."""
        self.motors.now = self.board.now_ns = time_ns
        wheels = self.drive.wheels(time_ns, seconds) if self._velocity else self.motors.wheels()
        commanded = self.board.next_velocities(seconds)
        if commanded is not None:
            wheels = commanded
        if self.stopped:
            self.drive.stand()
            return [0.0] * len(wheels)
        velocities: list[float] = wheels.tolist()
        return velocities

    def read(self, encoders: Encoders) -> None:
        """Store a reading of the encoders."""
        self.motors.now = encoders.time_ns
        self.motors.read(encoders)
        self.board.read(encoders)

    def halt(self) -> None:
        """Cancel the commands of the velocity drive and the control board; later commands are executed."""
        self.board.halt()
        self.drive.halt()
