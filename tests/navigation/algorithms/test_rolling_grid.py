"""The kernels of the rolling grid, compiled and uncompiled; robot_goto's tests check their results."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from navigation.algorithms import rolling_grid
from navigation.algorithms.rolling_grid import NEVER, OCCUPIED, UNKNOWN
from tests.support.uncompiled import uncompiled

MODULES = (rolling_grid, uncompiled("navigation.algorithms.rolling_grid"))
SIDE, CELL = 40, 0.05


@pytest.fixture(params=MODULES, ids=("compiled", "uncompiled"))
def window(request: pytest.FixtureRequest) -> Window:
    return Window(request.param)


class Window:
    """A window of 2 m with its corner at cell (row0, column0)."""

    def __init__(self, module: ModuleType, row0: int = -20, column0: int = -20) -> None:
        self.kernels = module
        self.grid = module.RollingGrid(SIDE, CELL, 5.0)
        self.grid.move(row0, column0)
        self.passed, self.ended, self.since = self.grid.times

    def mark(self, ranges: np.ndarray, now: float = 10.0, **other: Any) -> np.ndarray:
        """Enter a scan into the grid; return the scan's points."""
        arguments = {"x": 0.01, "y": 0.01, "theta": 0.0, "first": -math.pi, "step": math.tau / max(len(ranges), 1)}
        arguments |= {"nearest": 0.1, "farthest": 20.0, "aside": 0.08} | other
        points = np.full((len(ranges), 3), np.nan)
        with np.errstate(all="ignore"):
            count = self.grid.mark(now, *arguments.values(), ranges, points)
        return points[:count]

    def near(self, x: float, y: float, reach: float = 0.5) -> np.ndarray:
        out = np.empty((SIDE * SIDE, 3))
        with np.errstate(all="ignore"):
            count = self.grid.near(10.1, x, y, reach, 10.0, out)
        return out[:count]

    def stand(self, x: float, y: float, radius: float = 0.2, now: float = 10.0) -> None:
        with np.errstate(all="ignore"):
            self.grid.stand(now, x, y, radius)

    def states(self) -> np.ndarray:
        out = np.empty((SIDE, SIDE), np.uint8)
        self.grid.states(10.0, out)
        return out


@pytest.mark.parametrize("corner", [(0, 0), (-57, 1234), (-1_000_000_007, -40)])
def test_compiled_and_uncompiled_grids_are_equal(corner: tuple[int, int]) -> None:
    rng = np.random.default_rng(sum(corner) % 100)
    windows = [Window(module, *corner) for module in MODULES]
    x, y = ((at + SIDE / 2) * CELL for at in reversed(corner))
    for turn in range(6):
        now = 10.0 + 0.4 * turn
        count = 180 + turn
        ranges = np.abs(rng.normal(0.8, 0.4, count))
        for odd in (math.nan, math.inf, -math.inf, 0.0, 1e300):
            ranges[rng.integers(0, count, 4)] = odd
        ranges[10 * turn : 10 * turn + 20] = math.nan
        pose = {"x": x + rng.uniform(-0.3, 0.3), "y": y + rng.uniform(-0.3, 0.3), "theta": rng.uniform(-9.0, 9.0)}
        pose["first"], pose["step"] = rng.uniform(-4.0, 4.0), rng.choice([1.0, -1.0]) * math.tau / count
        if turn % 2:
            pose["step"] /= 2.0
        found = []
        for each in windows:
            each.stand(pose["x"], pose["y"], now=now)
            points = each.mark(ranges, now, **pose)
            found.append((points, each.near(pose["x"], pose["y"]), each.states(), each.passed, each.ended, each.since))
        for one, other in zip(*found, strict=True):
            np.testing.assert_array_equal(one, other)
        assert len(found[0][0]) > 50
    assert set(np.unique(windows[0].states())) == {0, OCCUPIED, UNKNOWN}


@pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf])
def test_a_pose_that_is_not_finite_is_rejected(window: Window, odd: float) -> None:
    for name in ("x", "y", "theta", "first", "step"):
        with pytest.raises(ValueError, match="finite"):
            window.mark(np.ones(36), **{name: odd})
    for place in ((odd, 0.0), (0.0, odd)):
        with pytest.raises(ValueError, match="finite"):
            window.near(*place)
        with pytest.raises(ValueError, match="finite"):
            window.stand(*place)
    assert (window.states() == UNKNOWN).all()


def test_invalid_beams_leave_no_points(window: Window) -> None:
    assert not len(window.mark(np.empty(0)))
    assert not len(window.mark(np.array([math.nan, math.inf, 1e300, 1e18, 0.0, -1.0])))
    assert (window.ended == NEVER).all()
    assert len(window.mark(np.array([math.nan, -math.inf, 1e300]), nearest=0.3)) == 1
    with pytest.raises(ValueError, match="its step not 0"):
        window.mark(np.ones(36), step=0.0)
    assert len(window.mark(np.full(5, 0.5), step=1e-300, nearest=0.0)) == 5
    assert len(window.mark(np.array([0.0, -math.inf]), nearest=0.0)) == 2


def test_distant_positions_are_rejected(window: Window) -> None:
    for x, y in ((1e300, 0.0), (0.0, -1e300), (1e18, 1e18)):
        assert not len(window.mark(np.full(36, 0.5), x=x, y=y))
        assert not len(window.near(x, y))
        window.stand(x, y)
    assert (window.states() == UNKNOWN).all()
    assert len(window.near(0.0, 0.0, 1e300)) == len(window.near(0.0, 0.0, math.inf)) == SIDE * SIDE
    for corner in ((1 << 60, 0), (0, -(1 << 60))):
        with pytest.raises(ValueError, match="invalid window"):
            window.grid.move(*corner)


@pytest.mark.parametrize("radius", [1e300, math.inf])
def test_a_robot_larger_than_the_window_frees_all_of_it(window: Window, radius: float) -> None:
    window.stand(0.3, -0.4, radius)
    assert (window.states() == 0).all()


def test_cells_that_enter_the_window_are_unknown(window: Window) -> None:
    window.mark(np.full(36, 0.5))
    seen = window.ended > NEVER
    window.grid.move(-20 + 3, -20)
    assert not (window.ended[np.arange(-20, -17) % SIDE] > NEVER).any()
    assert (window.ended > NEVER).sum() == np.delete(seen, np.arange(-20, -17) % SIDE, axis=0).sum() > 0
    window.grid.move(500, -20)
    assert (window.passed == NEVER).all()
    assert window.grid.corner == (500, -20)


def test_arrays_of_wrong_size_are_rejected(window: Window) -> None:
    grid, pose = window.grid, (0.0, 0.0, 0.0, 0.0, 0.1, 0.1, 9.0, 0.0)
    for points in (np.zeros((8, 3)), np.zeros((9, 2))):
        with pytest.raises(ValueError, match="numbers for each beam"):
            grid.mark(1.0, *pose, np.ones(9), points)
    with pytest.raises(ValueError, match=r"\(n, 3\)"):
        grid.near(1.0, 0.0, 0.0, 1.0, 1.0, np.zeros((9, 2)))
    with pytest.raises(ValueError, match="the window's shape"):
        grid.states(1.0, np.zeros((8, 9), np.uint8))
    for side, resolution in ((0, 0.05), (8, 0.0), (8, math.nan)):
        with pytest.raises(ValueError, match="invalid window"):
            window.kernels.RollingGrid(side, resolution, 5.0)
