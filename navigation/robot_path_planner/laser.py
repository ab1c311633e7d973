"""Scans of the hub, as the planner takes them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navigation.frames import Frames, FramesError
from navigation.robot_path_planner.planner import PathPlanner

SCAN = "sensor_msgs/msg/LaserScan"
_EVERY = 0.2
_LATE = 0.2
"""Seconds by which a scan may be newer than the frames."""


class Laser:
    """Gives the planner some of the scans.

    Args:
        planner: who sees them.
        frames: where the laser is.
    """

    def __init__(self, planner: PathPlanner, frames: Frames) -> None:
        self._planner, self._frames = planner, frames
        self._last = float("-inf")
        self.trouble = ""

    def take(self, now: float, message: dict[str, Any]) -> None:
        """Take a ``sensor_msgs/LaserScan``."""
        if not self._planner.active or 0 <= now - self._last < _EVERY:
            return
        self._last = now
        header = message["header"]
        stamp = header["stamp"]["sec"] * 1_000_000_000 + header["stamp"]["nanosec"]
        try:
            pose = self._frames.transform(self._frames.map_frame, header["frame_id"], stamp, extrapolate=_LATE)
        except FramesError as err:
            self.trouble = str(err)
            return
        self.trouble = ""
        self._planner.scan(now, pose, believed(message), message["angle_min"], message["angle_increment"])


def believed(message: dict[str, Any]) -> NDArray[np.float64]:
    """The ranges: what is too near to be measured is NaN, what is too far infinite."""
    ranges = np.array(message["ranges"], np.float64)
    with np.errstate(invalid="ignore"):
        ranges[ranges < max(message["range_min"], 1e-3)] = np.nan
        ranges[ranges >= message["range_max"]] = np.inf
    return ranges
