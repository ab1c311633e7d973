"""The laser's pose at a scan's time: the robot's from /tf, a topic or a port, and the laser's pose on the robot."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from typing_extensions import override

from bridge.hub.wire.qos import Qos
from bridge.modules.host import Host
from bridge.tf.buffer import TransformBuffer
from bridge.tf.errors import TransformError
from bridge.tf.transform import LATEST
from navigation.frames import FramesError, RobotFrames, flat
from navigation.mapper2d.section import Mapper2DSection
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
_FIXED, _ROBOT = "fixed", "robot"


class RobotPoses(ABC):
    """A source of the robot's pose."""

    @abstractmethod
    def pose_at(self, stamp: int) -> Pose:
        """Return the pose at a time (ns, or `LATEST`); raises `FramesError` if it is not known (yet)."""


class FramePoses(RobotPoses):
    """Poses from /tf: the odometry at the requested time, with the current correction of the localization."""

    def __init__(self, frames: RobotFrames) -> None:
        self._frames = frames

    @override
    def pose_at(self, stamp: int) -> Pose:
        frames = self._frames
        if frames.map_frame == frames.odom_frame:
            return frames.transform(frames.odom_frame, frames.base_frame, stamp)
        try:
            correction = frames.correction()
        except FramesError:
            return frames.transform(frames.map_frame, frames.base_frame, stamp)
        return correction @ frames.transform(frames.odom_frame, frames.base_frame, stamp)


class InterpolatedPoses(RobotPoses):
    """Interpolates between the poses of a topic or port."""

    def __init__(self, host: Host, source: str) -> None:
        self._host, self._source = host, source
        self._buffer = TransformBuffer(now=host.clock.now_ns)
        host.on_jump(self._buffer.clear)

    def add(self, stamp: int, x: float, y: float, theta: float) -> None:
        """Add a pose: ns, meters, radians. May be called on any thread."""
        self._buffer.set_transform(
            _FIXED, _ROBOT, stamp or self._host.clock.now_ns(), (x, y, 0.0),
            (0.0, 0.0, math.sin(theta / 2.0), math.cos(theta / 2.0)),
        )  # fmt: skip

    @override
    def pose_at(self, stamp: int) -> Pose:
        try:
            return flat(self._buffer.lookup_transform(_FIXED, _ROBOT, stamp))
        except TransformError:
            raise FramesError(f"no pose for the scan's time on {self._source}") from None


class Poses:
    """The poses of the laser, from the source that the section configures."""

    def __init__(self, host: Host, section: Mapper2DSection) -> None:
        self._frames = RobotFrames(host, section.map_frame, section.base_frame, section.odom_frame)
        self._mount = None if section.laser is None else _degrees(*section.laser)
        self._offset = Pose(0.0, 0.0, 0.0)
        self._wanted: Pose | None = None
        self._robot: RobotPoses = FramePoses(self._frames)
        if section.pose == "topic":
            self._robot = poses = InterpolatedPoses(host, section.pose_topic)
            for kind in (ODOMETRY, POSE, COVARIANT):
                host.node.subscription(
                    section.pose_topic, kind, lambda m: poses.add(stamp_ns(m["header"]), *of_message(m)), Qos(depth=100)
                )
        elif section.pose == "port":
            self._robot = from_port = InterpolatedPoses(host, f"{section.prefix}/odometry:i")
            host.yarp.input(f"{section.prefix}/odometry:i", lambda received: _add_yarp(from_port, received))

    def laser(self, frame: str, stamp: int) -> Pose:
        """Return the laser's pose on the map at a time, ns; raises `FramesError` if it is not known (yet).

        A laser without a frame, as on YARP, is at the robot's center unless the section configures its pose.
        """
        return self.robot(stamp) @ self.mount(frame)

    def mount(self, frame: str) -> Pose:
        """Return the laser's pose on the robot: as configured, else of its frame; without a frame, the robot's center.

        Raises `FramesError` if the frame's pose is unknown.
        """
        if self._mount is not None:
            return self._mount
        return self._frames.transform(self._frames.base_frame, frame) if frame else Pose(0.0, 0.0, 0.0)

    @property
    def corrected(self) -> bool:
        """Whether another program publishes the transform from map to odometry."""
        try:
            self._frames.correction()
        except FramesError:
            return False
        return True

    def odometry(self, stamp: int = LATEST) -> Pose:
        """Return the robot's pose in the odometry frame at a time, ns, with the stamp; raises `FramesError`."""
        return self._frames.transform(self._frames.odom_frame, self._frames.base_frame, stamp)

    def is_upside_down(self, frame: str) -> bool:
        """Whether the laser is mounted upside down; False if the section configures its pose."""
        return self._mount is None and self._frames.is_upside_down(frame)

    def robot(self, stamp: int = LATEST) -> Pose:
        """Return the robot's pose on the map; raises `FramesError`."""
        if self._wanted is not None:
            self._offset, self._wanted = self._wanted @ self._robot.pose_at(LATEST).inverse, None
        return self._offset @ self._robot.pose_at(stamp)

    def set(self, pose: Pose) -> None:
        """Set the robot's current pose, now or as soon as the source has a pose."""
        self._wanted = pose
        try:
            self.robot()
        except FramesError:
            return


def of_message(message: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return x, y (meters) and heading (radians) of a message with a pose, with or without covariance."""
    pose = message["pose"]
    pose = pose.get("pose", pose)
    return pose["position"]["x"], pose["position"]["y"], yaw_of(pose["orientation"])


def _add_yarp(poses: InterpolatedPoses, received: Received) -> None:
    """Add a pose of YARP: an OdometryData, a Map2DLocation, or ``x y theta_deg``."""
    pose = _of_yarp(received)
    if not all(map(math.isfinite, pose[:3])):
        raise WireError(f"invalid pose {pose[:3]}: values must be finite")
    poses.add(sent_ns(received.envelope), pose.x, pose.y, pose.theta)


def _of_yarp(received: Received) -> Pose:
    try:
        odometry = received.to(OdometryData)
    except WireError:
        pass
    else:
        return _degrees(odometry.odom_x, odometry.odom_y, odometry.odom_theta)
    try:
        place = received.to(Map2DLocation)
    except WireError:
        pass
    else:
        return _degrees(place.x, place.y, place.theta)
    values = received.values
    if len(values) == 3 and all(isinstance(value, (int, float)) for value in values):
        return _degrees(*values)
    raise WireError("invalid pose: use an OdometryData, a Map2DLocation, or three numbers x y theta_deg")


def sent_ns(envelope: str) -> int:
    """Return the time stamp of an envelope, ns; 0 without one."""
    if not envelope:
        return 0
    stamp = Stamp()
    stamp.from_text(envelope)
    return max(0, round(stamp.getTime() * 1e9))


def _degrees(x: float, y: float, theta: float) -> Pose:
    return Pose(x, y, math.radians(theta))
