"""The pose of the robot from the frames of all sides, and the status of localization."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from itertools import takewhile
from typing import Any

from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from bridge.modules.transforms import FrameSubscriptions
from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import TransformError
from bridge.tf.transform import LATEST, Transform
from navigation.messages import STRING
from navigation.pose import Pose

LATE = 0.2  # seconds by which a stamp may be newer than the newest transform


class FramesError(RuntimeError):
    """A pose is unknown or too old; the text gives the reason."""


class RobotFrames:
    """Follows `/tf` and `/tf_static` for one module."""

    def __init__(
        self,
        host: Host,
        map_frame: str = "map",  # the fixed frame of maps
        base_frame: str = "base_link",  # the robot's frame
        odom_frame: str = "odom",  # between the two: localization publishes map to odom, odometry odom to base
        *,
        odometry_age: float = 0.5,  # seconds after which odometry is stale
        localization_age: float = 2.0,  # the same for map to odom, which localizers publish less often
    ) -> None:
        self.map_frame, self.base_frame, self.odom_frame = (
            name.lstrip("/") for name in (map_frame, base_frame, odom_frame)
        )
        self._odometry_age, self._localization_age = odometry_age, localization_age
        self._now_ns = host.clock.now_ns
        self.buffer = TransformBuffer(now=self._now_ns)
        # at_once, because a base publishes odometry a hundred times a second, which would wake each module's thread
        self._subscriptions = FrameSubscriptions(host.node, self.buffer.set_message, at_once=True)
        host.clock.on_jump(self.buffer.clear)

    def listen(self) -> None:
        """Subscribe to the frames again after `unsubscribe`."""
        self._subscriptions.open()

    def unsubscribe(self) -> None:
        """Unsubscribe, and clear the buffer."""
        self._subscriptions.close()
        self.buffer.clear()

    def pose(self) -> Pose:
        """Return the pose of the robot on the map now; raises `FramesError`, which names the silent source."""
        try:
            odometry = self.odometry()
        except FramesError:
            if any(self.odom_frame in (info.name, info.parent) for info in self.buffer.frames()):
                raise
            # without an odometry frame, the localizer publishes map to base directly
            return self._fresh(self.map_frame, self.base_frame, self._localization_age, "localization")
        return self.correction() @ odometry

    def odometry(self) -> Pose:
        """Return the pose of the robot in the odometry frame; raises `FramesError` like `pose`."""
        return self._fresh(self.odom_frame, self.base_frame, self._odometry_age, "odometry")

    def correction(self) -> Pose:
        """Return the pose of the odometry frame on the map; raises `FramesError` like `pose`."""
        return self._fresh(self.map_frame, self.odom_frame, self._localization_age, "localization")

    def is_upside_down(self, frame: str) -> bool:
        """Whether a sensor is mounted upside down on the base; False if its mounting is unknown."""
        try:
            x, y, _, _ = self._lookup(self.base_frame, frame, LATEST, 0.0).rotation
        except FramesError:
            return False
        return x * x + y * y > 0.5

    def on_map(self, frame: str) -> Pose:
        """Return the pose of a frame on the map now; raises `FramesError` if it is unknown or too old."""
        if frame == self.odom_frame:
            return self.correction()
        if self._moves_with_robot(frame):
            return self.pose() @ self.transform(self.base_frame, frame)
        return self.transform(self.map_frame, frame)

    def transform(self, target: str, source: str, stamp: int = LATEST, *, extrapolate: float = 0.0) -> Pose:
        """Return the pose of the source frame in the target frame, flat on the floor, at a stamp (ns) or `LATEST`.

        The motion of frames is extrapolated by up to ``extrapolate`` seconds before their first and after their last
        transform. Raises `FramesError` with the reason if the transform is unknown.
        """
        return flat(self._lookup(target, source, stamp, extrapolate))

    def placed_at(self, frame: str, stamp: int) -> tuple[Transform, Transform]:
        """Return the transforms of a frame and of the base at a stamp (ns) or `LATEST`.

        Both are in the odometry frame, or on the map without odometry. Raises `FramesError` if unknown.
        """

        def lookup_both(fixed: str) -> tuple[Transform, Transform]:
            return self._lookup(fixed, frame, stamp, LATE), self._lookup(fixed, self.base_frame, stamp, LATE)

        try:
            return lookup_both(self.odom_frame)
        except FramesError as err:
            try:
                return lookup_both(self.map_frame)
            except FramesError:
                raise err from None

    def floor(self, configured: float | None) -> float:
        """Return the floor's height in the base frame, meters: configured, or ``base_footprint``'s (REP 120), or 0."""
        if configured is None:
            robot, slash, _ = self.base_frame.rpartition("/")
            try:
                return self._lookup(self.base_frame, f"{robot}{slash}base_footprint", LATEST, 0.0).translation[2]
            except FramesError:
                return 0.0
        return configured

    def _fresh(self, target: str, source: str, age: float, what: str) -> Pose:
        pose = flat(self._lookup(target, source, LATEST, 0.0))
        late = (self._now_ns() - pose.stamp_ns) / 1e9 if pose.stamp_ns else 0.0
        if late > age:
            raise FramesError(f"the {what} is stale: {source} in {target} was last published {late:.1f} s ago")
        return pose

    def _lookup(self, target: str, source: str, stamp: int, extrapolate: float) -> Transform:
        try:
            return self.buffer.lookup_transform(target, source, stamp, extrapolate=extrapolate)
        except TransformError as err:
            raise FramesError(f"no transform from {source} to {target}: {str(err).strip()}") from None

    def _moves_with_robot(self, frame: str) -> bool:
        parents = {info.name: info.parent for info in self.buffer.frames()}
        still = {self.odom_frame, self.map_frame}
        robot = set(takewhile(lambda parent: parent not in still, _upwards(self.base_frame, parents)))
        return not robot.isdisjoint(_upwards(frame, parents))


def _upwards(frame: str, parents: Mapping[str, str]) -> list[str]:
    """Return a frame, its parent and so on."""
    chain: list[str] = []
    while frame and frame not in chain:
        chain.append(frame)
        frame = parents.get(frame, "")
    return chain


def flat(transform: Transform) -> Pose:
    """Return a transform's pose on the floor."""
    x, y, z, w = transform.rotation
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return Pose(transform.translation[0], transform.translation[1], yaw, transform.stamp)


STATUS, REASON = "/localization/status", "/localization/reason"
_BELIEVED = ("", "localized_ok")


class Localized:
    """The status of a localizer, if it publishes one. Used only on the module's thread."""

    def __init__(self, host: Host) -> None:
        self._texts = {STATUS: "", REASON: ""}
        for topic in self._texts:
            host.node.subscription(topic, STRING, partial(self._on_text, topic), LATCHED)

    def check(self) -> None:
        """Raise `FramesError` with the reason if the robot is not localized."""
        status, reason = self._texts.values()
        if status not in _BELIEVED:
            raise FramesError(f"localization status is '{status}'" + (f": {reason}" if reason else ""))

    def _on_text(self, topic: str, message: dict[str, Any]) -> None:
        self._texts[topic] = message["data"]


def laser_pose(frames: RobotFrames, frame: str) -> Pose:
    """Return the pose of a laser on the base; raises `FramesError` if it is unknown."""
    return Pose(0.0, 0.0, 0.0) if frame.lstrip("/") == frames.base_frame else frames.transform(frames.base_frame, frame)


def moved_at(frames: RobotFrames, stamp_ns: int) -> Pose:
    """Return the base's pose in the odometry frame, or on the map without odometry; raises `FramesError` if unknown."""
    try:
        return frames.transform(frames.odom_frame, frames.base_frame, stamp_ns, extrapolate=LATE)
    except FramesError as err:
        try:
            return frames.transform(frames.map_frame, frames.base_frame, stamp_ns, extrapolate=LATE)
        except FramesError:
            raise err from None
