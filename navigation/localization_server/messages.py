"""Poses and their covariances as messages, and back."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from navigation.localization_server.estimate import Floats
from navigation.maps.grid import yaw_of
from navigation.pose import Pose

POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
POSES, PARTICLES = "geometry_msgs/msg/PoseArray", "nav2_msgs/msg/ParticleCloud"

Message = dict[str, Any]

_PLANE = (0, 1, 5)
"""Rows of a 6x6 covariance that are in the plane: x, y and the turn about the vertical."""


def stamp_ns(header: Mapping[str, Any]) -> int:
    """The stamp of a header."""
    return int(header["stamp"]["sec"]) * 1_000_000_000 + int(header["stamp"]["nanosec"])


def pose_of(message: Mapping[str, Any], stamp: int = 0) -> Pose:
    """The pose of a ``geometry_msgs/Pose``, on the floor.

    Raises:
        ValueError: it is not finite.
    """
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
    """A ``geometry_msgs/PoseArray`` in CDR; a thousand poses as values would take milliseconds.

    Args:
        stamp: of its header.
        frame: of its header.
        cloud: (n, 3) metres and radians.
    """
    name = frame.encode() + b"\0"
    head = struct.pack("<iII", stamp["sec"], stamp["nanosec"], len(name)) + name
    head += bytes(-len(head) % 4) + struct.pack("<I", len(cloud))
    if len(cloud):
        head += bytes(-len(head) % 8)
    poses = np.zeros((len(cloud), 7), "<f8")
    poses[:, :2] = cloud[:, :2]
    poses[:, 5], poses[:, 6] = np.sin(cloud[:, 2] / 2.0), np.cos(cloud[:, 2] / 2.0)
    return b"\0\1\0\0" + head + poses.tobytes()
