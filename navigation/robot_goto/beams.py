"""Scans of the hub and of YARP's ports, as the driver takes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navigation.frames import Frames, FramesError
from navigation.pose import Pose
from yarp_compat.dev.laserscan import LaserScan2D

LATE = 0.2
"""Seconds by which a scan may be newer than the frames."""


@dataclass(frozen=True, eq=False)
class Turn:
    """A turn of a laser; see `navigation.robot_goto.local_grid.Scan`."""

    time_ns: int
    first: float
    step: float
    nearest: float
    farthest: float
    ranges: NDArray[np.float64]


class ScanError(ValueError):
    """A scan that cannot be used; the text says why."""


def of_ros(message: Mapping[str, Any], time_ns: int) -> Turn:
    """The turn of a ``sensor_msgs/msg/LaserScan``.

    Args:
        message: as `bridge.messages.values` has it.
        time_ns: when it was made, on the driver's clock.

    Raises:
        ScanError: its angles are none.
    """
    return _turn(
        time_ns, message["angle_min"], message["angle_increment"], message["range_min"], message["range_max"],
        np.array(message["ranges"], np.float64),
    )  # fmt: skip


def of_yarp(scan: LaserScan2D, time_ns: int) -> Turn:
    """The turn of a YARP laser: degrees, the last angle being one step beyond the last beam.

    Raises:
        ScanError: its angles are none.
    """
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
    # nearer than a millimetre is what some lasers say where they saw nothing; that is not known to be free
    return Turn(time_ns, first, step, max(nearest, 1e-3), farthest, ranges)


def laser_pose(frames: Frames, frame: str) -> Pose:
    """Where a laser is on the base.

    Raises:
        FramesError: that is not known.
    """
    return Pose(0.0, 0.0, 0.0) if frame.lstrip("/") == frames.base_frame else frames.transform(frames.base_frame, frame)


def moved_at(frames: Frames, stamp_ns: int) -> Pose:
    """Where the base was in the odometry's frame, or on the map where there is no odometry.

    Raises:
        FramesError: neither is known.
    """
    try:
        return frames.transform(frames.odom_frame, frames.base_frame, stamp_ns, extrapolate=LATE)
    except FramesError as err:
        try:
            return frames.transform(frames.map_frame, frames.base_frame, stamp_ns, extrapolate=LATE)
        except FramesError:
            raise err from None
