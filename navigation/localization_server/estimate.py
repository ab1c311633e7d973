"""Estimates of the robot's pose, conversions of poses with covariances, and velocities from odometry."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navigation.maps.grid import yaw_of
from navigation.pose import Pose, wrapped
from yarp_compat.dev.basecontrol import OdometryData

Floats = NDArray[np.float64]


class LocalizationStatus(StrEnum):
    """YARP's ``LocalizationStatusEnum``, by its names."""

    NOT_YET = "not_yet_localized"
    OK = "localized_ok"
    ERROR = "error"


@dataclass(frozen=True)
class PoseEstimate:
    """An estimate of the robot's pose."""

    pose: Pose | None  #: on the map; None if it is unknown
    covariance: Floats  #: (3, 3) of x, y, theta: meters, radians
    quality: float  #: share of the scan that the map explains, less the share that contradicts the pose, 0 to 1
    status: LocalizationStatus  #: whether the pose is reliable
    reason: str  #: why the pose is not reliable; "" if it is


def unknown(reason: str, status: LocalizationStatus = LocalizationStatus.NOT_YET) -> PoseEstimate:
    """Return an estimate without a pose."""
    return PoseEstimate(None, np.zeros((3, 3)), 0.0, status, reason)


def covariance_of(meters: float, radians: float) -> Floats:
    """Return the covariance (3, 3) for standard deviations in x and y, and in the heading."""
    return np.diag([meters**2, meters**2, radians**2])


POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
POSES, PARTICLES = "geometry_msgs/msg/PoseArray", "nav2_msgs/msg/ParticleCloud"

Message = dict[str, Any]

_PLANE = (0, 1, 5)  # rows of a 6x6 covariance in the plane: x, y and yaw


def pose_of(message: Mapping[str, Any], stamp: int = 0) -> Pose:
    """Convert a ``geometry_msgs/Pose`` to a pose on the floor; raises `ValueError` if it is not finite."""
    place = message["position"]
    pose = Pose(float(place["x"]), float(place["y"]), yaw_of(message["orientation"]), stamp)
    if not all(map(math.isfinite, pose[:3])):
        raise ValueError(f"invalid pose {pose[:3]}: values must be finite")
    return pose


def plane_of(covariance: Any) -> Floats | None:
    """Return the (3, 3) covariance of x, y and yaw from a 6x6 covariance; None if it is invalid, or all zeros."""
    whole = np.asarray(covariance, np.float64).reshape(6, 6)
    plane: Floats = whole[np.ix_(_PLANE, _PLANE)]
    if not np.isfinite(plane).all() or (np.diag(plane) < 0.0).any() or not plane.any():
        return None
    return plane


def spatial(covariance: Floats) -> Floats:
    """Expand a (3, 3) covariance in the plane to a 6x6, of shape (36,)."""
    whole = np.zeros((6, 6))
    whole[np.ix_(_PLANE, _PLANE)] = covariance
    return whole.ravel()


def particles_cdr(stamp: Mapping[str, int], frame: str, cloud: Floats) -> bytes:
    """Encode (n, 3) meters and radians as a ``PoseArray`` in CDR; the generic encoder would take milliseconds."""
    name = frame.encode() + b"\0"
    head = struct.pack("<iII", stamp["sec"], stamp["nanosec"], len(name)) + name
    head += bytes(-len(head) % 4) + struct.pack("<I", len(cloud))
    if len(cloud):
        head += bytes(-len(head) % 8)
    poses = np.zeros((len(cloud), 7), "<f8")
    poses[:, :2] = cloud[:, :2]
    poses[:, 5], poses[:, 6] = np.sin(cloud[:, 2] / 2.0), np.cos(cloud[:, 2] / 2.0)
    return b"\0\1\0\0" + head + poses.tobytes()


_KEPT_NS = 3_000_000_000
_MOST = 1000


class Track:
    """Poses in the odometry frame, in the order of their stamps."""

    def __init__(self) -> None:
        self._poses: deque[Pose] = deque(maxlen=_MOST)

    @property
    def newest(self) -> Pose | None:
        return self._poses[-1] if self._poses else None

    def add(self, pose: Pose) -> None:
        """Add a pose; it replaces all poses that are not older."""
        while self._poses and self._poses[-1].stamp_ns >= pose.stamp_ns:
            self._poses.pop()
        self._poses.append(pose)
        while self._poses[0].stamp_ns < pose.stamp_ns - _KEPT_NS:
            self._poses.popleft()

    def pose_at(self, stamp_ns: int) -> Pose | None:
        """Return the base's pose at a time, or the nearest pose outside the known times; None without poses."""
        later = None
        for pose in reversed(self._poses):
            if pose.stamp_ns <= stamp_ns:
                return pose if later is None else _interpolate(pose, later, stamp_ns)
            later = pose
        return later

    def clear(self) -> None:
        self._poses.clear()


def _interpolate(before: Pose, after: Pose, stamp_ns: int) -> Pose:
    share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    turned = wrapped(after.theta - before.theta)
    return Pose(
        before.x + share * (after.x - before.x),
        before.y + share * (after.y - before.y),
        wrapped(before.theta + share * turned),
        stamp_ns,
    )


_SPAN_NS = 300_000_000  # velocities are averaged over this time


class OdometryEstimator:
    """Estimates velocities from odometry, which unlike the pose on the map does not jump."""

    def __init__(self) -> None:
        self._track = Track()

    def add(self, pose: Pose) -> None:
        """Add a pose from odometry."""
        self._track.add(pose)

    def data(self, pose: Pose) -> OdometryData:
        """Return a pose on the map with the base's velocity on the map and in its own frame."""
        newest = self._track.newest
        before = None if newest is None else self._track.pose_at(newest.stamp_ns - _SPAN_NS)
        result = OdometryData(pose.x, pose.y, math.degrees(pose.theta))
        if newest is None or before is None or newest.stamp_ns <= before.stamp_ns:
            return result
        seconds = (newest.stamp_ns - before.stamp_ns) / 1e9
        step = before.inverse @ newest
        turned = step.theta / 2.0  # the path is an arc: its chord points half the rotation back
        c, s = math.cos(-turned), math.sin(-turned)
        result.base_vel_x, result.base_vel_y = (c * step.x - s * step.y) / seconds, (s * step.x + c * step.y) / seconds
        result.base_vel_theta = result.odom_vel_theta = math.degrees(step.theta) / seconds
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        result.odom_vel_x = c * result.base_vel_x - s * result.base_vel_y
        result.odom_vel_y = s * result.base_vel_x + c * result.base_vel_y
        return result

    def clear(self) -> None:
        """Drop all poses, after a clock jump or without odometry."""
        self._track.clear()
