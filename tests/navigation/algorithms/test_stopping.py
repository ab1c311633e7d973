"""Whether a moving robot can still stop."""

import itertools
import math

import numpy as np
import pytest

from navigation.algorithms import stopping
from navigation.algorithms.rolling_grid import UNKNOWN
from tests.support.uncompiled import uncompiled

MODULES = (stopping, uncompiled("navigation.algorithms.stopping"))
RADIUS, SLOW, FAST, TOP, REACTION, BRAKING, TURNING = 0.3, 0.01, 0.05, 0.3, 0.25, 0.3, 1.4


def slowed(points, has, wanted, module=stopping, pose=(0.0, 0.0, 0.0), braking=BRAKING, top=TOP):
    blocker = np.zeros(3)
    array = np.array(points, float).reshape(-1, 3)
    with np.errstate(all="ignore"):
        share = module.slowed(
            array, len(array), *pose, np.array(has, float), np.array(wanted, float),
            REACTION, braking, TURNING, RADIUS, SLOW, FAST, top, blocker,
        )  # fmt: skip
    return share, blocker


def follow(has, wanted, seconds=0.005):
    """Return the robot's positions in small time steps until it stops."""
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


def test_a_free_path_allows_full_speed_and_a_wall_ahead_does_not():
    assert slowed([], (0.3, 0, 0), (0.3, 0, 0))[0] == 1.0
    assert slowed([(2.0, 0.0, 0.0)], (0.3, 0, 0), (0.3, 0, 0))[0] == 1.0
    share, blocker = slowed([(0.45, 0.0, 0.0)], (0.3, 0, 0), (0.3, 0, 0))
    assert share == 0.0
    assert tuple(blocker) == (0.45, 0.0, 0.0)
    assert slowed([(0.32, 0.0, 0.0)], (0, 0, 0), (-0.3, 0, 0))[0] == 1.0, "driving away from the wall is not slowed"
    assert slowed([(0.32, 0.0, 0.0)], (0, 0, 0), (0, 0, 0.5))[0] == 1.0, "a disc can turn in place"
    assert slowed([(0.302, 0.0, UNKNOWN)], (0, 0, 0), (0.3, 0, 0))[0] < 0.5, "an unseen cell slows the robot too"


def test_allowed_motions_stay_outside_the_radius():
    """For 150 velocities with 12 points each, a robot that starts from rest never touches a point."""
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


def test_ahead_measures_the_surroundings():
    points = np.array([(1.0, 0.0, 1.0), (1.0, 0.1, 0.0), (0.0, 0.5, 0.0), (-0.4, 0.0, 1.0)])
    surroundings = np.empty(6)
    stopping.ahead(points, 4, 0.0, 0.0, 0.0, 0.0, 1.2, math.inf, 0.3, 0.3, math.radians(25.0), surroundings)
    assert tuple(surroundings[:3]) == (2.0, 1.0, 1.0)
    assert tuple(surroundings[3:]) == (0.4, pytest.approx(math.pi, abs=1e-6), 0.4)
    stopping.ahead(points, 4, 0.0, 0.0, 0.0, math.pi / 2, 1.2, math.inf, 0.3, 0.3, math.radians(25.0), surroundings)
    assert surroundings[0] == 1.0, "the rectangle turns with the direction"


def test_ahead_counts_only_what_a_robot_touches_on_the_way_to_its_goal():
    points = np.array([(0.39, 0.28, 0.0), (0.39, -0.28, 0.0), (0.39, 0.0, 0.0), (0.1, 0.28, 0.0)])
    surroundings = np.empty(6)
    for module, (end, inside) in itertools.product(MODULES, {math.inf: 4, 0.3: 4, 0.12: 2, 0.05: 1}.items()):
        module.ahead(points, 4, 0.0, 0.0, 0.0, 0.0, 0.4, end, 0.3, 0.2, math.radians(25.0), surroundings)
        assert surroundings[0] == inside, (module.__name__, end)


def test_compiled_and_uncompiled_results_are_equal():
    rng = np.random.default_rng(7)
    shares = set()
    for count in (0, 1, 12, 40):
        for _ in range(15):
            pose = tuple(rng.uniform(-20.0, 20.0, 3).tolist())
            angles, away = rng.uniform(-math.pi, math.pi, count), rng.uniform(0.29, 0.9, count)
            points = np.stack(
                [pose[0] + away * np.cos(angles), pose[1] + away * np.sin(angles), rng.integers(0, 3, count)], axis=1
            )
            has, wanted = rng.uniform(-0.3, 0.3, 3), rng.uniform(-0.3, 0.3, 3)
            (share, blocker), (other, other_blocker) = (slowed(points, has, wanted, each, pose) for each in MODULES)
            assert share == other
            np.testing.assert_array_equal(blocker, other_blocker)
            shares.add(share)
            surroundings = np.empty((2, 6))
            for module, row in zip(MODULES, surroundings, strict=True):
                module.ahead(points, count, *pose, 0.5 * wanted[2], 0.8, 0.4, 0.3, 0.3, 0.4, row)
            np.testing.assert_array_equal(surroundings[0], surroundings[1])
    assert len(shares) > 3


@pytest.mark.parametrize("module", MODULES, ids=("compiled", "uncompiled"))
class TestNotFinite:
    @pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf, 1e300])
    @pytest.mark.parametrize("axis", range(3))
    def test_a_velocity_that_is_not_finite_or_too_large_permits_no_motion(self, module, odd, axis):
        velocity = [0.1, 0.0, 0.0]
        velocity[axis] = odd
        if axis < 2 or not math.isfinite(odd):  # a rotation is never slowed
            assert slowed([], velocity, (0.1, 0.0, 0.0), module)[0] == 0.0
            assert slowed([], (0.1, 0.0, 0.0), velocity, module)[0] == 0.0

    @pytest.mark.timeout(30)
    def test_a_speed_whose_square_is_infinite_permits_no_motion(self, module):
        """The base's deceleration is as extreme: without a check, the simulated path to a stop would not end."""
        has, still = (6e153, 0.0, 0.0), (0.0, 0.0, 0.0)
        assert slowed([], has, (-6e153, 0.0, 0.0), module, braking=1e153)[0] == 0.0
        assert slowed([], (1e200, 0.0, 0.0), still, module, braking=1e200)[0] == 0.0

    def test_a_pose_that_is_not_finite_permits_no_motion(self, module):
        for odd in (math.nan, math.inf):
            for pose in ((odd, 0.0, 0.0), (0.0, odd, 0.0), (0.0, 0.0, odd)):
                assert slowed([], (0.1, 0.0, 0.0), (0.1, 0.0, 0.0), module, pose)[0] == 0.0
                with pytest.raises(ValueError, match="finite"):
                    module.ahead(np.zeros((1, 3)), 1, *pose, 0.0, 1.2, math.inf, 0.3, 0.3, 0.4, np.empty(6))

    @pytest.mark.parametrize("place", [2, 3, 4, 5])
    def test_an_invalid_size_or_acceleration_permits_no_motion(self, module, place):
        wall, has = np.array([(0.45, 0.0, 0.0)]), np.array((0.3, 0.0, 0.0))
        for odd in (math.nan, math.inf):
            numbers = [REACTION, BRAKING, TURNING, RADIUS, SLOW, FAST, TOP]
            numbers[place] = odd
            with np.errstate(all="ignore"):
                assert module.slowed(wall, 1, 0.0, 0.0, 0.0, has, has, *numbers, np.zeros(3)) == 0.0

    def test_points_that_are_not_finite_are_ignored(self, module):
        points = [(math.nan, 0.0, 0.0), (0.2, math.nan, 0.0), (math.inf, 0.0, 1.0), (1e300, 1e300, 0.0)]
        assert slowed(points, (0.3, 0.0, 0.0), (0.3, 0.0, 0.0), module)[0] == 1.0
        assert slowed([*points, (0.45, 0.0, 0.0)], (0.3, 0.0, 0.0), (0.3, 0.0, 0.0), module)[0] == 0.0
        surroundings = np.empty(6)
        with np.errstate(all="ignore"):
            module.ahead(np.array(points), 2, 0.0, 0.0, 0.0, 0.0, 1.2, math.inf, 0.3, 0.3, 0.4, surroundings)
        assert tuple(surroundings) == (0.0, 0.0, math.inf, math.inf, 0.0, math.inf)

    def test_without_braking_no_motion_is_permitted_and_without_a_top_speed_any(self, module):
        assert slowed([], (0.1, 0.0, 0.0), (0.1, 0.0, 0.0), module, braking=0.0)[0] == 0.0
        assert slowed([], (0.1, 0.0, 0.0), (0.1, 0.0, 0.0), module, braking=1e-9)[0] == 0.0
        assert slowed([(2.0, 0.0, 0.0)], (0.1, 0.0, 0.0), (0.1, 0.0, 0.0), module, top=0.0)[0] == 1.0

    def test_arrays_of_wrong_shapes_are_rejected(self, module):
        three = np.zeros(3)
        for points, count in ((np.zeros((2, 3)), 3), (np.zeros((2, 3)), -1), (np.zeros((2, 2)), 2)):
            with pytest.raises(ValueError, match="points"):
                module.slowed(points, count, *three, three, three, *[0.3] * 7, three)
            with pytest.raises(ValueError, match="points"):
                module.ahead(points, count, *three, *[0.3] * 6, np.empty(6))
        with pytest.raises(ValueError, match="three numbers"):
            module.slowed(np.zeros((2, 3)), 2, *three, three, np.zeros(2), *[0.3] * 7, three)
        with pytest.raises(ValueError, match="six numbers"):
            module.ahead(np.zeros((2, 3)), 2, *three, *[0.3] * 6, np.empty(5))
