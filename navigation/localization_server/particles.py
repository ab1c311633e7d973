"""The particles of the localizer: poses in the field's frame, with their weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms import particle_filter
from navigation.algorithms.likelihood_field import Field, LikelihoodField
from navigation.localization_server.section import LocalizerSection

Floats = NDArray[np.float64]
Step = tuple[float, float, float]
"""The base's motion by odometry, in its previous frame: meters, radians."""

_INDEPENDENT = 30.0  # a scan counts as this many independent measurements: neighboring beams err together
_AFRESH = 0.5  # share of the particles that a search moves to other poses
_SCATTER = np.diag([0.1**2, 0.1**2, np.radians(3.0) ** 2])
_JITTER = np.diag([0.02**2, 0.02**2, np.radians(1.0) ** 2])


class ParticleSet:
    """The particles; none before `begin`.

    Args:
        table: the log likelihoods of the field.
        seed: the seed of the random numbers.

    Attributes:
        poses: (n, 3) x, y, theta: meters, radians.
    """

    def __init__(self, field: LikelihoodField, table: Field, settings: LocalizerSection, seed: int) -> None:
        self._field, self._table, self._settings = field, table, settings
        self._worst = float(table.min())
        self._rng = np.random.default_rng(seed)
        alpha1, alpha2, alpha3, alpha4, alpha5 = settings.odom_alpha
        self._alphas = alpha1, alpha2, alpha3, alpha4, alpha5
        self.poses = np.empty((0, 3))
        self._weights = np.empty(0)

    def __len__(self) -> int:
        return len(self.poses)

    def begin(self, start: Floats, covariance: Floats) -> None:
        """Spread all particles around a pose."""
        self.poses = particle_filter.spread(start, covariance, self._settings.particles, self._rng)
        self._level()

    def update(self, step: Step, points: Floats, *, jitter: bool) -> particle_filter.Cluster:
        """Move and weight the particles, and resample them if few have most of the weight; return the heaviest cluster.

        ``jitter`` moves them a little more, because duplicates would stay equal forever while the base stands.
        """
        self._drive(self.poses, step)
        if jitter:
            self.poses += particle_filter.spread(np.zeros(3), _JITTER, len(self.poses), self._rng)
        logs = self._field.score(self._table, self._worst, self.poses, points)
        logs *= min(1.0, _INDEPENDENT / len(points))
        self._weights = particle_filter.updated_weights(self._weights, logs)
        mode = particle_filter.heaviest(self.poses, self._weights, self._rng)
        if particle_filter.effective_count(self._weights) < len(self._weights) / 2:
            self.poses = self.poses[particle_filter.resample(self._weights, self._settings.particles, self._rng)]
            self._level()
        return mode

    def scatter(self, poses: Floats, scores: Floats, points: int, step: Step) -> None:
        """Move some particles to poses with these scores, from a number of points; the rest make the base's motion."""
        count = round(_AFRESH * self._settings.particles)
        kept = particle_filter.resample(self._weights, self._settings.particles - count, self._rng)
        particles = self.poses[kept]
        self._drive(particles, step)
        logs = scores * min(1.0, _INDEPENDENT / points)
        share = particle_filter.updated_weights(np.full(len(poses), 1.0 / len(poses)), logs)
        share = 0.5 * share + 0.5 / len(poses)
        which = particle_filter.resample(share, count, self._rng)
        fresh = poses[which] + particle_filter.spread(np.zeros(3), _SCATTER, count, self._rng)
        self.poses = np.concatenate([particles, fresh])
        self.poses[:, 2] = particle_filter.wrapped(self.poses[:, 2])
        self._level()

    def _drive(self, particles: Floats, step: Step) -> None:
        particle_filter.drive(particles, step, self._alphas, self._rng, holonomic=self._settings.holonomic)

    def _level(self) -> None:
        """Give all particles the same weight."""
        self._weights = np.full(len(self.poses), 1.0 / len(self.poses))
