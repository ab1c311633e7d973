"""The localizer: estimates the pose on a map from a laser and odometry.

It is a particle filter on a likelihood field. The filter cannot recover from an initial pose that is wrong by meters,
but a search can: if the map explains too little of a scan, the search tries all poses around the estimate, and moves
some particles to those that explain more. The localizer uses neither the hub nor a clock; the caller passes all times
as stamps.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms import particle_filter
from navigation.algorithms.likelihood_field import LikelihoodField
from navigation.algorithms.pose_search import PoseSearch
from navigation.localization_server.estimate import LocalizationStatus, PoseEstimate, Track
from navigation.localization_server.judge import Judge
from navigation.localization_server.particles import ParticleSet
from navigation.localization_server.recovery import PoseRecovery, explained_shares
from navigation.localization_server.section import LocalizerSection
from navigation.pose import Pose
from navigation.scan import thinned
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

Floats = NDArray[np.float64]

SCAN_AGE, _ODOMETRY_AGE = 1.0, 1.0  # seconds after which the laser, or odometry, counts as silent
_SPREAD = np.diag([0.5**2, 0.5**2, math.radians(15.0) ** 2])
_FEWEST = 8  # a scan with fewer hits is useless
_FORCED = 5  # updates after an initial pose or a search, even if the base does not move
_NEVER = -(1 << 62)


class Localizer:
    """Follows a robot on one map; raises `ValueError` if the map has no walls, or no free cells.

    Args:
        grid: the map; scans are compared with its walls.
        seed: the seed of the random numbers; the same seed and data give the same poses.
    """

    def __init__(self, grid: MapGrid2D, settings: LocalizerSection | None = None, seed: int = 0) -> None:
        self.settings = settings or LocalizerSection()
        flags = grid.flags[::-1]
        walls = flags == MapFlag.WALL
        free = ~walls & (flags != MapFlag.UNKNOWN)
        if not walls.any() or not free.any():
            raise ValueError(f"localization on the map {grid.name!r} is impossible: it has no walls, or no free cells")
        self._corner = Pose(*grid.origin.to_ros())
        self._field = LikelihoodField(walls, free, grid.resolution)
        table = self._field.table(self.settings.laser_sigma, self.settings.laser_hit)
        self._particles = ParticleSet(self._field, table, self.settings, seed)
        self._track = Track()
        self._judge = Judge(self.settings)
        self._recovery = PoseRecovery(self._field, PoseSearch(self._field, table), self.settings, self._judge)
        self._updated: Pose | None = None
        self.correction: Pose | None = None
        self._covariance = np.zeros((3, 3))
        self._forced = 0
        self._start = Pose(0.0, 0.0, 0.0)
        self._scan_ns = _NEVER
        self.updates = 0

    @property
    def searches(self) -> int:
        """Number of searches for a better pose."""
        return self._recovery.searches

    def odometry(self, pose: Pose) -> None:
        """Add a stamped pose of the base from odometry."""
        self._track.add(pose)

    def restart(self) -> None:
        """Start again at the current pose with the default spread, after the clock of a simulation was set back."""
        pose = self.pose
        self.forget_stamps()
        if pose is not None:
            self.initial(pose)

    def forget_stamps(self) -> None:
        """Discard all stamps and keep the particles, after the system clock was set while the robot drove on."""
        self._start = self.pose or self._start
        self._track.clear()
        self._scan_ns = _NEVER
        self._recovery.forget_stamps()

    def initial(self, pose: Pose, covariance: Floats | None = None) -> None:
        """Start at a pose on the map; raises `ValueError` if a value is not finite.

        Args:
            pose: the robot's current pose.
            covariance: (3, 3) of x, y, theta: meters, radians; None: 0.5 m and 15 degrees.
        """
        if covariance is None:
            covariance = _SPREAD
        if not (np.isfinite(pose[:3]).all() and covariance.shape == (3, 3) and np.isfinite(covariance).all()):
            raise ValueError(f"invalid initial pose {pose[:3]} or covariance {covariance.tolist()}")
        turn = np.eye(3)
        c, s = math.cos(self._corner.theta), math.sin(self._corner.theta)
        turn[:2, :2] = [[c, s], [-s, c]]
        start = np.array((self._corner.inverse @ pose)[:3])
        self._particles.begin(start, turn @ covariance @ turn.T)
        self._covariance = covariance
        self._updated = self._track.newest
        self.correction = None if self._updated is None else pose @ self._updated.inverse
        self._start = pose
        self._forced = _FORCED
        self._judge.begin()
        self._recovery.begin()

    @property
    def pose(self) -> Pose | None:
        """The robot's pose on the map: the newest odometry with the correction."""
        newest = self._track.newest
        if not len(self._particles):
            return None
        if newest is None or self.correction is None:
            return self._start
        return self.correction @ newest

    def estimate(self) -> PoseEstimate:
        """Return the pose of the robot with its uncertainty."""
        return PoseEstimate(self.pose, self._covariance, self._judge.quality, self._judge.status, self._judge.reason)

    def cloud(self) -> Floats:
        """Return the particles on the map, (n, 3): meters, radians."""
        particles = self._particles.poses.copy()
        c, s = math.cos(self._corner.theta), math.sin(self._corner.theta)
        x, y = particles[:, 0].copy(), particles[:, 1].copy()
        particles[:, 0], particles[:, 1] = self._corner.x + c * x - s * y, self._corner.y + s * x + c * y
        particles[:, 2] = particle_filter.wrapped(particles[:, 2] + self._corner.theta)
        return particles

    def scan_age(self, now_ns: int) -> float:
        """Return the seconds since the last scan; a very large number before the first."""
        return (now_ns - self._scan_ns) / 1e9

    def check(self, now_ns: int) -> tuple[LocalizationStatus, str]:
        """Return the status at a time, even if scans or odometry have stopped, and the reason if it is not OK."""
        if not len(self._particles):
            return self._judge.status, self._judge.reason
        newest = self._track.newest
        for source, stamp, most in (
            ("odometry is", newest.stamp_ns if newest else _NEVER, _ODOMETRY_AGE),
            ("the laser is", self._scan_ns, SCAN_AGE),
        ):
            age = (now_ns - stamp) / 1e9
            if age > most:
                silence = f"silent for {age:.1f} s" if stamp != _NEVER else "not arriving"
                return (
                    LocalizationStatus.NOT_YET
                    if self._judge.status is LocalizationStatus.NOT_YET
                    else LocalizationStatus.ERROR
                ), f"{source} {silence}"
        return self._judge.status, self._judge.reason

    def scan(self, stamp_ns: int, points: Floats, odometry: Pose | None = None) -> bool:
        """Use a scan; return whether the filter ran.

        It runs if the base has moved, and after an initial pose or a search.

        ``points`` are the hits (n, 2) in the frame of the base, meters; ``odometry`` is the pose of the base at that
        time in the odometry frame; by default it follows from the poses added with `odometry`.
        """
        self._scan_ns = stamp_ns
        odometry = odometry or self._track.pose_at(stamp_ns)
        if odometry is None or not len(self._particles):
            return False
        if self._updated is None or self.correction is None:
            self._updated, self.correction = odometry, self._start @ odometry.inverse
        points = thinned(points, self.settings.beams)
        if len(points) < _FEWEST:
            self._judge.add(0.0, 0.0, self._spread, odometry, "too few echoes in the scan")
            return False
        ran = self._forced > 0 or self._has_moved_far(odometry)
        if ran:
            self._update(odometry, points)
        pose = self._corner.inverse @ self.correction @ odometry
        share, against = explained_shares(self._field, pose[:3], points)
        self._judge.add(share, against, self._spread, odometry)
        better = self._recovery.better(stamp_ns, pose, share, points)
        if better is not None:
            self._scatter(*better, len(points), odometry)
        return ran

    @property
    def _spread(self) -> float:
        """The spread of the particles, as a standard deviation in meters."""
        return math.sqrt(max(self._covariance[0, 0], self._covariance[1, 1]))

    def _step(self, odometry: Pose) -> tuple[float, float, float]:
        """Return the base's motion since the last update, in the base frame at that update."""
        assert self._updated is not None
        step = self._updated.inverse @ odometry
        return step.x, step.y, step.theta

    def _has_moved_far(self, odometry: Pose) -> bool:
        """Whether the base has moved far enough since the last update."""
        x, y, turned = self._step(odometry)
        settings = self.settings
        return math.hypot(x, y) >= settings.update_min_d or abs(turned) >= math.radians(settings.update_min_a)

    def _update(self, odometry: Pose, points: Floats) -> None:
        mode = self._particles.update(self._step(odometry), points, jitter=self._forced > 0)
        self._updated, self._forced = odometry, max(0, self._forced - 1)
        x, y, theta = mode.mean.tolist()
        self.correction = self._corner @ Pose(x, y, theta) @ odometry.inverse
        self._covariance = self._rotate(mode.covariance)
        self.updates += 1

    def _rotate(self, covariance: Floats) -> Floats:
        """Rotate a covariance from the field's frame to the map frame."""
        turn = np.eye(3)
        c, s = math.cos(self._corner.theta), math.sin(self._corner.theta)
        turn[:2, :2] = [[c, -s], [s, c]]
        rotated: Floats = turn @ covariance @ turn.T
        return rotated

    def _scatter(self, poses: Floats, scores: Floats, points: int, odometry: Pose) -> None:
        """Move some particles to other poses; the next scans decide which poses remain."""
        # particles that stay are moved as the base has since the last update, because the next update counts from now
        self._particles.scatter(poses, scores, points, self._step(odometry))
        self._updated, self._forced = odometry, _FORCED
        self._judge.doubt()
