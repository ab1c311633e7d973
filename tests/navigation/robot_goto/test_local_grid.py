"""The local grid: free, occupied and unknown cells."""

import math

import numpy as np
import pytest

from bridge.messages.scan import LaserScan
from navigation.algorithms.rolling_grid import OCCUPIED, UNKNOWN
from navigation.pose import Pose
from navigation.robot_goto.local_grid import RESOLUTION, SIDE, LocalGrid

BEAMS = 720
ORIGIN = Pose(0.0, 0.0, 0.0)


def turn(seconds, ranges, farthest=20.0):
    full = np.full(BEAMS, ranges, float) if np.isscalar(ranges) else np.asarray(ranges, float)
    return LaserScan(round(seconds * 1e9), -math.pi, math.tau / BEAMS, 0.1, farthest, full)


def state_at(grid, now, x, y):
    row, column = map(round, grid.cell(x, y))
    return grid.states(now)[row, column]


def grid(memory=10.0, aside=0.0):
    return LocalGrid(memory, 0.3, aside)


def test_cells_are_free_up_to_the_echo_and_unknown_beyond():
    local = grid()
    local.scan(turn(1.0, 1.5), ORIGIN)
    assert state_at(local, 1.0, 1.0, 0.0) == 0
    assert state_at(local, 1.0, -1.0, 0.5) == 0
    assert state_at(local, 1.0, 1.51, 0.01) == OCCUPIED
    assert state_at(local, 1.0, 2.0, 0.0) == UNKNOWN
    cells = local.occupancy(1.0)
    assert set(np.unique(cells)) == {-1, 0, 100}
    x, y = local.origin
    assert cells[round((1.51 - y) / RESOLUTION - 0.5), round((0.01 - x) / RESOLUTION - 0.5)] in (100, 0)


def test_nan_is_unknown_infinity_free_and_minus_infinity_too_close():
    ranges = np.full(BEAMS, math.inf)
    angles = np.degrees(-math.pi + np.arange(BEAMS) * math.tau / BEAMS)
    ranges[np.abs(angles) < 30.0] = math.nan
    ranges[np.abs(angles - 90.0) < 5.0] = -math.inf
    local = grid()
    local.scan(turn(1.0, ranges), ORIGIN)
    assert state_at(local, 1.0, 1.0, 0.0) == UNKNOWN
    assert state_at(local, 1.0, -1.0, 0.0) == 0
    assert state_at(local, 1.0, 0.0, 0.12) == OCCUPIED


@pytest.mark.parametrize("nothing", [math.inf, 1.5])
def test_a_beam_without_an_echo_frees_cells_up_to_the_laser_range(nothing):
    local = grid()
    local.scan(turn(1.0, nothing, farthest=1.5), ORIGIN)
    assert state_at(local, 1.0, 1.4, 0.0) == 0
    assert state_at(local, 1.0, 1.6, 0.0) == UNKNOWN
    assert not local.count


def test_observations_expire_after_the_memory_time():
    local = grid(memory=5.0)
    local.scan(turn(1.0, 1.5), ORIGIN)
    local.scan(turn(5.0, math.nan), ORIGIN)
    assert state_at(local, 5.0, 1.0, 0.0) == 0
    assert state_at(local, 5.0, 1.51, 0.01) == OCCUPIED
    assert state_at(local, 6.5, 1.0, 0.0) == UNKNOWN
    assert state_at(local, 6.5, 1.51, 0.01) == UNKNOWN, "an obstacle may have moved"


def test_cells_outside_the_window_are_dropped():
    local = grid(memory=1000.0)
    local.scan(turn(1.0, 1.5), ORIGIN)
    local.scan(turn(2.0, math.nan), Pose(1.0, -1.0, 0.0))
    assert state_at(local, 2.0, 1.0, 0.0) == 0, "the cell is still in the window"
    half = SIDE * RESOLUTION / 2
    local.scan(turn(3.0, math.nan), Pose(half + 1.6, 0.0, 0.0))
    local.scan(turn(4.0, math.nan), ORIGIN)
    assert state_at(local, 4.0, -1.0, 0.0) == UNKNOWN, "the cell left the window"


def test_new_obstacles_are_distinguished_from_old_ones():
    local = grid()
    for second in np.arange(0.0, 2.0, 0.1):
        local.scan(turn(second, 2.0), ORIGIN)
    assert not local.points[: local.count, 2].any()
    ranges = np.full(BEAMS, 2.0)
    ranges[350:370] = 1.0
    local.scan(turn(2.0, ranges), ORIGIN)
    new = local.points[: local.count][local.points[: local.count, 2] == 1.0]
    assert len(new) == 20
    assert np.hypot(new[:, 0], new[:, 1]) == pytest.approx(np.full(20, 1.0))
    for second in np.arange(2.1, 4.0, 0.1):
        local.scan(turn(second, ranges), ORIGIN)
    assert not local.points[: local.count, 2].any(), "the obstacle is no longer new"


def test_merged_lasers_do_not_free_cells_next_to_corners_and_blind_sectors():
    ranges = np.full(BEAMS, math.nan)
    ranges[360:420] = 2.0  # 0 to 30 degrees
    narrow, wide = grid(aside=0.0), grid(aside=0.08)
    for local in (narrow, wide):
        local.scan(turn(1.0, ranges), ORIGIN)
    assert state_at(narrow, 1.0, 0.8, 0.03) == 0
    assert state_at(wide, 1.0, 0.8, 0.03) == UNKNOWN
    assert state_at(wide, 1.0, 0.8, 0.2) == 0
