"""Poses in the plane."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple


class Pose(NamedTuple):
    """A pose in a frame, in meters and radians, and its time, ns (0 if it holds for all times)."""

    x: float
    y: float
    theta: float
    stamp_ns: int = 0

    def __matmul__(self, other: Pose) -> Pose:
        """Transform a pose in this pose's frame into the frame in which this pose is given; ``other``'s stamp stays."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrapped(self.theta + other.theta),
            other.stamp_ns,
        )

    @property
    def inverse(self) -> Pose:
        """The pose of this pose's reference frame relative to this pose; with the same stamp."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose(-c * self.x - s * self.y, s * self.x - c * self.y, wrapped(-self.theta), self.stamp_ns)

    def distance(self, other: Pose) -> float:
        """Return the meters to another pose."""
        return math.hypot(self.x - other.x, self.y - other.y)


def check_rotation(orientation: Mapping[str, float], whose: str) -> None:
    """Raise `ValueError` if a quaternion is not a rotation, such as one of zeros; its length must be 0.9 to 1.1."""
    length = math.sqrt(sum(value * value for value in orientation.values()))
    if not 0.9 < length < 1.1:
        raise ValueError(f"{whose} quaternion is not a rotation: its length is {length:.2f}, not 1")


def wrapped(angle: float) -> float:
    """Return the same direction within -pi to pi."""
    return math.remainder(angle, math.tau)
