"""Where the robot is, by the frames of all sides, and whether the localisation relies on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from itertools import takewhile
from typing import Any

from bridge.hub.wire.qos import LATCHED, Durability, Qos
from bridge.modules.endpoints import Subscription
from bridge.modules.host import Host
from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import TransformError
from bridge.tf.stamped import TF, TF_STATIC, TF_TYPE
from bridge.tf.transform import LATEST, Transform
from navigation.messages import STRING
from navigation.pose import Pose

LATE = 0.2  # seconds by which a stamp may be newer than what was said of frames
_DEPTH = 1000  # messages of `/tf` that may wait: every publisher of a robot sends its own at the same time
_STATIC = Qos(durability=Durability.TRANSIENT_LOCAL, depth=100)


class FramesError(RuntimeError):
    """It is not known where something is; the text says why."""


class RobotFrames:
    """Follows `/tf` and `/tf_static` for one module."""

    def __init__(
        self,
        host: Host,
        map_frame: str = "map",  # the fixed frame of maps
        base_frame: str = "base_link",  # the robot's
        odom_frame: str = "odom",  # between the two, where odometry and localisation each say one part
        *,
        odometry_age: float = 0.5,  # seconds after which odometry that is not said again is of no use
        localization_age: float = 2.0,  # the same of map to odom; localisers say it less often
    ) -> None:
        self.map_frame, self.base_frame, self.odom_frame = (
            name.lstrip("/") for name in (map_frame, base_frame, odom_frame)
        )
        self._odometry_age, self._localization_age = odometry_age, localization_age
        self._now_ns = host.clock.now_ns
        self.buffer = TransformBuffer(now=self._now_ns)
        self._node = host.node
        self._ends: list[Subscription] = []
        self.listen()
        host.clock.on_jump(self.buffer.clear)

    def listen(self) -> None:
        """Follow the frames; done at the start, and after `rest`."""
        # at once: a base says its odometry a hundred times a second, and each module would be woken for it
        hear = self._node.subscription_cdr
        self._ends = [
            hear(TF, TF_TYPE, partial(self._hear, static=False), Qos(depth=_DEPTH), at_once=True),
            hear(TF_STATIC, TF_TYPE, partial(self._hear, static=True), _STATIC, at_once=True),
        ]

    def rest(self) -> None:
        """Follow the frames no more, and forget them."""
        ends, self._ends = self._ends, []
        for end in ends:
            self._node.release(end)
        self.buffer.clear()

    def _hear(self, cdr: bytes, *, static: bool) -> None:
        self.buffer.set_message(cdr, static=static)

    def pose(self) -> Pose:
        """The robot on the map now, newest odometry in newest localisation; raises `FramesError` with who is silent."""
        try:
            odometry = self.odometry()
        except FramesError:
            if any(self.odom_frame in (info.name, info.parent) for info in self.buffer.frames()):
                raise
            # no odometry frame at all: somebody says at once where the robot is on the map
            return self._fresh(self.map_frame, self.base_frame, self._localization_age, "localisation")
        return self.correction() @ odometry

    def odometry(self) -> Pose:
        """Where the robot is in the odometry's frame; raises `FramesError` as `pose`."""
        return self._fresh(self.odom_frame, self.base_frame, self._odometry_age, "odometry")

    def correction(self) -> Pose:
        """Where the odometry's frame is on the map; raises `FramesError` as `pose`."""
        return self._fresh(self.map_frame, self.odom_frame, self._localization_age, "localisation")

    def hangs(self, frame: str) -> bool:
        """Whether a sensor hangs upside down on the base; False, too, where it is not known how it is mounted."""
        try:
            x, y, _, _ = self._look(self.base_frame, frame, LATEST, 0.0).rotation
        except FramesError:
            return False
        return x * x + y * y > 0.5

    def on_map(self, frame: str) -> Pose:
        """A frame on the map now, the robot's own as the robot is now; raises `FramesError` if unknown or too old."""
        if frame == self.odom_frame:
            return self.correction()
        if self._moves_with_robot(frame):
            return self.pose() @ self.transform(self.base_frame, frame)
        return self.transform(self.map_frame, frame)

    def transform(self, target: str, source: str, stamp: int = LATEST, *, extrapolate: float = 0.0) -> Pose:
        """The pose of the source frame in the target frame, flat on the floor, at ns or `LATEST`.

        Frames go on moving as they did for ``extrapolate`` seconds before and behind what is known. Raises
        `FramesError` with why there is none.
        """
        return flat(self._look(target, source, stamp, extrapolate))

    def placed_at(self, frame: str, stamp: int) -> tuple[Transform, Transform]:
        """A frame and the base at ns or `LATEST`, in the odometry's frame, or on the map without odometry.

        Raises `FramesError` if neither is known.
        """

        def both(fixed: str) -> tuple[Transform, Transform]:
            return self._look(fixed, frame, stamp, LATE), self._look(fixed, self.base_frame, stamp, LATE)

        try:
            return both(self.odom_frame)
        except FramesError as err:
            try:
                return both(self.map_frame)
            except FramesError:
                raise err from None

    def floor(self, told: float | None) -> float:
        """Height of the floor in the base's frame, metres: as told, else of ``base_footprint`` (REP 120), else 0."""
        if told is None:
            robot, slash, _ = self.base_frame.rpartition("/")
            try:
                told = self._look(self.base_frame, f"{robot}{slash}base_footprint", LATEST, 0.0).translation[2]
            except FramesError:
                return 0.0
        return told

    def _fresh(self, target: str, source: str, age: float, what: str) -> Pose:
        found = flat(self._look(target, source, LATEST, 0.0))
        late = (self._now_ns() - found.stamp_ns) / 1e9 if found.stamp_ns else 0.0
        if late > age:
            raise FramesError(f"the {what} is stale: {source} in {target} was last said {late:.1f} s ago")
        return found

    def _look(self, target: str, source: str, stamp: int, extrapolate: float) -> Transform:
        try:
            return self.buffer.lookup_transform(target, source, stamp, extrapolate=extrapolate)
        except TransformError as err:
            raise FramesError(f"it is not known where {source} is in {target}: {str(err).strip()}") from None

    def _moves_with_robot(self, frame: str) -> bool:
        parents = {info.name: info.parent for info in self.buffer.frames()}
        still = {self.odom_frame, self.map_frame}
        robot = set(takewhile(lambda one: one not in still, _upwards(self.base_frame, parents)))
        return not robot.isdisjoint(_upwards(frame, parents))


def _upwards(frame: str, parents: Mapping[str, str]) -> list[str]:
    """A frame, its parent and so on."""
    found: list[str] = []
    while frame and frame not in found:
        found.append(frame)
        frame = parents.get(frame, "")
    return found


def flat(transform: Transform) -> Pose:
    """A transform's pose on the floor."""
    x, y, z, w = transform.rotation
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return Pose(transform.translation[0], transform.translation[1], yaw, transform.stamp)


STATUS, REASON = "/localization/status", "/localization/reason"
_BELIEVED = ("", "localized_ok")


class Localized:
    """Follows the status of a localisation, if it publishes one. On the module's thread."""

    def __init__(self, host: Host) -> None:
        self._said = {STATUS: "", REASON: ""}
        for topic in self._said:
            host.node.subscription(topic, STRING, partial(self._hear, topic), LATCHED)

    def check(self) -> None:
        """Raise `FramesError` with why the pose is not to be believed."""
        status, reason = self._said.values()
        if status not in _BELIEVED:
            raise FramesError(f"the localisation says '{status}'" + (f": {reason}" if reason else ""))

    def _hear(self, topic: str, message: dict[str, Any]) -> None:
        self._said[topic] = message["data"]


def laser_pose(frames: RobotFrames, frame: str) -> Pose:
    """Where a laser is on the base; raises `FramesError` if that is not known."""
    return Pose(0.0, 0.0, 0.0) if frame.lstrip("/") == frames.base_frame else frames.transform(frames.base_frame, frame)


def moved_at(frames: RobotFrames, stamp_ns: int) -> Pose:
    """The base in the odometry's frame, or on the map without odometry; raises `FramesError` if neither is known."""
    try:
        return frames.transform(frames.odom_frame, frames.base_frame, stamp_ns, extrapolate=LATE)
    except FramesError as err:
        try:
            return frames.transform(frames.map_frame, frames.base_frame, stamp_ns, extrapolate=LATE)
        except FramesError:
            raise err from None
