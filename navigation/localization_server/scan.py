"""Scans as points."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from navigation.pose import Pose

AT_BASE = Pose(0.0, 0.0, 0.0)


class Beams(Protocol):
    """A scan: directions in radians, distances in metres."""

    @property
    def first(self) -> float:
        """The first beam's direction on the laser."""

    @property
    def step(self) -> float:
        """From each beam to the next."""

    @property
    def nearest(self) -> float:
        """What is nearer was not measured."""

    @property
    def farthest(self) -> float:
        """What is farther was not measured."""

    @property
    def ranges(self) -> NDArray[np.floating]:
        """The distances; infinite where nothing was hit, NaN where nothing is known."""


def scan_points(scan: Beams, laser: Pose = AT_BASE) -> NDArray[np.float64]:
    """Where beams ended, (n, 2) in the base's frame, metres. Those that ended nowhere are left out.

    Args:
        scan: a turn of the laser.
        laser: where the laser is on the base.
    """
    ranges = np.asarray(scan.ranges, np.float64)
    with np.errstate(invalid="ignore"):
        hit = np.isfinite(ranges) & (ranges >= scan.nearest) & (ranges < scan.farthest)
    angles = scan.first + np.flatnonzero(hit) * scan.step + laser.theta
    found = ranges[hit]
    return np.stack([laser.x + found * np.cos(angles), laser.y + found * np.sin(angles)], axis=1)


def thinned(points: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """So many of the points at most, taken evenly."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).round().astype(np.intp)]
