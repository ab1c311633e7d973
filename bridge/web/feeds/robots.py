"""The feed ``robots``: poses of the other robots on the hub, from their frames."""

from __future__ import annotations

from functools import partial
from typing import Any

from typing_extensions import override

from bridge.hub.wire.qos import LATCHED
from bridge.modules.endpoints import Subscription
from bridge.modules.host import Host
from bridge.tf.transform import LATEST
from bridge.web.feeds.frames import FrameFeed, FrameFollower
from bridge.web.feeds.robot import ROBOT_SECONDS, disc, points_of_path, pose_json
from bridge.web.section import OtherRobot
from navigation.frames import FramesError
from navigation.gateway.telemetry import PATH

AGE = 3.0
"""Seconds without a new pose after which a robot is hidden."""


class RobotsFeed(FrameFeed):
    """``robots``: pose, footprint and path of each robot of ``web.robots``, in that order."""

    def __init__(self, host: Host, follower: FrameFollower, robots: tuple[OtherRobot, ...]) -> None:
        super().__init__(host, follower, "robots", ROBOT_SECONDS)
        self._robots = robots
        self._paths: dict[str, list[float]] = {}
        self._subscriptions: list[Subscription] = []

    @override
    def open(self) -> None:
        if not self._robots:
            self.put([])
            return
        for robot in self._robots:
            if robot.path:
                on_path = partial(self._on_path, robot.name)
                self._subscriptions.append(self._host.node.subscription(robot.path, PATH, on_path, LATCHED))
        super().open()

    @override
    def close(self) -> None:
        if not self._robots:
            return
        super().close()
        subscriptions, self._subscriptions = self._subscriptions, []
        for subscription in subscriptions:
            self._host.node.release(subscription)
        self._paths.clear()

    @override
    def refresh(self) -> None:
        self.put([self._snapshot(robot) for robot in self._robots])

    def _snapshot(self, robot: OtherRobot) -> dict[str, Any]:
        frames = self._follower.frames
        try:
            pose = frames.transform(frames.map_frame, robot.base_frame, LATEST)
        except FramesError as err:
            return {"name": robot.name, "pose": None, "why": str(err)}
        age = (self._host.clock.now_ns() - pose.stamp_ns) / 1e9 if pose.stamp_ns else 0.0
        if age > AGE:
            return {"name": robot.name, "pose": None, "why": f"no recent transform of {robot.base_frame}"}
        path = self._paths.get(robot.name, [])
        return {"name": robot.name, "pose": pose_json(pose), "footprint": disc(robot.radius), "path": path}

    def _on_path(self, name: str, path: dict[str, Any]) -> None:
        self._paths[name] = points_of_path(path)
