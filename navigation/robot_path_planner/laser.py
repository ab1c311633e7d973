"""Scans of the hub, as the planner takes them."""

from __future__ import annotations

from typing import Any

from navigation.frames import LATE, Frames, FramesError
from navigation.robot_path_planner.planner import PathPlanner
from navigation.scan import ScanError, is_blind, of_ros

_EVERY = 0.2
_SILENT = 1.0
"""Seconds without a scan that says anything, after which the laser is held for silent."""


class Laser:
    """Gives the planner some of the scans.

    Args:
        planner: who sees them.
        frames: where the laser is.
    """

    def __init__(self, planner: PathPlanner, frames: Frames) -> None:
        self._planner, self._frames = planner, frames
        self._last, self._seen = float("-inf"), float("inf")
        self.trouble = ""

    def take(self, now: float, message: dict[str, Any]) -> None:
        """Take a ``sensor_msgs/LaserScan``."""
        if not self._planner.active:
            self._seen = now
            return
        if 0 <= now - self._last < _EVERY:
            return
        self._last = now
        header = message["header"]
        stamp = header["stamp"]["sec"] * 1_000_000_000 + header["stamp"]["nanosec"]
        try:
            turn = of_ros(message, stamp, hangs=self._frames.hangs(header["frame_id"]))
            if not is_blind(turn):
                self._seen = now
            pose = self._frames.transform(self._frames.map_frame, header["frame_id"], stamp, extrapolate=LATE)
        except (FramesError, ScanError) as err:
            self.trouble = str(err)
            return
        self.trouble = ""
        self._planner.scan(now, pose, turn)

    def silent(self, now: float) -> str:
        """Why nothing is seen; "" where something is, and where no scan ever came."""
        silent = now - self._seen
        return f"the laser is silent: it said nothing for {silent:.1f} s" if silent > _SILENT else ""
