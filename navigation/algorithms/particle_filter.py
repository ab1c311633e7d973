"""A particle filter for a robot's pose: motion, weights, resampling and the mean.

The motion models are that of Thrun, Burgard, Fox, "Probabilistic Robotics", 2005, section 5.4, for differential bases,
and amcl's for holonomic ones (ROS 1, ``amcl_odom.cpp``). Resampling is low-variance sampling (section 4.3).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Alphas = tuple[float, float, float, float, float]
"""Noise of odometry: rotation by rotation, rotation by driving, driving by driving, driving by rotation, and sideways
by driving; variances per square."""

_STANDS = 0.01  # meters; a shorter motion has no meaningful direction
_REACH = 0.75  # meters in x and y from a pose, within which particles belong to its cluster
_TURN = math.radians(30.0)  # the same for the heading
_TRIES = 12  # randomly drawn particles whose clusters are compared


class Cluster(NamedTuple):
    """The cluster of particles with the largest weight."""

    mean: Floats  #: x, y, theta: meters, radians
    covariance: Floats  #: (3, 3) of all particles around the mean, including other clusters
    mass: float  #: its share of the weights


def spread(mean: Floats, covariance: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Draw particles (count, 3) around a pose."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    scaled = vectors * np.sqrt(np.maximum(values, 0.0))
    particles: Floats = mean + rng.standard_normal((count, 3)) @ scaled.T
    particles[:, 2] = wrapped(particles[:, 2])
    return particles


def drive(
    particles: Floats, step: tuple[float, float, float], alphas: Alphas, rng: np.random.Generator, *, holonomic: bool
) -> None:
    """Move all particles (n, 3), with the noise of odometry (``alphas``).

    ``step`` is the base's motion x, y, theta by odometry, in the base's previous frame: meters, radians. ``holonomic``:
    the base can move sideways.
    """
    dx, dy, turned = step
    distance = math.hypot(dx, dy)
    noise = rng.standard_normal((3, len(particles)))
    a1, a2, a3, a4, a5 = (math.sqrt(alpha) for alpha in alphas)
    if holonomic:
        heading = particles[:, 2] + turned / 2.0
        c, s = math.cos(turned / 2.0), math.sin(turned / 2.0)
        along = c * dx + s * dy + noise[0] * math.hypot(a3 * distance, a1 * turned)
        aside = -s * dx + c * dy + noise[1] * math.hypot(a1 * turned, a5 * distance)
        particles[:, 0] += along * np.cos(heading) - aside * np.sin(heading)
        particles[:, 1] += along * np.sin(heading) + aside * np.cos(heading)
        particles[:, 2] += turned + noise[2] * math.hypot(a4 * turned, a2 * distance)
    else:
        first = math.atan2(dy, dx) if distance > _STANDS else 0.0
        second = math.remainder(turned - first, math.tau)
        # driving backward is not a rotation by half a turn
        before, after = (min(abs(turn), abs(math.remainder(turn - math.pi, math.tau))) for turn in (first, second))
        heading = particles[:, 2] + first + noise[0] * math.hypot(a1 * before, a2 * distance)
        along = distance + noise[1] * math.hypot(a3 * distance, a4 * before, a4 * after)
        particles[:, 0] += along * np.cos(heading)
        particles[:, 1] += along * np.sin(heading)
        particles[:, 2] = heading + second + noise[2] * math.hypot(a1 * after, a2 * distance)
    particles[:, 2] = wrapped(particles[:, 2])


def updated_weights(weights: Floats, logs: Floats) -> Floats:
    """Return the weights after a measurement with these log likelihoods; their sum is 1."""
    posterior: Floats = weights * np.exp(logs - logs.max())
    posterior /= posterior.sum()
    return posterior


def effective_count(weights: Floats) -> float:
    """Return the effective number of particles."""
    return float(1.0 / np.square(weights).sum())


def resample(weights: Floats, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Resample: return the indices of particles, each about in proportion to its weight."""
    sums = np.cumsum(weights)
    places = (rng.random() + np.arange(count)) / count * sums[-1]
    indices: NDArray[np.intp] = np.minimum(np.searchsorted(sums, places), len(weights) - 1)
    return indices


def heaviest(particles: Floats, weights: Floats, rng: np.random.Generator) -> Cluster:
    """Return the heaviest cluster; the mean of all particles could be between two clusters."""
    seeds = particles[resample(weights, _TRIES, rng)]
    best = max((_around(particles, weights, seed) for seed in seeds), key=lambda near: float(weights[near].sum()))
    mean = seeds[0]
    for _ in range(2):
        mean = _mean(particles[best], weights[best])
        best = _around(particles, weights, mean)
    off = particles - mean
    off[:, 2] = wrapped(off[:, 2])
    return Cluster(mean, (off * weights[:, None]).T @ off, float(weights[best].sum()))


def wrapped(angles: Floats) -> Floats:
    """Return the same directions within -pi to pi."""
    result: Floats = (angles + math.pi) % math.tau - math.pi
    return result


def _around(particles: Floats, weights: Floats, seed: Floats) -> NDArray[np.bool_]:
    """Return which particles are near a pose; if none with a weight is, the heaviest particle."""
    off = particles - seed
    near: NDArray[np.bool_] = (
        (np.abs(off[:, 0]) < _REACH) & (np.abs(off[:, 1]) < _REACH) & (np.abs(wrapped(off[:, 2])) < _TURN)
    )
    if not weights[near].any():
        near[weights.argmax()] = True
    return near


def _mean(particles: Floats, weights: Floats) -> Floats:
    share = weights / weights.sum()
    x, y = share @ particles[:, :2]
    theta = math.atan2(share @ np.sin(particles[:, 2]), share @ np.cos(particles[:, 2]))
    return np.array([x, y, theta])
