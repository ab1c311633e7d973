"""The robot's pose from ``/tf``, for the stand-ins for Nav2's servers."""

from __future__ import annotations

import math
import time
from typing import Any

from rclpy.node import Node
from tf2_msgs.msg import TFMessage

Pose = tuple[float, float, float]


class Transforms:
    """Tracks the transform from ``map`` to ``base_link``, direct or through ``odom``; rotations in the plane only.

    A transform's age is counted from its arrival, because stamps on a busy machine are already late.
    """

    def __init__(self, node: Node, tolerance: float, group: Any = None) -> None:
        self.tolerance = tolerance
        self.frames: dict[str, tuple[str, Pose, float]] = {}
        node.create_subscription(TFMessage, "tf", self.on_transforms, 100, callback_group=group)

    def on_transforms(self, message: TFMessage) -> None:
        now = time.monotonic()
        for frame in message.transforms:
            place, turn = frame.transform.translation, frame.transform.rotation
            pose = place.x, place.y, 2 * math.atan2(turn.z, turn.w)
            self.frames[frame.child_frame_id] = frame.header.frame_id, pose, now

    def wait(self) -> None:
        """Wait for the first pose."""
        while self.pose() is None:
            time.sleep(0.05)

    def pose(self) -> Pose | None:
        """Return x, y and yaw in the map; None if a transform is missing or older than the tolerance."""
        x, y, yaw, frame = 0.0, 0.0, 0.0, "base_link"
        while frame != "map":
            if frame not in self.frames:
                return None
            frame, (dx, dy, turn), arrived = self.frames[frame]
            if time.monotonic() - arrived > self.tolerance:
                return None
            x, y = dx + x * math.cos(turn) - y * math.sin(turn), dy + x * math.sin(turn) + y * math.cos(turn)
            yaw += turn
        return x, y, yaw
