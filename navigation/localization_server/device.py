"""What YARP's clients of the localisation call; see `yarp_compat.dev.localization2d_server`."""

# ruff: noqa: N802, D102 - YARP's names, and its interface says what each does

from __future__ import annotations

import math
from typing import Protocol

from navigation.calls import Calls
from navigation.localization_server.estimate import Estimate, Floats
from navigation.pose import Pose
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.odometry import OdometryData
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode

_MOST_POSES = 500
"""Particles that are told at most: each is a whole location with its map's name."""


class Asked(Protocol):
    """The module, as it is asked."""

    @property
    def map_name(self) -> str:
        """The map in use."""

    def estimate(self) -> Estimate:
        """Where the robot is."""

    def cloud(self) -> Floats:
        """Where it may be."""

    def odometry(self) -> OdometryData | None:
        """Where it is and how fast; None where nobody knows."""

    def begin(self, pose: Pose, covariance: Floats | None, map_name: str) -> None:
        """Begin there; raises `RuntimeError` with why not."""

    def rest(self, *, on: bool) -> None:
        """Work no more, or again."""


class Device:
    """Methods run on the threads of the connections; what they do is done on the module's.

    Covariances are of metres and radians, as upstream's localisers take them from ROS and give them to it.

    Args:
        asked: the module.
        calls: does things on its thread.
    """

    def __init__(self, asked: Asked, calls: Calls) -> None:
        self._asked, self._call = asked, calls.do

    def startLocalizationService(self) -> None:
        self._call(lambda: self._asked.rest(on=False))

    def stopLocalizationService(self) -> None:
        self._call(lambda: self._asked.rest(on=True))

    def getLocalizationStatus(self) -> str:
        return self._call(lambda: self._asked.estimate().status.value)

    def getEstimatedPoses(self) -> list[Map2DLocation]:
        cloud, name = self._call(lambda: (self._asked.cloud(), self._asked.map_name))
        few = cloud[:: max(1, math.ceil(len(cloud) / _MOST_POSES))]
        return [Map2DLocation(name, x, y, math.degrees(theta)) for x, y, theta in few.tolist()]

    def getCurrentPosition(self) -> tuple[Map2DLocation, Floats]:
        found, name = self._call(lambda: (self._asked.estimate(), self._asked.map_name))
        if found.pose is None:
            raise CallFailed(ReturnCode.METHOD_FAILED, found.reason)
        return location(found.pose, name), found.covariance

    def getEstimatedOdometry(self) -> OdometryData:
        found = self._call(self._asked.odometry)
        if found is None:
            raise CallFailed(ReturnCode.METHOD_FAILED, "it is not known where the robot is")
        return found

    def setInitialPose(self, loc: Map2DLocation, cov: Floats | None) -> None:
        pose = Pose(loc.x, loc.y, math.radians(loc.theta))
        given = cov if cov is not None and cov.any() else None  # nobody is as sure as zeros say
        try:
            self._call(lambda: self._asked.begin(pose, given, loc.map_id))
        except RuntimeError as err:
            raise CallFailed(ReturnCode.METHOD_FAILED, str(err)) from None


def location(pose: Pose, map_name: str) -> Map2DLocation:
    """A pose on a map as YARP has it."""
    return Map2DLocation(map_name, pose.x, pose.y, math.degrees(pose.theta))
