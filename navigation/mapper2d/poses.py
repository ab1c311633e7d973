"""Where the laser was when it scanned: the robot's pose from frames, a topic or a port, and the laser's place on it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from bridge.config.sections.maps import Mapper2DSection
from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host
from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import TransformError
from bridge.tf.transform import LATEST
from navigation.frames import FramesError, RobotFrames, flat
from navigation.maps.grid import yaw_of
from navigation.messages import stamp_ns
from navigation.pose import Pose
from yarp_compat.dev.basecontrol import OdometryData
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.os.data.stamp import Stamp
from yarp_compat.pythonic import Received
from yarp_compat.wire.errors import WireError

ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
COVARIANT = "geometry_msgs/msg/PoseWithCovarianceStamped"
_THERE, _ROBOT = "there", "robot"


class RobotPoses(ABC):
    """Says where the robot was."""

    @abstractmethod
    def at(self, stamp: int) -> Pose:
        """Its pose at a time (ns, or `LATEST`); raises `FramesError` where that is not known, or not yet."""


class FramePoses(RobotPoses):
    """By the frames of all sides: odometry then, in what localisation says of the odometry's frame now."""

    def __init__(self, frames: RobotFrames) -> None:
        self._frames = frames

    def at(self, stamp: int) -> Pose:
        """As `Robot.at`."""
        frames = self._frames
        if frames.map_frame == frames.odom_frame:
            return frames.transform(frames.odom_frame, frames.base_frame, stamp)
        try:
            correction = frames.correction()
        except FramesError:
            return frames.transform(frames.map_frame, frames.base_frame, stamp)
        return correction @ frames.transform(frames.odom_frame, frames.base_frame, stamp)


class PosesInTime(RobotPoses):
    """Interpolates between poses that come one by one."""

    def __init__(self, host: Host, who: str) -> None:
        self._host, self._who = host, who
        self._buffer = TransformBuffer(now=host.clock.now_ns)
        host.on_jump(self._buffer.clear)

    def tell(self, stamp: int, x: float, y: float, theta: float) -> None:
        """Take a pose: ns, metres, radians. Called from any thread."""
        self._buffer.set_transform(
            _THERE, _ROBOT, stamp or self._host.clock.now_ns(), (x, y, 0.0),
            (0.0, 0.0, math.sin(theta / 2.0), math.cos(theta / 2.0)),
        )  # fmt: skip

    def at(self, stamp: int) -> Pose:
        """As `Robot.at`."""
        try:
            return flat(self._buffer.lookup_transform(_THERE, _ROBOT, stamp))
        except TransformError:
            raise FramesError(f"no pose of the scan's time came on {self._who}") from None


class Poses:
    """Where the laser was, by what the section says."""

    def __init__(self, host: Host, section: Mapper2DSection) -> None:
        self._frames = RobotFrames(host, section.map_frame, section.base_frame, section.odom_frame)
        self._mount = None if section.laser is None else _degrees(*section.laser)
        self._offset = Pose(0.0, 0.0, 0.0)
        self._wanted: Pose | None = None
        self._robot: RobotPoses = FramePoses(self._frames)
        if section.pose == "topic":
            self._robot = told = PosesInTime(host, section.pose_topic)
            for kind in (ODOMETRY, POSE, COVARIANT):
                host.node.subscription(
                    section.pose_topic, kind, lambda m: told.tell(stamp_ns(m["header"]), *of_message(m)), Qos(depth=100)
                )
        elif section.pose == "port":
            self._robot = given = PosesInTime(host, f"{section.prefix}/odometry:i")
            host.yarp.input(f"{section.prefix}/odometry:i", lambda received: _take(given, received))

    def laser(self, frame: str, stamp: int) -> Pose:
        """Where the laser was on the map at a time, ns; raises `FramesError` where that is not known, or not yet.

        A laser without a frame, as on YARP, is in the robot's middle.
        """
        mount = self._mount
        if mount is None:
            mount = self._frames.transform(self._frames.base_frame, frame) if frame else Pose(0.0, 0.0, 0.0)
        return self.robot(stamp) @ mount

    def hangs(self, frame: str) -> bool:
        """Whether the laser hangs upside down; one whose place the section says stands."""
        return self._mount is None and self._frames.hangs(frame)

    def robot(self, stamp: int = LATEST) -> Pose:
        """Where the robot was on the map; raises `FramesError`."""
        if self._wanted is not None:
            self._offset, self._wanted = self._wanted @ self._robot.at(LATEST).inverse, None
        return self._offset @ self._robot.at(stamp)

    def set(self, there: Pose) -> None:
        """Say where the robot is now; where it is not known yet where it thinks it is, as soon as it is."""
        self._wanted = there
        try:
            self.robot()
        except FramesError:
            return


def of_message(message: Mapping[str, Any]) -> tuple[float, float, float]:
    """x, y (metres) and direction (radians) of a message with a pose, with or without covariance."""
    pose = message["pose"]
    pose = pose.get("pose", pose)
    return pose["position"]["x"], pose["position"]["y"], yaw_of(pose["orientation"])


def _take(told: PosesInTime, received: Received) -> None:
    """A pose of YARP: an OdometryData, a Map2DLocation, or ``x y theta_deg``."""
    pose = _of_yarp(received)
    if not all(map(math.isfinite, pose[:3])):
        raise WireError(f"{pose[:3]} is no pose")
    told.tell(sent(received.envelope), pose.x, pose.y, pose.theta)


def _of_yarp(received: Received) -> Pose:
    try:
        said = received.to(OdometryData)
    except WireError:
        pass
    else:
        return _degrees(said.odom_x, said.odom_y, said.odom_theta)
    try:
        place = received.to(Map2DLocation)
    except WireError:
        pass
    else:
        return _degrees(place.x, place.y, place.theta)
    values = received.values
    if len(values) == 3 and all(isinstance(value, (int, float)) for value in values):
        return _degrees(*values)
    raise WireError("a pose is an OdometryData, a Map2DLocation, or three numbers: x y theta_deg")


def sent(envelope: str) -> int:
    """When a message was sent, ns; 0 where it does not say."""
    if not envelope:
        return 0
    stamp = Stamp()
    stamp.from_text(envelope)
    return max(0, round(stamp.getTime() * 1e9))


def _degrees(x: float, y: float, theta: float) -> Pose:
    return Pose(x, y, math.radians(theta))
