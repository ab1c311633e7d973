"""Message types and conversions that the modules share: stamps, poses and durations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from navigation.pose import Pose

GRID, STRING = "nav_msgs/msg/OccupancyGrid", "std_msgs/msg/String"
NAVIGATE, THROUGH = "nav2_msgs/action/NavigateToPose", "nav2_msgs/action/NavigateThroughPoses"

Message = dict[str, Any]


def stamp_ns(header: Mapping[str, Any]) -> int:
    """Return the stamp of a header, nanoseconds."""
    return int(header["stamp"]["sec"]) * 1_000_000_000 + int(header["stamp"]["nanosec"])


def pose_message(pose: Pose, z: float = 0.0) -> Message:
    """Return a ``geometry_msgs/msg/Pose`` at a height in meters; a heading that is not finite becomes 0."""
    theta = pose.theta if math.isfinite(pose.theta) else 0.0
    return {
        "position": {"x": pose.x, "y": pose.y, "z": z},
        "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(theta / 2), "w": math.cos(theta / 2)},
    }


def duration(seconds: float) -> dict[str, int]:
    """Return a ``builtin_interfaces/msg/Duration``, clamped to the range from 0 to 2e9 s."""
    whole = min(max(seconds, 0.0), 2e9)
    return {"sec": int(whole), "nanosec": int(whole % 1 * 1e9)}
