"""From a base's velocity to its wheels, and back.

Formulas of robotology/navigation, ``baseControl2`` (``cer_motors.cpp``, ``ikart_motors.cpp``), in SI units. Both are
linear, so a kind of base is a matrix: wheel velocities = matrix @ (x, y, turn).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navigation.base_control.velocity import Velocity

Array = NDArray[np.float64]

KINDS = ("cer", "ikart_V1")


class KinematicsError(ValueError):
    """A kind of base that BaseControl does not drive, or a geometry that cannot be; the text says why."""


@dataclass(frozen=True, eq=False)
class Kinematics:
    """A kind of base with its measures.

    Attributes:
        matrix: (wheels, 3): wheel velocities in rad/s of a velocity (m/s, m/s, rad/s).
        inverse: (3, wheels): the velocity of wheel velocities; the best one where wheels contradict each other.
        joints: the wheels' usual names, in order.
        rows: the matrix as plain numbers.
        holonomic: whether it can move to its side.
    """

    matrix: Array
    inverse: Array
    rows: tuple[tuple[float, ...], ...]
    joints: tuple[str, ...]
    holonomic: bool

    def wheels(self, velocity: Velocity) -> Array:
        """The wheels' velocities, rad/s; what the base cannot do (a side step of a differential one) is left out."""
        found: Array = self.matrix @ np.asarray(velocity)
        return found

    def fastest(self, velocity: Velocity) -> float:
        """How fast the fastest wheel turns, rad/s."""
        x, y, turn = velocity
        return max(abs(a * x + b * y + c * turn) for a, b, c in self.rows)

    def velocity(self, wheels: Array) -> Velocity:
        """The base's velocity where its wheels turn at these rad/s without slip."""
        return Velocity(*(float(value) for value in self.inverse @ wheels))


def kinematics(kind: str, wheel_radius: float, wheel_distance: float) -> Kinematics:
    """A kind of base with its measures.

    Args:
        kind: ``cer`` (R1: two driven wheels, left and right) or ``ikart_V1`` (three omnidirectional wheels).
        wheel_radius: metres (``geom_r``).
        wheel_distance: metres (``geom_L``): between the wheels of ``cer``, from the centre to a wheel of ``ikart_V1``.

    Raises:
        KinematicsError: there is no such kind, or a measure is not positive.
    """
    for name, value in (("geom_r", wheel_radius), ("geom_L", wheel_distance)):
        if not (math.isfinite(value) and 0.0 < value < 10.0):
            raise KinematicsError(f"{name} is a length in metres, above 0 and below 10; this is {value:g}")
    rows: list[list[float]]
    joints: tuple[str, ...]
    if kind == "cer":
        half = wheel_distance / 2.0
        rows, joints = [[1.0, 0.0, -half], [1.0, 0.0, half]], ("mobile_base_l_wheel_joint", "mobile_base_r_wheel_joint")
    elif kind == "ikart_V1":
        lean, arm = math.sqrt(3.0) / 2.0, wheel_distance
        rows, joints = [[lean, -0.5, -arm], [-lean, -0.5, -arm], [0.0, 1.0, -arm]], ("wheel_0", "wheel_1", "wheel_2")
    else:
        raise KinematicsError(f"no base of the kind {kind!r} is driven yet; there are {' and '.join(KINDS)}")
    matrix: Array = np.array(rows) / wheel_radius
    inverse: Array = np.linalg.pinv(matrix).astype(np.float64)
    plain = tuple(tuple(float(value) for value in row) for row in matrix)
    return Kinematics(matrix, inverse, plain, joints, holonomic=kind == "ikart_V1")
