"""The path down the potential field."""

import math

import numpy as np
import pytest

from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.potential_field import descend
from tests.support.uncompiled import uncompiled

SIDE, RADIUS = 60, 4.0


def way(obstacles, start, goal, before=None, unseen=None, *, leave=False):
    unseen = np.zeros(obstacles.shape, bool) if unseen is None else unseen
    given = distance_transform(obstacles), unseen, start, goal, before, RADIUS, 12.0, 1.0
    plain = uncompiled("navigation.algorithms.potential_field")
    descent, same = descend(*given, leave=leave), plain.descend(*given, leave=leave)
    np.testing.assert_array_equal(descent.cells, same.cells)
    assert (descent.aim, descent.blocked, descent.cost, descent.direct) == (
        same.aim,
        same.blocked,
        same.cost,
        same.direct,
    )
    return descent


def free():
    return np.zeros((SIDE, SIDE), bool)


def test_on_open_floor_the_path_is_a_straight_line():
    descent = way(free(), (10, 10), (50.0, 40.0))
    assert descent.direct
    assert descent.cost == pytest.approx(50.0)
    assert way(free(), (10, 10), (10.0, 300.0)).direct, "the path to a goal outside the window is direct too"


def test_the_path_leaves_a_dead_end_without_a_local_minimum():
    walls = free()
    walls[20:41, 40] = walls[20, 20:41] = walls[40, 20:41] = True
    descent = way(walls, (30, 30), (30.0, 55.0))
    assert not descent.direct
    assert math.isinf(descent.blocked)
    away = distance_transform(walls)[tuple(descent.cells.T)]
    assert away.min() >= RADIUS - 0.5
    assert tuple(descent.cells[-1]) == (30, 55)
    steps = np.abs(np.diff(descent.cells, axis=0)).max(axis=1)
    assert (steps == 1).all()
    assert descent.cells[:, 1].min() < 20, "the path leads back out first"


def test_with_leave_the_aim_is_the_first_cell_with_room_of_a_path_that_begins_without():
    walls = free()
    walls[33:37, 26:30] = True  # the robot's radius and a half from the start; the line past it keeps only the radius
    far, near = (way(walls, (29, 24), (29.0, 50.0), leave=leave) for leave in (False, True))
    assert tuple(far.cells[far.aim]) == (29, 50)
    away = distance_transform(walls)[tuple(near.cells.T)]
    assert away[near.aim] >= RADIUS + 1.0
    assert (away[4 : near.aim] < RADIUS + 1.0).all()
    assert way(walls, (20, 24), (29.0, 50.0), leave=True).aim == way(walls, (20, 24), (29.0, 50.0)).aim


def test_a_closed_path_gives_the_distance_to_the_obstacle():
    walls = free()
    walls[:, 40] = True
    descent = way(walls, (30, 20), (30.0, 55.0))
    assert 20 - RADIUS - 2 < descent.blocked < 20


def test_a_robot_too_close_to_an_obstacle_may_leave():
    walls = free()
    walls[30, 33] = True
    descent = way(walls, (30, 31), (30.0, 5.0))
    assert math.isinf(descent.blocked)


def test_the_exit_stays_unless_another_is_much_better():
    walls = free()
    walls[25:36, 40] = True
    north, south = (59.0, 50.0), (0.0, 50.0)
    ends = [way(walls, (30, 30), (30.0, 200.0), before).cells[-1][0] for before in (north, south)]
    assert ends[0] > 30 > ends[1]


def test_unseen_cells_cost_more():
    walls, unseen = free(), free()
    walls[25:36, 40] = True
    unseen[:25] = True
    assert way(walls, (30, 30), (30.0, 55.0), unseen=unseen).cells[:, 0].max() > 36


@pytest.mark.parametrize("seed", range(20))
def test_paths_are_connected_and_end_at_the_goal_or_the_border(seed):
    dice = np.random.default_rng(seed)
    walls, unseen = dice.random((SIDE, SIDE)) < 0.02, dice.random((SIDE, SIDE)) < 0.3
    start = tuple(int(at) for at in dice.integers(0, SIDE, 2))
    goal = tuple((dice.random(2) * 3 * SIDE - SIDE) // 0.5 * 0.5)
    before = tuple(dice.random(2) * SIDE) if seed % 2 else None
    descent = way(walls, start, goal, before, unseen)
    if descent.direct:
        return
    assert tuple(descent.cells[0]) == start
    assert (np.abs(np.diff(descent.cells, axis=0)).max(axis=1) == 1).all()
    end = tuple(descent.cells[-1])
    assert end == tuple(round(at) for at in goal) or min(end) == 0 or max(end) == SIDE - 1


def test_a_goal_at_the_largest_distance_is_approached():
    walls = free()
    walls[:, 40] = True
    assert way(free(), (30, 20), (30.0, 1e300)).direct
    assert way(walls, (30, 20), (-1e300, 20.0)).direct
    descent = way(walls, (30, 20), (30.0, 1e300))
    assert not descent.direct
    assert max(descent.cells[-1]) == SIDE - 1 or min(descent.cells[-1]) == 0, "the wall is more expensive than any exit"


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"start": (-1, 0)}, "start"),
        ({"start": (0, SIDE)}, "start"),
        ({"goal": (math.nan, 0.0)}, "goal"),
        ({"goal": (0.0, math.inf)}, "goal"),
        ({"radius": math.nan}, "radius"),
        ({"influence": math.inf}, "influence"),
        ({"unseen": np.zeros((SIDE, SIDE + 1), bool)}, "a diagonal of at most"),
        (
            {"distances": np.zeros((1000, 1000), np.float32), "unseen": np.zeros((1000, 1000), bool)},
            "a diagonal of at most",
        ),
    ],
)
def test_invalid_input_is_rejected(change, reason):
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
