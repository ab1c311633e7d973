"""Scans of the hub, as the planner takes them."""

from __future__ import annotations

from typing import Any

from navigation.frames import LATE, Frames, FramesError
from navigation.robot_path_planner.planner import PathPlanner
from navigation.scan import ScanError, of_ros

_EVERY = 0.2


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
            turn = of_ros(message, stamp, hangs=self._frames.hangs(header["frame_id"]))
            pose = self._frames.transform(self._frames.map_frame, header["frame_id"], stamp, extrapolate=LATE)
        except (FramesError, ScanError) as err:
            self.trouble = str(err)
            return
        self.trouble = ""
        self._planner.scan(now, pose, turn)
