"""Where a base has come to, by its wheels' encoders."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navigation.base_control.kinematics import Array, Kinematics
from navigation.base_control.velocity import STILL, Velocity

_SMALL_TURN = 1e-9


@dataclass(frozen=True)
class Travelled:
    """Where a base is in the odometry's frame.

    Attributes:
        x: metres.
        y: metres.
        theta: radians, counted on over full turns.
        velocity: in the base's frame.
        distance: metres driven since the start or the last reset, forth and back alike.
        angle: radians turned, to both sides alike.
    """

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    velocity: Velocity = STILL
    distance: float = 0.0
    angle: float = 0.0

    @property
    def world_velocity(self) -> tuple[float, float]:
        """The velocity along the odometry frame's axes, m/s."""
        cos, sin = math.cos(self.theta), math.sin(self.theta)
        return cos * self.velocity.x - sin * self.velocity.y, sin * self.velocity.x + cos * self.velocity.y


class Odometry:
    """Adds up encoder angles. Between two readings the base drives along an arc, which is exact where both speeds hold.

    Args:
        kinematics: of the base.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._angles: Array | None = None
        self._time = 0.0
        self.now = Travelled()

    def update(self, angles: Array, time: float) -> Travelled:
        """Take the wheels' angles (rad, counted on over full turns) at a time in seconds.

        The first reading only says where the encoders stand. A reading that is not newer changes nothing.

        Raises:
            ValueError: an angle is not a number, or there are too many or too few.
        """
        wheels = len(self._kinematics.joints)
        if angles.shape != (wheels,) or not np.isfinite(angles).all():
            raise ValueError(f"{wheels} finite wheel angles are needed, not {angles}")
        if self._angles is None:
            self._angles, self._time = angles.copy(), time
            return self.now
        seconds = time - self._time
        if seconds <= 0.0:
            return self.now
        step = Velocity(*(float(value) for value in self._kinematics.inverse @ (angles - self._angles)))
        self._angles, self._time = angles.copy(), time
        self.now = _moved(self.now, step, seconds)
        return self.now

    def reset(self) -> None:
        """Begin at zero from here."""
        self.now = Travelled()

    def restart(self) -> None:
        """Take the next reading as the first one: the encoders or the clock began anew; the pose is kept."""
        self._angles = None


def _moved(before: Travelled, step: Velocity, seconds: float) -> Travelled:
    """``step`` is a motion in the base's frame: metres, metres, radians."""
    sin_share, cos_share = 1.0, step.turn / 2.0
    if abs(step.turn) > _SMALL_TURN:
        sin_share = math.sin(step.turn) / step.turn
        cos_share = (1.0 - math.cos(step.turn)) / step.turn
    along = step.x * sin_share - step.y * cos_share
    aside = step.x * cos_share + step.y * sin_share
    cos, sin = math.cos(before.theta), math.sin(before.theta)
    return Travelled(
        before.x + cos * along - sin * aside,
        before.y + sin * along + cos * aside,
        before.theta + step.turn,
        Velocity(step.x / seconds, step.y / seconds, step.turn / seconds),
        before.distance + math.hypot(step.x, step.y),
        before.angle + abs(step.turn),
    )
