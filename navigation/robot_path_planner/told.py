"""What the planner tells of itself: topics of the hub, and ports of YARP."""

from __future__ import annotations

import math
from typing import Any

from bridge.hub.qos import Durability, Qos
from bridge.modules.host import Host
from navigation.messages import pose_message
from navigation.pose import Pose
from navigation.robot_path_planner.picture import draw
from navigation.robot_path_planner.planner import PathPlanner, Status
from navigation.status import NO_GOAL, STATUS, status_message
from yarp_compat.sig.image import ImageRgb

PREFIX = "/planner/robot_path_planner"
_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_SPHERES, _LINES, _ARROW, _DELETE_ALL = 7, 4, 0, 3
_BLUE, _PINK = {"r": 0.0, "g": 0.25, "b": 0.9, "a": 1.0}, {"r": 0.8, "g": 0.0, "b": 0.5, "a": 1.0}
_SAID_AGAIN = 5.0
"""Seconds after which YARP's status port says the same again, as upstream's does."""

_REASON_AGAIN = 1.0

Message = dict[str, Any]


class Told:
    """Publishes what has changed. On the module's thread.

    Args:
        host: the module's.
        frame: the map's.
        prefix: begins the YARP ports; empty for none.
    """

    def __init__(self, host: Host, frame: str, prefix: str) -> None:
        self._host, self._frame = host, frame
        node = host.node
        self._status = node.publisher(f"{PREFIX}/status", STATUS, _LATCHED, priority="state")
        self._path = node.publisher(f"{PREFIX}/path", "nav_msgs/msg/Path", _LATCHED, priority="state")
        self._markers = node.publisher(
            f"{PREFIX}/markers", "visualization_msgs/msg/MarkerArray", _LATCHED, priority="state"
        )
        self._words = host.yarp.output(f"{prefix}/plannerStatus:o") if prefix else None
        self._image = host.yarp.output(f"{prefix}/map:o") if prefix else None
        self._last: tuple[Status, bytes] | None = None
        self._way: object = None
        self._said = self._published = -math.inf

    def tell(self, now: float, planner: PathPlanner, goal_id: bytes = NO_GOAL) -> None:
        """Tell what is new: the status, and the way."""
        status, target = planner.status, planner.target
        if self._is_news(now, status, goal_id):
            self._last, self._published = (status, goal_id), now
            goal = None if target is None else {"header": self._header(), "pose": pose_message(target.pose)}
            self._status.publish(
                status_message(
                    self._host.clock.stamp(), status.state, status.reason, status.fault, goal_id=goal_id, goal=goal
                )
            )
            self._said = -math.inf
        if self._words is not None and now - self._said >= _SAID_AGAIN:
            self._said = now
            self._words.write([f"navigation_status_{status.state.value}"])
        if planner.waypoints is not self._way:
            self._way = planner.waypoints
            self._tell_way(planner)

    def _is_news(self, now: float, status: Status, goal_id: bytes) -> bool:
        """Whether to publish a status; one with another reason only, as with seconds that pass, once a second."""
        if self._last is None or (status, goal_id) == self._last:
            return self._last is None
        before, goal_before = self._last
        same = (status.state, status.fault, goal_id) == (before.state, before.fault, goal_before)
        return not same or not 0 <= now - self._published < _REASON_AGAIN

    def show(self, planner: PathPlanner, pose: Pose | None) -> None:
        """Send a picture to whoever sees."""
        if self._image is None or not self._image.heard:
            return
        pixels = draw(planner, pose)
        if pixels is not None:
            self._image.write(ImageRgb.of(pixels))

    def _tell_way(self, planner: PathPlanner) -> None:
        header = self._header()
        poses = [each.pose for each in planner.waypoints]
        self._path.publish({"header": header, "poses": [{"header": header, "pose": pose_message(p)} for p in poses]})
        markers: list[Message] = [{"header": header, "action": _DELETE_ALL}]
        if poses:
            points = [{"x": each.x, "y": each.y, "z": 0.05} for each in poses]
            still = {"header": header, "pose": pose_message(Pose(0.0, 0.0, 0.0)), "color": _BLUE, "points": points}
            dots = {"x": 0.1, "y": 0.1, "z": 0.1}
            markers += [
                {**still, "ns": "way", "id": 1, "type": _LINES, "scale": {"x": 0.03, "y": 0.0, "z": 0.0}},
                {**still, "ns": "waypoints", "id": 2, "type": _SPHERES, "scale": dots},
                {"header": header, "ns": "goal", "id": 3, "type": _ARROW, "pose": pose_message(poses[-1]),
                 "scale": {"x": 0.5, "y": 0.08, "z": 0.08}, "color": _PINK},
            ]  # fmt: skip
        self._markers.publish({"markers": markers})

    def _header(self) -> Message:
        return {"stamp": self._host.clock.stamp(), "frame_id": self._frame}
