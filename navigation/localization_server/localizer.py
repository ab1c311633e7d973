"""The localizer: estimates the pose on a map from a laser and odometry.

A particle filter on a likelihood field. It cannot recover from a start that is wrong by meters; a search can: if
the map explains too little of a scan, it tries all poses around, and adds particles at those that explain more. The
localizer uses neither the hub nor a clock: the caller gives all times as stamps.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms import particle_filter
from navigation.algorithms.likelihood_field import LikelihoodField
from navigation.algorithms.pose_search import PoseSearch, SearchWindow
from navigation.localization_server.estimate import LocalizationStatus, PoseEstimate, Track
from navigation.localization_server.judge import Judge
from navigation.localization_server.section import LocalizerSection
from navigation.pose import Pose
from navigation.scan import thinned
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

Floats = NDArray[np.float64]

SCAN_AGE, _ODOMETRY_AGE = 1.0, 1.0  # seconds after which the laser, or odometry, counts as silent
_INDEPENDENT = 30.0  # as how many independent measurements a scan counts, since neighboring beams err together
_EXPLAINED_WITHIN = 0.15  # meters from a wall within which the map explains a beam's end
_SURE, _BETTER = 0.9, 0.1
"""The explained share from which no search runs, and how much more another pose must explain."""

_SEARCH_EVERY, _LOST_SEARCH_EVERY = 3.0, 1.0
"""Minimum seconds between searches; the second value if the robot is lost."""

_SEARCH_TURN, _LOST_REACH = 0.79, 12.0
"""The search range: radians to each side; meters in all directions if the robot is lost."""

_SPREAD = np.diag([0.5**2, 0.5**2, math.radians(15.0) ** 2])
_FEWEST = 8  # a scan with fewer hits is useless
_AFRESH = 0.5  # share of the particles that a search moves to other poses
_SCATTER = np.diag([0.1**2, 0.1**2, math.radians(3.0) ** 2])
_FORCED = 5  # updates after a start, even if the base does not move
_JITTER = np.diag([0.02**2, 0.02**2, math.radians(1.0) ** 2])
_PATIENCE = 4
_NEVER = -(1 << 62)


class Localizer:
    """Follows a robot on one map; raises `ValueError` if the map has no walls, or no free cells.

    Args:
        grid: the map, with whose walls scans are compared.
        seed: of the random numbers; the same seed and data give the same poses.
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
        self._table = self._field.table(self.settings.laser_sigma, self.settings.laser_hit)
        self._worst = float(self._table.min())
        self._search = PoseSearch(self._field, self._table)
        self._rng = np.random.default_rng(seed)
        alpha1, alpha2, alpha3, alpha4, alpha5 = self.settings.odom_alpha
        self._alphas = alpha1, alpha2, alpha3, alpha4, alpha5
        self._track = Track()
        self._judge = Judge(self.settings)
        self._particles = np.empty((0, 3))
        self._weights = np.empty(0)
        self._updated: Pose | None = None
        self.correction: Pose | None = None
        self._covariance = np.zeros((3, 3))
        self._forced = 0
        self._start = Pose(0.0, 0.0, 0.0)
        self._scan_ns = self._searched_ns = _NEVER
        self._fruitless = 0
        self.searches = 0
        self.updates = 0

    def odometry(self, pose: Pose) -> None:
        """Add a pose of the base by odometry, with its stamp."""
        self._track.add(pose)

    def restart(self) -> None:
        """Start at the current pose with the usual spread: the clock of a simulation was set back."""
        pose = self.pose
        self.forget_stamps()
        if pose is not None:
            self.initial(pose)

    def forget_stamps(self) -> None:
        """Discard all stamps, and keep the particles: the system clock was set while the robot drove on."""
        self._start = self.pose or self._start
        self._track.clear()
        self._scan_ns = self._searched_ns = _NEVER

    def initial(self, pose: Pose, covariance: Floats | None = None) -> None:
        """Start at a pose on the map; raises `ValueError` if a value is not finite.

        Args:
            pose: the given current pose of the robot.
            covariance: (3, 3) of x, y, theta: meters, radians; None: 0.5 m and 15 degrees.
        """
        if covariance is None:
            covariance = _SPREAD
        if not (np.isfinite(pose[:3]).all() and covariance.shape == (3, 3) and np.isfinite(covariance).all()):
            raise ValueError(f"invalid start pose {pose[:3]} or covariance {covariance.tolist()}")
        turn = np.eye(3)
        c, s = math.cos(self._corner.theta), math.sin(self._corner.theta)
        turn[:2, :2] = [[c, s], [-s, c]]
        start = np.array((self._corner.inverse @ pose)[:3])
        self._particles = particle_filter.spread(start, turn @ covariance @ turn.T, self.settings.particles, self._rng)
        self._weights = np.full(len(self._particles), 1.0 / len(self._particles))
        self._covariance = covariance
        self._updated = self._track.newest
        self.correction = None if self._updated is None else pose @ self._updated.inverse
        self._start = pose
        self._forced = _FORCED
        self._judge.begin()
        self._searched_ns, self._fruitless = _NEVER, 0

    @property
    def pose(self) -> Pose | None:
        """The newest odometry with the correction."""
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
        particles = self._particles.copy()
        c, s = math.cos(self._corner.theta), math.sin(self._corner.theta)
        x, y = particles[:, 0].copy(), particles[:, 1].copy()
        particles[:, 0], particles[:, 1] = self._corner.x + c * x - s * y, self._corner.y + s * x + c * y
        particles[:, 2] = particle_filter.wrapped(particles[:, 2] + self._corner.theta)
        return particles

    def scan_age(self, now_ns: int) -> float:
        """Return the seconds since the last scan; a very large number before the first."""
        return (now_ns - self._scan_ns) / 1e9

    def check(self, now_ns: int) -> tuple[LocalizationStatus, str]:
        """Return the status at a time, at which scans or odometry may have stopped, and the reason if it is not OK."""
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
        """Use a scan; return whether the filter ran, as it does if the base has moved, and after a start.

        ``points`` are the hits (n, 2) in the frame of the base, meters; ``odometry`` is the pose of the base at that
        time by odometry, None: by the poses from `odometry`.
        """
        self._scan_ns = stamp_ns
        odometry = odometry or self._track.pose_at(stamp_ns)
        if odometry is None or not len(self._particles):
            return False
        if self._updated is None or self.correction is None:
            self._updated, self.correction = odometry, self._start @ odometry.inverse
        points = thinned(points, self.settings.beams)
        if len(points) < _FEWEST:
            self._judge.add(0.0, 0.0, self._wide, odometry, "too few echoes in the scan")
            return False
        ran = self._forced > 0 or self._far(odometry)
        if ran:
            self._update(odometry, points)
        pose = self._corner.inverse @ self.correction @ odometry
        share, against = self._explained(pose[:3], points)
        self._judge.add(share, against, self._wide, odometry)
        self._search_around(stamp_ns, pose, share, odometry, points)
        return ran

    @property
    def _wide(self) -> float:
        """The spread of the particles, as a standard deviation in meters."""
        return math.sqrt(max(self._covariance[0, 0], self._covariance[1, 1]))

    def _far(self, odometry: Pose) -> bool:
        """Whether the base has moved far enough since the last update."""
        assert self._updated is not None
        step = self._updated.inverse @ odometry
        return math.hypot(step.x, step.y) >= self.settings.update_min_d or abs(step.theta) >= math.radians(
            self.settings.update_min_a
        )

    def _update(self, odometry: Pose, points: Floats) -> None:
        """Move and weigh the particles, and resample them if few have most of the weight."""
        assert self._updated is not None
        settings = self.settings
        step = self._updated.inverse @ odometry
        particle_filter.drive(
            self._particles, (step.x, step.y, step.theta), self._alphas, self._rng, holonomic=settings.holonomic
        )
        if self._forced:  # while the base stands, duplicates would stay the same forever
            self._particles += particle_filter.spread(np.zeros(3), _JITTER, len(self._particles), self._rng)
        logs = self._field.score(self._table, self._worst, self._particles, points)
        logs *= min(1.0, _INDEPENDENT / len(points))
        self._weights = particle_filter.weighed(self._weights, logs)
        mode = particle_filter.heaviest(self._particles, self._weights, self._rng)
        if particle_filter.effective(self._weights) < len(self._weights) / 2:
            which = particle_filter.drawn(self._weights, settings.particles, self._rng)
            self._particles = self._particles[which]
            self._weights = np.full(len(which), 1.0 / len(which))
        self._updated, self._forced = odometry, max(0, self._forced - 1)
        x, y, theta = mode.mean.tolist()
        self.correction = self._corner @ Pose(x, y, theta) @ odometry.inverse
        self._covariance = self._turned(mode.covariance)
        self.updates += 1

    def _turned(self, covariance: Floats) -> Floats:
        """Rotate a covariance from the field's frame to the map frame."""
        turn = np.eye(3)
        c, s = math.cos(self._corner.theta), math.sin(self._corner.theta)
        turn[:2, :2] = [[c, -s], [s, c]]
        rotated: Floats = turn @ covariance @ turn.T
        return rotated

    def _explained(self, pose: tuple[float, float, float], points: Floats) -> tuple[float, float]:
        """Return how well the map explains a scan, and how much of the scan contradicts the pose."""
        agreeing, against = self._field.agreement(pose, points, _EXPLAINED_WITHIN)
        return max(0.0, agreeing - against), against

    def _search_around(self, stamp_ns: int, pose: Pose, share: float, odometry: Pose, points: Floats) -> None:
        """Search for poses that explain the scan better, and move particles there."""
        settings = self.settings
        judge, quality = self._judge, self._judge.quality
        alarmed = quality < settings.poor or judge.refuted or judge.startled or judge.doubtful
        every = _LOST_SEARCH_EVERY if alarmed else _SEARCH_EVERY
        pause = every * min(_PATIENCE, 1 + self._fruitless // _PATIENCE)
        if max(share, quality) >= _SURE or (stamp_ns - self._searched_ns) / 1e9 < pause:
            return
        self._searched_ns = stamp_ns
        self.searches += 1
        lost = quality < settings.good or judge.refuted or judge.doubtful
        wanted = max(share + _BETTER * (1.0 if lost else 2.0), settings.good)
        windows = [SearchWindow(pose.x, pose.y, pose.theta, settings.recovery, _SEARCH_TURN)]
        lost = judge.was_localized and (judge.refuted or judge.doubtful)
        if lost or (quality < settings.poor and self._fruitless >= 2):
            windows.append(SearchWindow(pose.x, pose.y, pose.theta, _LOST_REACH, math.pi))
        for window in windows:
            poses, scores = self._search.best(points, window)
            shares = np.array([self._explained((row[0], row[1], row[2]), points)[0] for row in poses])
            better = shares >= wanted
            if better.any():
                self._fruitless = 0
                logs = scores[better] * min(1.0, _INDEPENDENT / len(points))
                self._scatter(poses[better], logs, odometry)
                return
        self._fruitless += 1

    def _scatter(self, poses: Floats, logs: Floats, odometry: Pose) -> None:
        """Move particles to other poses; the next scans decide."""
        count = round(_AFRESH * self.settings.particles)
        kept = particle_filter.drawn(self._weights, self.settings.particles - count, self._rng)
        assert self._updated is not None
        # the remaining ones still have to make the base's motion since they were weighed
        step = self._updated.inverse @ odometry
        particles = self._particles[kept]
        particle_filter.drive(
            particles, (step.x, step.y, step.theta), self._alphas, self._rng, holonomic=self.settings.holonomic
        )
        share = particle_filter.weighed(np.full(len(poses), 1.0 / len(poses)), logs)
        share = 0.5 * share + 0.5 / len(poses)
        which = particle_filter.drawn(share, count, self._rng)
        fresh = poses[which] + particle_filter.spread(np.zeros(3), _SCATTER, count, self._rng)
        self._particles = np.concatenate([particles, fresh])
        self._particles[:, 2] = particle_filter.wrapped(self._particles[:, 2])
        self._weights = np.full(len(self._particles), 1.0 / len(self._particles))
        self._updated, self._forced = odometry, _FORCED
        self._judge.doubt()
