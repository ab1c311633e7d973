"""Laser scans (`yarp/sig/LaserScan2D.h`, `LaserMeasurementData.h`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from yarp_compat.dev.structure import Generated
from yarp_compat.sig.vector import Vector


@dataclass
class LaserScan2D(Generated):
    """One turn of a laser: what it measured, from the first angle to the last.

    Attributes:
        angle_min: the first ray's direction, degrees.
        angle_max: the last ray's direction, degrees.
        range_min: the nearest that the laser sees, metres.
        range_max: the farthest that it sees, metres.
        scans: distances, metres; infinite where nothing was hit.
        status: the device's: 0 stands by, 1 in use, 2 error, 3 time-out.
    """

    angle_min: float = 0.0
    angle_max: float = 0.0
    range_min: float = 0.0
    range_max: float = 0.0
    scans: Vector = field(default_factory=Vector)
    status: int = 3


class LaserMeasurementData:
    """One point of a scan, in either kind of coordinates: x and y or distance in metres, the angle in radians."""

    def __init__(self) -> None:
        self._x = self._y = self._rho = self._theta = 0.0

    def set_cartesian(self, x: float, y: float) -> None:
        """Be this point."""
        self._x, self._y, self._rho, self._theta = x, y, math.hypot(x, y), math.atan2(y, x)

    def set_polar(self, rho: float, theta: float) -> None:
        """Be this point."""
        self._rho, self._theta, self._x, self._y = rho, theta, rho * math.cos(theta), rho * math.sin(theta)

    def get_cartesian(self) -> tuple[float, float]:
        """Its x and y."""
        return self._x, self._y

    def get_polar(self) -> tuple[float, float]:
        """Distance and angle."""
        return self._rho, self._theta
