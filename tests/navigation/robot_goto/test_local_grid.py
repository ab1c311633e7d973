"""The local grid: what the laser saw, and did not see."""

import math

import numpy as np
import pytest

from bridge.messages.scan import Turn
from navigation.algorithms.rolling_grid import OCCUPIED, UNKNOWN
from navigation.pose import Pose
from navigation.robot_goto.local_grid import RESOLUTION, SIDE, LocalGrid

BEAMS = 720
ORIGIN = Pose(0.0, 0.0, 0.0)


def turn(seconds, ranges, farthest=20.0):
    full = np.full(BEAMS, ranges, float) if np.isscalar(ranges) else np.asarray(ranges, float)
    return Turn(round(seconds * 1e9), -math.pi, math.tau / BEAMS, 0.1, farthest, full)


def at(grid, now, x, y):
    row, column = (round(each) for each in grid.cell(x, y))
    return grid.states(now)[row, column]


def grid(memory=10.0, aside=0.0):
    return LocalGrid(memory, 0.3, aside)


def test_free_up_to_the_echo_occupied_there_and_unknown_behind():
    made = grid()
    made.scan(turn(1.0, 1.5), ORIGIN)
    assert at(made, 1.0, 1.0, 0.0) == 0
    assert at(made, 1.0, -1.0, 0.5) == 0
    assert at(made, 1.0, 1.51, 0.01) == OCCUPIED
    assert at(made, 1.0, 2.0, 0.0) == UNKNOWN
    cells = made.occupancy(1.0)
    assert set(np.unique(cells)) == {-1, 0, 100}
    x, y = made.origin
    assert cells[round((1.51 - y) / RESOLUTION - 0.5), round((0.01 - x) / RESOLUTION - 0.5)] in (100, 0)


def test_nan_says_nothing_infinity_is_free_and_minus_infinity_stands_right_before_it():
    ranges = np.full(BEAMS, math.inf)
    angles = np.degrees(-math.pi + np.arange(BEAMS) * math.tau / BEAMS)
    ranges[np.abs(angles) < 30.0] = math.nan
    ranges[np.abs(angles - 90.0) < 5.0] = -math.inf
    made = grid()
    made.scan(turn(1.0, ranges), ORIGIN)
    assert at(made, 1.0, 1.0, 0.0) == UNKNOWN
    assert at(made, 1.0, -1.0, 0.0) == 0
    assert at(made, 1.0, 0.0, 0.12) == OCCUPIED


@pytest.mark.parametrize("nothing", [math.inf, 1.5])
def test_where_nothing_is_hit_it_is_free_as_far_as_the_laser_sees(nothing):
    made = grid()
    made.scan(turn(1.0, nothing, farthest=1.5), ORIGIN)
    assert at(made, 1.0, 1.4, 0.0) == 0
    assert at(made, 1.0, 1.6, 0.0) == UNKNOWN
    assert not made.count


def test_what_was_seen_is_forgotten_in_time():
    made = grid(memory=5.0)
    made.scan(turn(1.0, 1.5), ORIGIN)
    made.scan(turn(5.0, math.nan), ORIGIN)
    assert at(made, 5.0, 1.0, 0.0) == 0
    assert at(made, 5.0, 1.51, 0.01) == OCCUPIED
    assert at(made, 6.5, 1.0, 0.0) == UNKNOWN
    assert at(made, 6.5, 1.51, 0.01) == UNKNOWN, "whoever stood there may have gone anywhere"


def test_it_goes_with_the_robot_and_comes_back_empty():
    made = grid(memory=1000.0)
    made.scan(turn(1.0, 1.5), ORIGIN)
    made.scan(turn(2.0, math.nan), Pose(1.0, -1.0, 0.0))
    assert at(made, 2.0, 1.0, 0.0) == 0, "it is in the window still"
    half = SIDE * RESOLUTION / 2
    made.scan(turn(3.0, math.nan), Pose(half + 1.6, 0.0, 0.0))
    made.scan(turn(4.0, math.nan), ORIGIN)
    assert at(made, 4.0, -1.0, 0.0) == UNKNOWN, "it was out of the window"


def test_what_came_is_told_from_what_was_there():
    made = grid()
    for second in np.arange(0.0, 2.0, 0.1):
        made.scan(turn(second, 2.0), ORIGIN)
    assert not made.points[: made.count, 2].any()
    ranges = np.full(BEAMS, 2.0)
    ranges[350:370] = 1.0
    made.scan(turn(2.0, ranges), ORIGIN)
    came = made.points[: made.count][made.points[: made.count, 2] == 1.0]
    assert len(came) == 20
    assert np.hypot(came[:, 0], came[:, 1]) == pytest.approx(np.full(20, 1.0))
    for second in np.arange(2.1, 4.0, 0.1):
        made.scan(turn(second, ranges), ORIGIN)
    assert not made.points[: made.count, 2].any(), "it stands there now"


def test_merged_lasers_clear_nothing_beside_corners_and_blind_sectors():
    ranges = np.full(BEAMS, math.nan)
    ranges[360:420] = 2.0  # 0 to 30 degrees
    narrow, wide = grid(aside=0.0), grid(aside=0.08)
    for made in (narrow, wide):
        made.scan(turn(1.0, ranges), ORIGIN)
    assert at(narrow, 1.0, 0.8, 0.03) == 0
    assert at(wide, 1.0, 0.8, 0.03) == UNKNOWN
    assert at(wide, 1.0, 0.8, 0.2) == 0
