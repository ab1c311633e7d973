"""Laser scans of the hub and of YARP, as all modules take them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.messages.scan import Turn
from navigation.pose import Pose
from yarp_compat.dev.rangefinder import LaserScan2D

SCAN = "sensor_msgs/msg/LaserScan"

_LEAST = 1e-3  # metres; nearer is what some lasers say where they saw nothing, and that is not known to be free


class ScanError(ValueError):
    """A scan that cannot be used; the text says why."""


def of_ros(message: Mapping[str, Any], time_ns: int, *, hangs: bool = False) -> Turn:
    """The turn of a ``LaserScan`` at ns of the taker's clock, upside down if it ``hangs``; raises `ScanError`."""
    made = _turn(
        time_ns, message["angle_min"], message["angle_increment"], message["range_min"], message["range_max"],
        np.array(message["ranges"], np.float64),
    )  # fmt: skip
    return made.turned_over() if hangs else made


def of_yarp(scan: LaserScan2D, time_ns: int) -> Turn:
    """The turn of a YARP laser, in degrees, its last angle a step beyond the last beam; raises `ScanError`."""
    ranges = np.array(scan.scans, np.float64)
    step = math.radians(scan.angle_max - scan.angle_min) / max(len(ranges), 1)
    return _turn(time_ns, math.radians(scan.angle_min), step, scan.range_min, scan.range_max, ranges)


def _turn(
    time_ns: int, first: float, step: float, nearest: float, farthest: float, ranges: NDArray[np.float64]
) -> Turn:
    if not (math.isfinite(first) and math.isfinite(step) and step != 0.0 and len(ranges)):
        raise ScanError(f"a scan of {len(ranges)} beams from {first:g} by {step:g} rad")
    if abs(step) * len(ranges) > 2.5 * math.pi:
        raise ScanError(f"a scan of {len(ranges)} beams with {step:g} rad between them goes round more than once")
    if not farthest > max(nearest, 0.0):
        raise ScanError(f"a scan that measures from {nearest:g} to {farthest:g} m")
    return Turn(time_ns, first, step, max(nearest, _LEAST), farthest, ranges)


def is_blind(scan: Turn) -> bool:
    """Whether none of its beams says anything: many lasers that are covered or broken say 0 all round."""
    ranges = np.asarray(scan.ranges, np.float64)
    with np.errstate(invalid="ignore"):
        return not ((ranges >= scan.nearest) | (ranges == -np.inf)).any()


def believed(scan: Turn) -> NDArray[np.float64]:
    """The ranges: NaN where nothing is known, also nearer than is measured; infinite from the farthest on.

    A range of just ``range_max`` is no echo: many lasers say it where nothing was hit.
    """
    ranges = np.array(scan.ranges, np.float64)
    with np.errstate(invalid="ignore"):
        ranges[ranges < scan.nearest] = np.nan
        ranges[ranges >= scan.farthest] = np.inf
    return ranges


AT_BASE = Pose(0.0, 0.0, 0.0)


def scan_points(scan: Turn, laser: Pose = AT_BASE) -> NDArray[np.float64]:
    """Where beams of a laser on the base ended, (n, 2) in the base's frame, metres; those that ended somewhere."""
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
