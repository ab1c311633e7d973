"""Many guesses of where a robot is: how they move, how they are drawn again by their weights, what they say together.

The motion models are those of Thrun, Burgard, Fox, "Probabilistic Robotics", 2005, section 5.4, for wheels that cannot
go sideways, and amcl's for wheels that can (ROS 1, ``amcl_odom.cpp``); resampling is its section 4.3's, in one sweep.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Alphas = tuple[float, float, float, float, float]
"""How far odometry may be off: turning by turning, turning by driving, driving by driving, driving by turning, and
sideways by driving; variances per square."""

_STANDS = 0.01  # metres below which the direction of a drive says nothing
_REACH = 0.75
_TURN = math.radians(30.0)
_TRIES = 12


class Cluster(NamedTuple):
    """The heaviest heap of particles."""

    mean: Floats  #: x, y, theta: metres, radians
    covariance: Floats  #: (3, 3) of all particles about the mean, those of other heaps too
    mass: float  #: its share of all weights


def spread(mean: Floats, covariance: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Particles (count, 3) about a pose."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    scaled = vectors * np.sqrt(np.maximum(values, 0.0))
    found: Floats = mean + rng.standard_normal((count, 3)) @ scaled.T
    found[:, 2] = wrapped(found[:, 2])
    return found


def drive(
    particles: Floats, step: tuple[float, float, float], alphas: Alphas, rng: np.random.Generator, *, holonomic: bool
) -> None:
    """Move all particles (n, 3), each a little otherwise, as far as odometry may be off (``alphas``).

    The step is x, y, theta that odometry says the base went, in the frame that it had before: metres, radians.
    ``holonomic``: it can go sideways.
    """
    dx, dy, turned = step
    way = math.hypot(dx, dy)
    noise = rng.standard_normal((3, len(particles)))
    a1, a2, a3, a4, a5 = (math.sqrt(alpha) for alpha in alphas)
    if holonomic:
        heading = particles[:, 2] + turned / 2.0
        c, s = math.cos(turned / 2.0), math.sin(turned / 2.0)
        along = c * dx + s * dy + noise[0] * math.hypot(a3 * way, a1 * turned)
        aside = -s * dx + c * dy + noise[1] * math.hypot(a1 * turned, a5 * way)
        particles[:, 0] += along * np.cos(heading) - aside * np.sin(heading)
        particles[:, 1] += along * np.sin(heading) + aside * np.cos(heading)
        particles[:, 2] += turned + noise[2] * math.hypot(a4 * turned, a2 * way)
    else:
        first = math.atan2(dy, dx) if way > _STANDS else 0.0
        second = math.remainder(turned - first, math.tau)
        # a drive backwards is no turn by half a circle
        one, two = (min(abs(turn), abs(math.remainder(turn - math.pi, math.tau))) for turn in (first, second))
        heading = particles[:, 2] + first + noise[0] * math.hypot(a1 * one, a2 * way)
        along = way + noise[1] * math.hypot(a3 * way, a4 * one, a4 * two)
        particles[:, 0] += along * np.cos(heading)
        particles[:, 1] += along * np.sin(heading)
        particles[:, 2] = heading + second + noise[2] * math.hypot(a1 * two, a2 * way)
    particles[:, 2] = wrapped(particles[:, 2])


def weighed(weights: Floats, logs: Floats) -> Floats:
    """Weights after a measurement with these logarithms of likelihoods; their sum is 1."""
    found: Floats = weights * np.exp(logs - logs.max())
    found /= found.sum()
    return found


def effective(weights: Floats) -> float:
    """How many particles of equal weight would say as much."""
    return float(1.0 / np.square(weights).sum())


def drawn(weights: Floats, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Which particles come next, each about as often as it weighs."""
    sums = np.cumsum(weights)
    places = (rng.random() + np.arange(count)) / count * sums[-1]
    found: NDArray[np.intp] = np.minimum(np.searchsorted(sums, places), len(weights) - 1)
    return found


def heaviest(particles: Floats, weights: Floats, rng: np.random.Generator) -> Cluster:
    """The heaviest heap: a mean over all would lie between two heaps, where nothing is."""
    seeds = particles[drawn(weights, _TRIES, rng)]
    best = max((_around(particles, weights, seed) for seed in seeds), key=lambda near: float(weights[near].sum()))
    mean = seeds[0]
    for _ in range(2):
        mean = _mean(particles[best], weights[best])
        best = _around(particles, weights, mean)
    off = particles - mean
    off[:, 2] = wrapped(off[:, 2])
    return Cluster(mean, (off * weights[:, None]).T @ off, float(weights[best].sum()))


def wrapped(angles: Floats) -> Floats:
    """The same directions within -pi to pi."""
    found: Floats = (angles + math.pi) % math.tau - math.pi
    return found


def _around(particles: Floats, weights: Floats, seed: Floats) -> NDArray[np.bool_]:
    """Which particles are near one; at least the heaviest."""
    off = particles - seed
    found: NDArray[np.bool_] = (
        (np.abs(off[:, 0]) < _REACH) & (np.abs(off[:, 1]) < _REACH) & (np.abs(wrapped(off[:, 2])) < _TURN)
    )
    if not weights[found].any():
        found[weights.argmax()] = True
    return found


def _mean(particles: Floats, weights: Floats) -> Floats:
    share = weights / weights.sum()
    x, y = share @ particles[:, :2]
    theta = math.atan2(share @ np.sin(particles[:, 2]), share @ np.cos(particles[:, 2]))
    return np.array([x, y, theta])
