"""What the messages of maps and places have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from bridge.hub.qos import Durability, Qos

LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)

GRID = "nav_msgs/msg/OccupancyGrid"

Message = dict[str, Any]


class Head:
    """What headers say.

    Args:
        frame: the frame of all maps.
        now_ns: says the time in nanoseconds.

    Attributes:
        frame: the frame of all maps.
    """

    def __init__(self, frame: str, now_ns: Callable[[], int]) -> None:
        self.frame, self.now_ns = frame, now_ns

    def header(self) -> Message:
        """``std_msgs/msg/Header`` of now."""
        seconds, nanoseconds = divmod(self.now_ns(), 1_000_000_000)
        return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": self.frame}


def colour(red: float, green: float, blue: float) -> Message:
    """``std_msgs/msg/ColorRGBA``."""
    return {"r": red, "g": green, "b": blue, "a": 1.0}


def points(corners: Sequence[tuple[float, float]], z: float = 0.02) -> list[Message]:
    """``geometry_msgs/msg/Point`` of each corner."""
    return [{"x": x, "y": y, "z": z} for x, y in corners]
