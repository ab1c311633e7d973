"""The way down the potential field."""

import math

import numpy as np
import pytest

from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.potential_field import descend

SIDE, RADIUS = 60, 4.0


def way(obstacles, start, goal, before=None, unseen=None):
    unseen = np.zeros(obstacles.shape, bool) if unseen is None else unseen
    return descend(distance_transform(obstacles), unseen, start, goal, before, RADIUS, 12.0, 1.0)


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
