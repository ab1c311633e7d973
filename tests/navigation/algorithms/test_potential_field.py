"""The way down the potential field."""

import math

import numpy as np
import pytest

from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.potential_field import descend
from tests.support.uncompiled import uncompiled

SIDE, RADIUS = 60, 4.0


def way(obstacles, start, goal, before=None, unseen=None):
    unseen = np.zeros(obstacles.shape, bool) if unseen is None else unseen
    given = distance_transform(obstacles), unseen, start, goal, before, RADIUS, 12.0, 1.0
    found, same = descend(*given), uncompiled("navigation.algorithms.potential_field").descend(*given)
    np.testing.assert_array_equal(found.cells, same.cells)
    assert (found.aim, found.blocked, found.cost, found.direct) == (same.aim, same.blocked, same.cost, same.direct)
    return found


def free():
    return np.zeros((SIDE, SIDE), bool)


def test_over_open_floor_it_is_a_straight_line():
    found = way(free(), (10, 10), (50.0, 40.0))
    assert found.direct
    assert found.cost == pytest.approx(50.0)
    assert way(free(), (10, 10), (10.0, 300.0)).direct, "out of the window, too"


def test_out_of_a_dead_end_without_a_minimum_on_the_way():
    walls = free()
    walls[20:41, 40] = walls[20, 20:41] = walls[40, 20:41] = True
    found = way(walls, (30, 30), (30.0, 55.0))
    assert not found.direct
    assert math.isinf(found.blocked)
    away = distance_transform(walls)[tuple(found.cells.T)]
    assert away.min() >= RADIUS - 0.5
    assert tuple(found.cells[-1]) == (30, 55)
    steps = np.abs(np.diff(found.cells, axis=0)).max(axis=1)
    assert (steps == 1).all()
    assert found.cells[:, 1].min() < 20, "it leads back out first"


def test_where_all_is_closed_it_says_how_far_it_is_to_what_blocks():
    walls = free()
    walls[:, 40] = True
    found = way(walls, (30, 20), (30.0, 55.0))
    assert 20 - RADIUS - 2 < found.blocked < 20


def test_a_robot_that_stands_too_near_is_free_to_leave():
    walls = free()
    walls[30, 33] = True
    found = way(walls, (30, 31), (30.0, 5.0))
    assert math.isinf(found.blocked)


def test_an_exit_is_kept_unless_another_is_better_by_far():
    walls = free()
    walls[25:36, 40] = True
    north, south = (59.0, 50.0), (0.0, 50.0)
    ends = [way(walls, (30, 30), (30.0, 200.0), before).cells[-1][0] for before in (north, south)]
    assert ends[0] > 30 > ends[1]


def test_places_that_nobody_saw_cost_more():
    walls, unseen = free(), free()
    walls[25:36, 40] = True
    unseen[:25] = True
    assert way(walls, (30, 30), (30.0, 55.0), unseen=unseen).cells[:, 0].max() > 36


@pytest.mark.parametrize("seed", range(20))
def test_ways_are_whole_and_end_at_the_goal_or_on_the_rim(seed):
    dice = np.random.default_rng(seed)
    walls, unseen = dice.random((SIDE, SIDE)) < 0.02, dice.random((SIDE, SIDE)) < 0.3
    start = tuple(int(at) for at in dice.integers(0, SIDE, 2))
    goal = tuple((dice.random(2) * 3 * SIDE - SIDE) // 0.5 * 0.5)
    before = tuple(dice.random(2) * SIDE) if seed % 2 else None
    found = way(walls, start, goal, before, unseen)
    if found.direct:
        return
    assert tuple(found.cells[0]) == start
    assert (np.abs(np.diff(found.cells, axis=0)).max(axis=1) == 1).all()
    end = tuple(found.cells[-1])
    assert end == tuple(round(at) for at in goal) or min(end) == 0 or max(end) == SIDE - 1


def test_a_goal_as_far_away_as_numbers_go():
    walls = free()
    walls[:, 40] = True
    assert way(free(), (30, 20), (30.0, 1e300)).direct
    assert way(walls, (30, 20), (-1e300, 20.0)).direct
    found = way(walls, (30, 20), (30.0, 1e300))
    assert not found.direct
    assert max(found.cells[-1]) == SIDE - 1 or min(found.cells[-1]) == 0, "the wall is dearer than any exit"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"start": (-1, 0)}, "start"),
        ({"start": (0, SIDE)}, "start"),
        ({"goal": (math.nan, 0.0)}, "goal"),
        ({"goal": (0.0, math.inf)}, "goal"),
        ({"radius": math.nan}, "radius"),
        ({"influence": math.inf}, "influence"),
        ({"unseen": np.zeros((SIDE, SIDE + 1), bool)}, "corner to corner"),
        ({"distances": np.zeros((1000, 1000), np.float32), "unseen": np.zeros((1000, 1000), bool)}, "corner to corner"),
    ],
)
def test_what_is_refused(change, reason):
    given = {
        "distances": np.full((SIDE, SIDE), 50.0, np.float32),
        "unseen": free(),
        "start": (3, 3),
        "goal": (30.0, 30.0),
        "before": None,
        "radius": RADIUS,
        "influence": 12.0,
        "spare": 1.0,
    }
    with pytest.raises(ValueError, match=reason):
        descend(**{**given, **change})
