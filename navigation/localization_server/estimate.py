"""An estimate of where the robot is, poses with covariances as messages, and velocities from odometry."""

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
    """Where the robot is."""

    pose: Pose | None  #: on the map; None before a start was given
    covariance: Floats  #: (3, 3) of x, y, theta: metres, radians
    quality: float  #: share of the scan that the map explains, less what speaks against it, 0 to 1
    status: LocalizationStatus  #: whether to rely on it
    reason: str  #: why not


def unknown(reason: str, status: LocalizationStatus = LocalizationStatus.NOT_YET) -> PoseEstimate:
    """Nothing is known."""
    return PoseEstimate(None, np.zeros((3, 3)), 0.0, status, reason)


def covariance_of(metres: float, radians: float) -> Floats:
    """The covariance (3, 3) of standard deviations that are the same in x and y."""
    return np.diag([metres**2, metres**2, radians**2])


POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
POSES, PARTICLES = "geometry_msgs/msg/PoseArray", "nav2_msgs/msg/ParticleCloud"

Message = dict[str, Any]

_PLANE = (0, 1, 5)  # rows of a 6x6 covariance that are in the plane: x, y and the turn about the vertical


def pose_of(message: Mapping[str, Any], stamp: int = 0) -> Pose:
    """The pose of a ``geometry_msgs/Pose``, on the floor; raises `ValueError` if it is not finite."""
    place = message["position"]
    found = Pose(float(place["x"]), float(place["y"]), yaw_of(message["orientation"]), stamp)
    if not all(map(math.isfinite, found[:3])):
        raise ValueError(f"a pose at {found[:3]} is nowhere")
    return found


def plane_of(covariance: Any) -> Floats | None:
    """The (3, 3) of x, y and turn out of a 6x6; None where it is no covariance, or all zeros."""
    whole = np.asarray(covariance, np.float64).reshape(6, 6)
    found: Floats = whole[np.ix_(_PLANE, _PLANE)]
    if not np.isfinite(found).all() or (np.diag(found) < 0.0).any() or not found.any():
        return None
    return found


def spatial(covariance: Floats) -> Floats:
    """A 6x6, of shape (36,), with a (3, 3) of the plane in it."""
    whole = np.zeros((6, 6))
    whole[np.ix_(_PLANE, _PLANE)] = covariance
    return whole.ravel()


def particles_cdr(stamp: Mapping[str, int], frame: str, cloud: Floats) -> bytes:
    """A ``PoseArray`` in CDR of (n, 3) metres and radians; a thousand poses as values would take milliseconds."""
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
    """Poses in the odometry's frame, in the order of their stamps."""

    def __init__(self) -> None:
        self._poses: deque[Pose] = deque(maxlen=_MOST)

    @property
    def newest(self) -> Pose | None:
        """What was said last."""
        return self._poses[-1] if self._poses else None

    def add(self, pose: Pose) -> None:
        """Take up another; one that is not newer than the last takes its place, with all that came after it."""
        while self._poses and self._poses[-1].stamp_ns >= pose.stamp_ns:
            self._poses.pop()
        self._poses.append(pose)
        while self._poses[0].stamp_ns < pose.stamp_ns - _KEPT_NS:
            self._poses.popleft()

    def at(self, stamp_ns: int) -> Pose | None:
        """Where the base was; before and behind all that is known, the nearest. None where nothing is known."""
        later = None
        for pose in reversed(self._poses):
            if pose.stamp_ns <= stamp_ns:
                return pose if later is None else _between(pose, later, stamp_ns)
            later = pose
        return later

    def clear(self) -> None:
        """Forget all: the clock or the odometry began anew."""
        self._poses.clear()


def _between(one: Pose, two: Pose, stamp_ns: int) -> Pose:
    share = (stamp_ns - one.stamp_ns) / (two.stamp_ns - one.stamp_ns)
    turned = wrapped(two.theta - one.theta)
    return Pose(
        one.x + share * (two.x - one.x),
        one.y + share * (two.y - one.y),
        wrapped(one.theta + share * turned),
        stamp_ns,
    )


_SPAN_NS = 300_000_000  # over so long velocities are means


class OdometryEstimator:
    """Velocities from poses on the map, or better from odometry, which does not jump."""

    def __init__(self) -> None:
        self._track = Track()

    def add(self, pose: Pose) -> None:
        """Take up where odometry says that the base is."""
        self._track.add(pose)

    def data(self, where: Pose) -> OdometryData:
        """A pose on the map, and how fast the base moves on the map and in its own frame."""
        newest = self._track.newest
        before = None if newest is None else self._track.at(newest.stamp_ns - _SPAN_NS)
        found = OdometryData(where.x, where.y, math.degrees(where.theta))
        if newest is None or before is None or newest.stamp_ns <= before.stamp_ns:
            return found
        seconds = (newest.stamp_ns - before.stamp_ns) / 1e9
        step = before.inverse @ newest
        turned = step.theta / 2.0  # the way was an arc: what was driven points half the turn back
        c, s = math.cos(-turned), math.sin(-turned)
        found.base_vel_x, found.base_vel_y = (c * step.x - s * step.y) / seconds, (s * step.x + c * step.y) / seconds
        found.base_vel_theta = found.odom_vel_theta = math.degrees(step.theta) / seconds
        c, s = math.cos(where.theta), math.sin(where.theta)
        found.odom_vel_x = c * found.base_vel_x - s * found.base_vel_y
        found.odom_vel_y = s * found.base_vel_x + c * found.base_vel_y
        return found

    def forget(self) -> None:
        """The clock was set back."""
        self._track.clear()
