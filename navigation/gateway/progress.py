"""How far a drive still has to go, for planners that do not report it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from navigation.messages import duration
from navigation.pose import Pose

UNKNOWN = math.nan
"""An unknown distance: no comparison with it is true, while 0.0 would mean "arrived"."""

_END_DISTANCE = 1.0
"""A path that ends within this distance of the goal leads to it, in meters."""


def distance(robot: Pose | None, goal: Pose | None, path: Mapping[str, Any] | None, frame: str) -> float:
    """Return the meters along the rest of the path, or straight to the goal without one; `UNKNOWN` without a pose.

    Robot and goal are in ``frame``, the map's; the path is the planner's ``nav_msgs/Path``, if it publishes one.
    """
    if robot is None or goal is None:
        return UNKNOWN
    poses = [] if path is None else path["poses"]
    if path is not None and len(poses) > 0 and str(path["header"]["frame_id"]).lstrip("/") == frame:
        positions = (stamped["pose"]["position"] for stamped in poses)
        points = np.array([(position["x"], position["y"]) for position in positions])
        if math.hypot(points[-1, 0] - goal.x, points[-1, 1] - goal.y) < _END_DISTANCE:
            return _along(points, robot)
    return robot.distance(goal)


def _along(points: np.ndarray[Any, np.dtype[np.float64]], robot: Pose) -> float:
    away = np.hypot(points[:, 0] - robot.x, points[:, 1] - robot.y)
    nearest = int(away.argmin())
    steps = np.diff(points[nearest:], axis=0)
    return float(away[nearest] + np.hypot(steps[:, 0], steps[:, 1]).sum())


def seconds(meters: float, speed: float | None) -> dict[str, int]:
    """Return a ``builtin_interfaces/Duration`` for that distance; zero, which means unset, if it is unknown."""
    if speed is None or not math.isfinite(meters):
        return {"sec": 0, "nanosec": 0}
    return duration(meters / speed)
