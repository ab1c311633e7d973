"""The base's motion by its own odometry: whether it stands, and how far it still has to go."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from navigation.frames import FramesError, RobotFrames
from navigation.messages import duration
from navigation.pose import Pose

STANDING_SECONDS = 0.4
"""A base that has not moved for so long stands."""

STILL_METRES, STILL_RADIANS = 0.005, 0.01
"""What odometry of a base that stands may change by in that time."""

_KEPT_SECONDS = 3.0  # for so long poses are kept, for the speed


class Motion:
    """Follows the base's odometry: `look` on the module's thread, the rest on any."""

    def __init__(self, frames: RobotFrames) -> None:
        self._frames = frames
        self._poses: tuple[tuple[float, Pose], ...] = ()
        """When each came, and the pose. Never changed, only replaced: other threads read it."""

    def look(self) -> None:
        """Note where the base is now; called some ten times a second."""
        now = time.monotonic()
        try:
            pose = self._frames.odometry()
        except FramesError:
            self._poses = ()
            return
        before = self._poses
        if not before or pose.stamp_ns != before[-1][1].stamp_ns:
            self._poses = (*(one for one in before if one[0] >= now - _KEPT_SECONDS), (now, pose))

    def stands(self, since: float = 0.0) -> bool | None:
        """Whether the base has stood for `STANDING_SECONDS` by its odometry's stamps; None without odometry.

        What came before ``since`` (monotonic seconds) does not count.
        """
        poses = self._poses
        if not poses:
            return None
        now = poses[-1][1]
        for came, pose in reversed(poses):
            turned = math.remainder(pose.theta - now.theta, math.tau)
            if math.hypot(pose.x - now.x, pose.y - now.y) > STILL_METRES or abs(turned) > STILL_RADIANS:
                return False
            if came < since:
                return None
            if now.stamp_ns - pose.stamp_ns >= STANDING_SECONDS * 1e9:
                return True
        return None

    @property
    def speed(self) -> float | None:
        """Metres a second over the last seconds; None where that is not known, or the base hardly moves."""
        poses = self._poses
        if len(poses) < 2:
            return None
        first, last = poses[0][1], poses[-1][1]
        seconds = (last.stamp_ns - first.stamp_ns) / 1e9
        moved = math.hypot(last.x - first.x, last.y - first.y)
        return moved / seconds if seconds > 0 and moved > 2 * STILL_METRES else None


UNKNOWN = math.nan
"""A distance that is not known: no comparison with it is true, where 0.0 would mean "arrived"."""

_AT_ITS_END = 1.0  # metres from the goal within which a path that leads to it ends


def distance(robot: Pose | None, goal: Pose | None, path: Mapping[str, Any] | None, frame: str) -> float:
    """Metres along the rest of the path, or straight to the goal without one; `UNKNOWN` without a pose.

    Robot and goal are in ``frame``, the map's; the path is the planner's ``nav_msgs/Path``, where it tells one.
    """
    if robot is None or goal is None:
        return UNKNOWN
    poses = [] if path is None else path["poses"]
    if path is not None and len(poses) > 0 and str(path["header"]["frame_id"]).lstrip("/") == frame:
        places = (one["pose"]["position"] for one in poses)
        points = np.array([(place["x"], place["y"]) for place in places])
        if math.hypot(points[-1, 0] - goal.x, points[-1, 1] - goal.y) < _AT_ITS_END:
            return _along(points, robot)
    return robot.distance(goal)


def _along(points: np.ndarray[Any, np.dtype[np.float64]], robot: Pose) -> float:
    away = np.hypot(points[:, 0] - robot.x, points[:, 1] - robot.y)
    nearest = int(away.argmin())
    steps = np.diff(points[nearest:], axis=0)
    return float(away[nearest] + np.hypot(steps[:, 0], steps[:, 1]).sum())


def seconds(metres: float, speed: float | None) -> dict[str, int]:
    """A ``builtin_interfaces/Duration`` for that distance; zero, which is unset, where it is not known."""
    if speed is None or not math.isfinite(metres):
        return {"sec": 0, "nanosec": 0}
    return duration(metres / speed)
