"""The feeds of the robot: its pose, laser scan, path and goal. Used only on the module's thread."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.client.navigation import STATUS_TOPIC
from bridge.config.model import Config
from bridge.hub.wire.qos import LATCHED, Qos, Reliability
from bridge.messages.actions import names, types
from bridge.modules.endpoints import Subscription
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from bridge.web.feeds.feed import Feed
from bridge.web.feeds.frames import FrameFeed, FrameFollower
from bridge.web.section import WebSection
from navigation.frames import LATE, FramesError, RobotFrames, laser_pose
from navigation.gateway.telemetry import PATH
from navigation.maps.grid import yaw_of
from navigation.messages import NAVIGATE, stamp_ns
from navigation.pose import Pose
from navigation.scan import SCAN
from navigation.status import STATUS, State

ROBOT_SECONDS = 0.1
MOST_POINTS = 2000
"""Maximum number of points of a path or scan; if there are more, only every second (third ...) point is sent."""
_CORNERS = 16
_LASER_GAP = 0.8 * ROBOT_SECONDS
"""Minimum seconds between two scans; a scan that arrives sooner waits for the timer, which is rare at 10 Hz."""


class RobotFeed(FrameFeed):
    """``robot``: the robot's pose and footprint."""

    def __init__(self, host: Host, follower: FrameFollower, footprint: Sequence[Sequence[float]]) -> None:
        super().__init__(host, follower, "robot", ROBOT_SECONDS)
        self._footprint = [list(corner) for corner in footprint]

    @override
    def refresh(self) -> None:
        try:
            pose = self._follower.frames.pose()
        except FramesError as err:
            self.put(None, str(err))
            return
        self.put({"pose": pose_json(pose), "footprint": self._footprint})


class TopicsFeed(Feed):
    """A feed made from topics of the hub, which are subscribed while the feed is watched."""

    def __init__(self, host: Host, name: str) -> None:
        super().__init__(name)
        self._host = host
        self._ends: list[Subscription] = []

    def follow(self, topic: str, type_name: str, on_message: Callable[[dict[str, Any]], None], qos: Qos) -> None:
        """Subscribe until the feed is closed."""
        self._ends.append(self._host.node.subscription(topic, type_name, on_message, qos))

    @override
    def close(self) -> None:
        ends, self._ends = self._ends, []
        for end in ends:
            self._host.node.release(end)


class LaserFeed(TopicsFeed):
    """``laser``: the laser scan on the map, about ten times a second."""

    def __init__(self, host: Host, follower: FrameFollower, topic: str) -> None:
        super().__init__(host, "laser")
        self._follower, self._topic = follower, topic
        self._timer: Timer | None = None
        self._scan: dict[str, Any] | None = None
        self._refreshed = -math.inf

    @override
    def open(self) -> None:
        if not self._topic:
            self.put(None, "no laser is configured (web.laser)")
            return
        self._follower.begin()
        self.follow(self._topic, SCAN, self._on_scan, Qos(Reliability.BEST_EFFORT, depth=1))
        self._timer = self._host.loop.every(ROBOT_SECONDS, self._refresh)

    @override
    def close(self) -> None:
        super().close()
        if self._timer is not None:
            self._timer.close()
            self._timer = None
            self._follower.end()

    def _on_scan(self, scan: dict[str, Any]) -> None:
        self._scan = scan
        if time.monotonic() - self._refreshed > _LASER_GAP:
            self._refresh()  # otherwise the timer refreshes

    def _refresh(self) -> None:
        scan, self._scan = self._scan, None
        if scan is None:
            return
        self._refreshed = time.monotonic()
        frames, header = self._follower.frames, scan["header"]
        try:
            laser = laser_pose(frames, header["frame_id"])
            at = _robot_pose(frames, stamp_ns(header))
        except FramesError as err:
            self.put(None, str(err))
            return
        self.put({"points": points_of(scan, at @ laser)})


class PathFeed(TopicsFeed):
    """``path``: the last path of the chosen planner, until its goal ends."""

    def __init__(self, host: Host, config: Config, driving: DrivingFeed) -> None:
        super().__init__(host, "path")
        self._config, self._driving = config, driving
        self._topic = ""
        self._last: list[float] = []
        driving.on_change(self._update)

    @override
    def open(self) -> None:
        self._update()

    @override
    def close(self) -> None:
        """Unsubscribe; the path of a paused goal stays cached for the next page."""
        super().close()
        self._topic = ""

    def _update(self) -> None:
        driving = self._driving
        topic = self._config.section(WebSection).path or self._path_topic(driving.planner)
        ended = not (driving.drives or driving.paused)
        if ended or not (self.watched or driving.paused):
            self._last = []
        if not self.watched:
            return
        if topic != self._topic:
            super().close()
            self._topic = topic
            if topic:
                self.follow(topic, PATH, self._on_path, LATCHED)
        if ended or not topic:
            self.put({"points": []})
        elif driving.paused:
            self.put({"points": self._last})

    def _path_topic(self, planner: str) -> str:
        other = self._config.navigation.others.get(planner)
        return other.path if other else f"/planner/{planner}/path" if planner else ""

    def _on_path(self, path: dict[str, Any]) -> None:
        points = points_of_path(path)
        if not (self._driving.drives or self._driving.paused):
            return
        # ignore an empty path during a goal, because planners clear their path when a pause cancels the goal; `_update`
        # handles the end of a goal
        if points or not any(self._driving.goal_id):
            self._last = points
            self.put({"points": points})


class DrivingFeed(TopicsFeed):
    """``driving``: the gateway's status of the current goal. The console itself watches it permanently."""

    STANDING = frozenset(state.value for state in State if state.ended or state is State.PAUSED)

    def __init__(self, host: Host, config: Config) -> None:
        super().__init__(host, "driving")
        self._config = config
        self._status: dict[str, Any] | None = None
        self._distance: float | None = None
        self._callbacks: list[Callable[[], None]] = []
        self.planner = config.navigation.planner

    def on_change(self, action: Callable[[], None]) -> None:
        """Register a callback for changes of state or planner."""
        self._callbacks.append(action)

    @property
    def drives(self) -> bool:
        """Whether a planner controls the base now, as far as known."""
        return self._status is not None and self._status["state"] not in self.STANDING

    @property
    def paused(self) -> bool:
        """Whether a goal is paused."""
        return self.state == State.PAUSED.value

    @property
    def state(self) -> str:
        """The gateway's state; "" if unknown."""
        return "" if self._status is None else str(self._status["state"])

    @property
    def goal_id(self) -> bytes:
        """The id of the gateway's goal; zeros if there is none."""
        return bytes(16) if self._status is None else bytes(self._status["goal_id"])

    @property
    def busy(self) -> str:
        """Why manual driving is refused; "" if it is allowed."""
        return f"{self.planner} drives; pause or stop it first" if self.drives else ""

    @override
    def open(self) -> None:
        self.follow(STATUS_TOPIC, STATUS, self._on_status, LATCHED)
        section = self._config.navigation
        if section.planner:
            topic, kind = names(section.at(self.planner)).feedback, types(NAVIGATE).feedback
            self.follow(topic, kind, self._on_feedback, Qos(depth=1))
        self._publish()

    @override
    def close(self) -> None:
        super().close()
        self._status = self._distance = None

    def on_planner(self, planner: str) -> None:
        """Switch to another planner."""
        status, self.planner = self._status, planner
        self.close()
        self.open()
        self._status = status
        self._publish()
        self._notify()

    def moved_by_hand(self) -> None:
        """Clear the distance of a paused goal, because it is unknown until the planner continues."""
        if self.paused:
            self._distance = None
            self._publish()

    def _on_status(self, status: dict[str, Any]) -> None:
        before, self._status = self.goal_id, status
        if self.goal_id != before or not (self.drives or self.paused):
            self._distance = None
        self._publish()
        self._notify()

    def _on_feedback(self, message: dict[str, Any]) -> None:
        if self.paused:
            return  # feedback from before the pause
        left = float(message["feedback"]["distance_remaining"])
        # Nav2 sends 0.0 before its first path, and any planner may while a pause cancels its goal
        if math.isfinite(left) and left > 0.0:
            self._distance = round(left, 1)
            self._publish()

    def _notify(self) -> None:
        for callback in self._callbacks:
            callback()

    def _publish(self) -> None:
        section, status = self._config.navigation, self._status
        if not section.planner:
            self.put(None, "no planner is configured (navigation.planner)")
        elif status is None:
            self.put(None, "waiting for the gateway's status")
        else:
            goal = status["goal"]["pose"]
            at = Pose(float(goal["position"]["x"]), float(goal["position"]["y"]), yaw_of(goal["orientation"]))
            under_way = self.drives or self.paused
            self.put(
                {
                    "state": status["state"],
                    "reason": status["reason"],
                    "goal": pose_json(at) if any(status["goal_id"]) and under_way else None,
                    "distance": self._distance if under_way else None,
                    "planner": self.planner,
                    "planners": list(section.choices),
                }
            )


def _robot_pose(frames: RobotFrames, stamp: int) -> Pose:
    """Return the robot's pose on the map at a time, by odometry if possible, because a localizer may publish rarely."""
    try:
        return frames.correction() @ frames.transform(frames.odom_frame, frames.base_frame, stamp, extrapolate=LATE)
    except FramesError:
        return frames.transform(frames.map_frame, frames.base_frame, stamp, extrapolate=LATE)


def disc(radius: float) -> list[list[float]]:
    """Return a circular footprint as corners in meters."""
    angles = (math.tau * corner / _CORNERS for corner in range(_CORNERS))
    return [[round(radius * math.cos(angle), 3), round(radius * math.sin(angle), 3)] for angle in angles]


def points_of_path(path: dict[str, Any]) -> list[float]:
    """Return x, y, x, y, ... of a ``nav_msgs/Path`` in meters; if it is long, of every second (third ...) pose only."""
    poses = path["poses"][:: max(1, math.ceil(len(path["poses"]) / MOST_POINTS))]
    spots = [pose["pose"]["position"] for pose in poses]
    return [round(float(spot[axis]), 3) for spot in spots for axis in "xy"]


def pose_json(pose: Pose) -> dict[str, float]:
    """Return a pose for pages, rounded to millimeters and 0.1 milliradians."""
    return {"x": round(pose.x, 3), "y": round(pose.y, 3), "theta": round(pose.theta, 4)}


def points_of(scan: dict[str, Any], laser: Pose) -> list[float]:
    """Return the ends of a ``LaserScan``'s beams on the map, rounded to centimeters: x, y, x, y ...

    Beams without a valid range are omitted; if more than `MOST_POINTS` remain, only every second (third ...) beam is
    returned. Source: sensor_msgs/LaserScan.
    """
    ranges = np.asarray(scan["ranges"], np.float64)
    angles = laser.theta + scan["angle_min"] + scan["angle_increment"] * np.arange(len(ranges))
    kept = np.isfinite(ranges) & (ranges >= scan["range_min"]) & (ranges <= scan["range_max"])
    step = max(1, math.ceil(int(kept.sum()) / MOST_POINTS))
    ranges, angles = ranges[kept][::step], angles[kept][::step]
    ends = np.stack([laser.x + ranges * np.cos(angles), laser.y + ranges * np.sin(angles)], axis=1)
    points: list[float] = np.round(ends, 2).reshape(-1).tolist()
    return points
