"""Laser scans from the hub and from YARP."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.messages.scan import LaserScan
from navigation.pose import Pose
from yarp_compat.dev.rangefinder import LaserScan2D

SCAN = "sensor_msgs/msg/LaserScan"

_LEAST = 1e-3  # meters; some lasers report 0 without an echo, which does not mean that the beam was free


class ScanError(ValueError):
    """A scan is invalid; the text gives the reason."""


def of_ros(message: Mapping[str, Any], time_ns: int, *, upside_down: bool = False) -> LaserScan:
    """Convert a ``LaserScan`` made at ``time_ns``; ``upside_down``: how the laser is mounted. Raises `ScanError`."""
    laser_scan = _laser_scan(
        time_ns, message["angle_min"], message["angle_increment"], message["range_min"], message["range_max"],
        np.array(message["ranges"], np.float64),
    )  # fmt: skip
    return laser_scan.turned_over() if upside_down else laser_scan


def of_yarp(scan: LaserScan2D, time_ns: int) -> LaserScan:
    """Convert a YARP scan (degrees; its last angle is a step beyond the last beam); raises `ScanError`."""
    ranges = np.array(scan.scans, np.float64)
    step = math.radians(scan.angle_max - scan.angle_min) / max(len(ranges), 1)
    return _laser_scan(time_ns, math.radians(scan.angle_min), step, scan.range_min, scan.range_max, ranges)


def _laser_scan(
    time_ns: int, first: float, step: float, nearest: float, farthest: float, ranges: NDArray[np.float64]
) -> LaserScan:
    if not (math.isfinite(first) and math.isfinite(step) and step != 0.0 and len(ranges)):
        raise ScanError(f"invalid scan: {len(ranges)} beams from {first:g} by {step:g} rad")
    if abs(step) * len(ranges) > 2.5 * math.pi:
        raise ScanError(f"invalid scan: {len(ranges)} beams with {step:g} rad between them are more than a full circle")
    if not farthest > max(nearest, 0.0):
        raise ScanError(f"invalid scan: it measures from {nearest:g} to {farthest:g} m")
    return LaserScan(time_ns, first, step, max(nearest, _LEAST), farthest, ranges)


def is_blind(scan: LaserScan) -> bool:
    """Whether no beam has a valid range: many covered or broken lasers report 0 in all directions."""
    ranges = np.asarray(scan.ranges, np.float64)
    with np.errstate(invalid="ignore"):
        return not ((ranges >= scan.nearest) | (ranges == -np.inf)).any()


def clean_ranges(scan: LaserScan) -> NDArray[np.float64]:
    """Return the ranges: NaN if unknown or below the laser's minimum, infinite from its maximum on.

    A range of exactly ``range_max`` is not an echo: many lasers report it if the beam hit nothing.
    """
    ranges = np.array(scan.ranges, np.float64)
    with np.errstate(invalid="ignore"):
        ranges[ranges < scan.nearest] = np.nan
        ranges[ranges >= scan.farthest] = np.inf
    return ranges


AT_BASE = Pose(0.0, 0.0, 0.0)


def scan_points(scan: LaserScan, laser: Pose = AT_BASE) -> NDArray[np.float64]:
    """Return the echoes of a laser on the base as points in the base's frame, (n, 2) meters."""
    ranges = clean_ranges(scan)
    hit = np.isfinite(ranges)
    angles = scan.first + np.flatnonzero(hit) * scan.step + laser.theta
    echoes = ranges[hit]
    return np.stack([laser.x + echoes * np.cos(angles), laser.y + echoes * np.sin(angles)], axis=1)


def thinned(points: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """Return at most this many of the points, evenly selected."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).round().astype(np.intp)]
