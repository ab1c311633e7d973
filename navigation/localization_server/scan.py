"""Scans as points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navigation.pose import Pose
from navigation.scan import Beams, believed

AT_BASE = Pose(0.0, 0.0, 0.0)


def scan_points(scan: Beams, laser: Pose = AT_BASE) -> NDArray[np.float64]:
    """Where beams ended, (n, 2) in the base's frame, metres. Those that ended nowhere are left out.

    Args:
        scan: a turn of the laser.
        laser: where the laser is on the base.
    """
    ranges = believed(scan)
    hit = np.isfinite(ranges)
    angles = scan.first + np.flatnonzero(hit) * scan.step + laser.theta
    found = ranges[hit]
    return np.stack([laser.x + found * np.cos(angles), laser.y + found * np.sin(angles)], axis=1)


def thinned(points: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """So many of the points at most, taken evenly."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).round().astype(np.intp)]
