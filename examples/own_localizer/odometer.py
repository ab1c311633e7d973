"""A localizer of your own, as simple as possible: it computes the pose from a known start and the wheels' odometry.

LocalizationServer publishes the estimate to all sides, answers `ILocalization2D`, and publishes the odometry frame's
pose on the map. Replace `estimate` and `correction`, and keep the rest.
"""

from __future__ import annotations

import math

from bridge.modules.host import Host
from navigation.frames import FramesError, RobotFrames
from navigation.localization_server.estimate import Floats, LocalizationStatus, PoseEstimate, covariance_of, unknown
from navigation.localization_server.section import LocalizationServerSection
from navigation.localization_server.sources import PoseSource
from navigation.pose import Pose


class Odometer(PoseSource):
    """Option: ``drift``, the error of the odometry, in meters per meter that the robot drives."""

    accepts_starts = True  # LocalizationServer passes on poses from `/initialpose` and `setInitialPose`
    corrects = True  # LocalizationServer publishes `correction` as the transform from map to odom

    def __init__(self, _host: Host, section: LocalizationServerSection, frames: RobotFrames) -> None:
        self._frames, self._drift = frames, float(section.options.get("drift", 0.05))
        self._start: Pose | None = None
        self._correction: Pose | None = None
        self._last, self._driven = Pose(0.0, 0.0, 0.0), 0.0
        if section.initial_pose is not None:
            x, y, degrees = section.initial_pose
            self._start = Pose(x, y, math.radians(degrees))

    def initial(self, pose: Pose, covariance: Floats | None) -> None:  # noqa: ARG002 - the covariance is not used
        """Start at a pose on the map."""
        self._start, self._correction, self._driven = pose, None, 0.0

    def estimate(self) -> PoseEstimate:
        """Return the robot's pose on the map, or why it is unknown; called every `period` (by default 0.1 s)."""
        if self._start is None:
            return unknown("waiting for an initial pose")
        try:
            odometry = self._frames.odometry()
        except FramesError as err:
            return unknown(str(err), LocalizationStatus.ERROR)
        if self._correction is None:  # the first odometry since the start
            self._correction, self._last = self._start @ odometry.inverse, odometry
        self._driven, self._last = self._driven + odometry.distance(self._last), odometry
        spread = 0.05 + self._drift * self._driven
        covariance = covariance_of(spread, spread)  # meters, radians
        return PoseEstimate(self._correction @ odometry, covariance, 1.0, LocalizationStatus.OK, "")

    def correction(self) -> Pose | None:
        """Return the pose of the odometry frame on the map; None if it is unknown."""
        return self._correction
