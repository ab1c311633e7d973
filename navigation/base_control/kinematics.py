"""Converts a base's velocity to wheel velocities and back, and computes odometry from encoders.

The formulas are those of robotology/navigation, ``baseControl2`` (``cer_motors.cpp``, ``ikart_motors.cpp``), in SI
units. The conversions are linear, so each kind of base has a matrix: wheel velocities = matrix @ (x, y, turn).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul

import numpy as np
from numpy.typing import NDArray

from navigation.base_control.commands import STILL, Velocity
from navigation.base_control.encoders import WheelRates, rotation_between

Array = NDArray[np.float64]

KINDS = ("cer", "ikart_V1")


class KinematicsError(ValueError):
    """An unknown kind of base, or an impossible geometry; the message gives the reason."""


@dataclass(frozen=True, eq=False)
class Kinematics:
    """A kind of base with its dimensions."""

    matrix: Array  #: (wheels, 3): from a velocity (m/s, m/s, rad/s) to wheel velocities in rad/s
    inverse: Array  #: (3, wheels): from wheel velocities to the velocity, by least squares
    rows: tuple[tuple[float, ...], ...]  #: the matrix as plain numbers
    joints: tuple[str, ...]  #: the wheels' usual names, in order
    holonomic: bool  #: whether it can move to its side

    def wheels(self, velocity: Velocity) -> Array:
        """Return the wheels' velocities, rad/s, without motion that the base cannot make (a side step of ``cer``)."""
        wheels: Array = self.matrix @ np.asarray(velocity)
        return wheels

    def fastest(self, velocity: Velocity) -> float:
        """Return the speed of the fastest wheel, rad/s."""
        x, y, turn = velocity
        return max(abs(a * x + b * y + c * turn) for a, b, c in self.rows)

    def velocity(self, wheels: Array) -> Velocity:
        """Return the base's velocity when its wheels turn at these rad/s without slip."""
        return Velocity(*(float(value) for value in self.inverse @ wheels))


def kinematics(kind: str, wheel_radius: float, wheel_distance: float) -> Kinematics:
    """Return a kind of base; raises `KinematicsError` if the kind is unknown or a measure is not positive.

    ``cer`` is the base of R1, with two driven wheels, left and right; ``ikart_V1`` has three omnidirectional wheels.
    The radius (``geom_r``) and the distance (``geom_L``) are in meters; the distance is that between the two wheels of
    a ``cer``, or from the center to a wheel of an ``ikart_V1``.
    """
    for name, value in (("geom_r", wheel_radius), ("geom_L", wheel_distance)):
        if not (math.isfinite(value) and 0.0 < value < 10.0):
            raise KinematicsError(f"{name} must be a length in meters, above 0 and below 10, not {value:g}")
    rows: list[list[float]]
    joints: tuple[str, ...]
    if kind == "cer":
        half = wheel_distance / 2.0
        rows, joints = [[1.0, 0.0, -half], [1.0, 0.0, half]], ("mobile_base_l_wheel_joint", "mobile_base_r_wheel_joint")
    elif kind == "ikart_V1":
        lean, arm = math.sqrt(3.0) / 2.0, wheel_distance
        rows, joints = [[lean, -0.5, -arm], [-lean, -0.5, -arm], [0.0, 1.0, -arm]], ("wheel_0", "wheel_1", "wheel_2")
    else:
        raise KinematicsError(f"unknown kind of base {kind!r}; use {' or '.join(KINDS)}")
    matrix: Array = np.array(rows) / wheel_radius
    inverse: Array = np.linalg.pinv(matrix).astype(np.float64)
    plain = tuple(tuple(float(value) for value in row) for row in matrix)
    return Kinematics(matrix, inverse, plain, joints, holonomic=kind == "ikart_V1")


_SMALL_TURN = 1e-9


@dataclass(frozen=True)
class Traveled:
    """The pose, velocity and distances of a base's odometry."""

    x: float = 0.0  #: meters
    y: float = 0.0  #: meters
    theta: float = 0.0  #: radians, not wrapped
    velocity: Velocity = STILL  #: the velocity in the base's frame
    distance: float = 0.0  #: meters driven since the start or the last reset, forward and backward
    angle: float = 0.0  #: radians turned, in both directions

    @property
    def world_velocity(self) -> tuple[float, float]:
        """The velocity along the axes of the odometry frame, m/s."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        return cos * self.velocity.x - sin * self.velocity.y, sin * self.velocity.x + cos * self.velocity.y


class WheelOdometry:
    """Integrates encoder angles; between two readings the base drives along an arc.

    Args:
        kinematics: the kind of base.
        fastest: rad/s that no wheel exceeds; a larger change of an angle is not a motion (`encoders.rotation_between`).
    """

    def __init__(self, kinematics: Kinematics, fastest: float = math.inf) -> None:
        # plain numbers, which are faster than arrays for two or three wheels
        self._rows: list[list[float]] = kinematics.inverse.tolist()
        self._wheels = len(kinematics.joints)
        self._fastest = fastest
        self._angles: Sequence[float] | None = None  # the angles of the last reading
        self._total = [0.0] * self._wheels  # total angles, across wraps and restarts of the encoders
        self._rates = WheelRates(self._wheels)
        self._time = 0.0
        self.now = Traveled()

    def update(self, angles: Sequence[float], time: float, rates: Sequence[float] | None = None) -> Traveled:
        """Add a reading: the wheels' angles (rad) at a time in seconds, and their velocities (rad/s) if measured.

        The first reading is the reference for the next one. A reading that is not newer changes nothing.
        Raises `ValueError` if an angle is not finite, or the number of angles is wrong.
        """
        if len(angles) != self._wheels or not all(map(math.isfinite, angles)):
            raise ValueError(f"a reading must have {self._wheels} finite wheel angles, not {angles}")
        seconds = 0.0
        if self._angles is not None:
            seconds = time - self._time
            if seconds <= 0.0:
                return self.now
        before = angles if self._angles is None else self._angles
        steps = [rotation_between(a, b, seconds, self._fastest) for a, b in zip(before, angles, strict=True)]
        self._angles, self._time = tuple(angles), time
        self._total = [total + step for total, step in zip(self._total, steps, strict=True)]
        velocity = self._base(self._rates.add(time, self._total, rates))
        self.now = _advance(self.now, self._base(steps), velocity)
        return self.now

    def _base(self, wheels: Sequence[float]) -> Velocity:
        """Return the base's motion for a motion of the wheels."""
        return Velocity(*(sum(map(mul, row, wheels)) for row in self._rows))

    def reset(self) -> None:
        """Continue from a pose and distances of zero."""
        self.now = Traveled()

    def restart(self) -> None:
        """Treat the next reading as the first reading, because the clock was set; keep the pose."""
        self._angles = None
        self._rates.clear()


def _advance(before: Traveled, step: Velocity, velocity: Velocity) -> Traveled:
    """Add a motion in the base's frame, in meters, meters and radians."""
    sin_share, cos_share = 1.0, step.turn / 2.0
    if abs(step.turn) > _SMALL_TURN:
        sin_share = math.sin(step.turn) / step.turn
        cos_share = (1.0 - math.cos(step.turn)) / step.turn
    along = step.x * sin_share - step.y * cos_share
    aside = step.x * cos_share + step.y * sin_share
    cos, sin = math.cos(before.theta), math.sin(before.theta)
    return Traveled(
        before.x + cos * along - sin * aside,
        before.y + sin * along + cos * aside,
        before.theta + step.turn,
        velocity,
        before.distance + math.hypot(step.x, step.y),
        before.angle + abs(step.turn),
    )
