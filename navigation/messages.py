"""Poses as messages."""

from __future__ import annotations

import math
from typing import Any

from navigation.pose import Pose


def pose_message(pose: Pose, z: float = 0.0) -> dict[str, Any]:
    """``geometry_msgs/msg/Pose`` at a height, metres; a heading that is none is 0."""
    theta = pose.theta if math.isfinite(pose.theta) else 0.0
    return {
        "position": {"x": pose.x, "y": pose.y, "z": z},
        "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(theta / 2), "w": math.cos(theta / 2)},
    }
