"""How fast the robot is, by where it was: the OdometryData of ILocalization2D.

As upstream's localisers have it (``localization_device_with_estimated_odometry.cpp``): the pose is the one on the map.
"""

from __future__ import annotations

import math

from navigation.localization_server.odometry import Track
from navigation.pose import Pose
from yarp_compat.dev.odometry import OdometryData

_SPAN_NS = 300_000_000
"""Over so long velocities are means."""


class Motion:
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
