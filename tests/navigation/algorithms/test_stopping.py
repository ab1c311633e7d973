"""Whether a robot can still stop."""

import math

import numpy as np
import pytest

from navigation.algorithms.rolling_grid import UNKNOWN
from navigation.algorithms.stopping import kernels

RADIUS, SLOW, FAST, TOP, REACTION, BRAKING, TURNING = 0.3, 0.01, 0.05, 0.3, 0.25, 0.3, 1.4


def slowed(points, has, wanted):
    blocker = np.zeros(3)
    array = np.array(points, float).reshape(-1, 3)
    share = kernels()[0](
        array, len(array), 0.0, 0.0, 0.0, np.array(has, float), np.array(wanted, float),
        REACTION, BRAKING, TURNING, RADIUS, SLOW, FAST, TOP, blocker,
    )  # fmt: skip
    return share, blocker


def follow(has, wanted, seconds=0.005):
    """Where the robot goes until it stands, in small steps."""
    (vx, vy, turn), (x, y, theta), places = has, (0.0, 0.0, 0.0), []
    for step in range(2000):
        to = wanted if step * seconds < REACTION else (0.0, 0.0, 0.0)
        change = math.hypot(to[0] - vx, to[1] - vy)
        share = min(1.0, BRAKING * seconds / change) if change else 1.0
        vx, vy = vx + (to[0] - vx) * share, vy + (to[1] - vy) * share
        turn += min(TURNING * seconds, max(-TURNING * seconds, to[2] - turn))
        theta += turn * seconds
        c, s = math.cos(theta), math.sin(theta)
        x, y = x + (c * vx - s * vy) * seconds, y + (s * vx + c * vy) * seconds
        places.append((x, y))
    return np.array(places)


def test_nothing_near_lets_it_go_and_a_wall_before_it_does_not():
    assert slowed([], (0.3, 0, 0), (0.3, 0, 0))[0] == 1.0
    assert slowed([(2.0, 0.0, 0.0)], (0.3, 0, 0), (0.3, 0, 0))[0] == 1.0
    share, blocker = slowed([(0.45, 0.0, 0.0)], (0.3, 0, 0), (0.3, 0, 0))
    assert share == 0.0
    assert tuple(blocker) == (0.45, 0.0, 0.0)
    assert slowed([(0.32, 0.0, 0.0)], (0, 0, 0), (-0.3, 0, 0))[0] == 1.0, "away from it"
    assert slowed([(0.32, 0.0, 0.0)], (0, 0, 0), (0, 0, 0.5))[0] == 1.0, "a disc turns on the spot"
    assert slowed([(0.302, 0.0, UNKNOWN)], (0, 0, 0), (0.3, 0, 0))[0] < 0.5, "nor into what nobody saw"


def test_what_is_allowed_comes_no_nearer_than_the_radius():
    """Thousands of velocities and points: whoever starts from rest never comes to touch, and never creeps."""
    rng = np.random.default_rng(5)
    braked = 0
    for _ in range(150):
        wanted = (rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3) * rng.integers(2), rng.uniform(-0.5, 0.5))
        angles, away = rng.uniform(-math.pi, math.pi, 12), rng.uniform(0.29, 0.9, 12)
        points = np.stack([away * np.cos(angles), away * np.sin(angles), np.zeros(12)], axis=1)
        share, _ = slowed(points, (0.0, 0.0, 0.0), wanted)
        braked += share < 1.0
        way = follow((0.0, 0.0, 0.0), (wanted[0] * share, wanted[1] * share, wanted[2]))
        nearest = np.hypot(*(way[:, None, :] - points[None, :, :2]).transpose(2, 0, 1)).min(axis=0)
        assert (nearest >= np.minimum(away, RADIUS) - 1e-3).all()
    assert braked > 30


def test_what_is_ahead():
    points = np.array([(1.0, 0.0, 1.0), (1.0, 0.1, 0.0), (0.0, 0.5, 0.0), (-0.4, 0.0, 1.0)])
    found = np.empty(6)
    kernels()[1](points, 4, 0.0, 0.0, 0.0, 0.0, 1.2, 0.3, 0.3, math.radians(25.0), found)
    assert tuple(found[:3]) == (2.0, 1.0, 1.0)
    assert tuple(found[3:]) == (0.4, pytest.approx(math.pi, abs=1e-6), 0.4)
    kernels()[1](points, 4, 0.0, 0.0, 0.0, math.pi / 2, 1.2, 0.3, 0.3, math.radians(25.0), found)
    assert found[0] == 1.0, "the rectangle turns with the way"
