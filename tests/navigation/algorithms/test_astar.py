"""Paths on grids, compared with those of a plain Dijkstra's algorithm."""

from __future__ import annotations

import heapq
import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from navigation.algorithms import shortcut as compiled_lines
from navigation.algorithms.astar import DIAGONAL, STRAIGHT, astar
from navigation.algorithms.shortcut import sees, shortcut
from tests.support.uncompiled import uncompiled

Grid = NDArray[np.uint8]
python = uncompiled("navigation.algorithms.astar")
python_lines = uncompiled("navigation.algorithms.shortcut")


def dijkstra(weights: Grid, start: tuple[int, int], goal: tuple[int, int]) -> float:
    """Return the lowest cost in `astar`'s unit, a straight step onto a cell of weight 1; infinity without a path."""
    rows, columns = weights.shape

    def free(row: int, column: int) -> bool:
        return 0 <= row < rows and 0 <= column < columns and bool(weights[row, column])

    costs = {start: 0.0}
    waiting = [(0.0, start)]
    while waiting:
        cost, (row, column) = heapq.heappop(waiting)
        if (row, column) == goal:
            return cost / STRAIGHT
        if cost > costs[row, column]:
            continue
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                there = row + down, column + right
                beside = free(row + down, column) and free(row, column + right)
                if not (down or right) or not free(*there) or (down and right and not beside):
                    continue
                lower = cost + int(weights[there]) * (DIAGONAL if down and right else STRAIGHT)
                if lower < costs.get(there, math.inf):
                    costs[there] = lower
                    heapq.heappush(waiting, (lower, there))
    return math.inf


@st.composite
def grids(draw: st.DrawFn) -> Grid:
    rows, columns = draw(st.integers(1, 25)), draw(st.integers(1, 25))
    chance = draw(st.floats(0.0, 0.5))
    heaviest = draw(st.sampled_from((1, 1, 3, 255)))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    weights = random.integers(1, heaviest + 1, (rows, columns))
    return np.where(random.random((rows, columns)) < chance, 0, weights).astype(np.uint8)


@settings(max_examples=300)
@given(weights=grids(), data=st.data())
def test_paths_are_the_cheapest_and_cut_no_corners(weights: Grid, data: st.DataObject) -> None:
    rows, columns = weights.shape
    start, goal = (
        (data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, columns - 1))) for _ in ("start", "goal")
    )
    grid_path = astar(weights, start, goal)
    least = dijkstra(weights, start, goal) if weights[goal] else math.inf
    same = python.astar(weights, start, goal)
    assert sees(weights, start, goal) == python_lines.sees(weights, start, goal)
    if grid_path is None:
        assert least == math.inf
        assert same is None
        return
    assert grid_path.cost == same.cost
    np.testing.assert_array_equal(grid_path.cells, same.cells)
    assert grid_path.cost == pytest.approx(least)
    assert tuple(grid_path.cells[0]) == start
    assert tuple(grid_path.cells[-1]) == goal
    paid = 0
    for (row, column), (to_row, to_column) in itertools.pairwise(grid_path.cells):
        assert weights[to_row, to_column]
        assert max(abs(to_row - row), abs(to_column - column)) == 1
        diagonal = to_row != row and to_column != column
        assert not diagonal or (weights[row, to_column] and weights[to_row, column])
        paid += int(weights[to_row, to_column]) * (DIAGONAL if diagonal else STRAIGHT)
    assert paid / STRAIGHT == pytest.approx(grid_path.cost)
    check_waypoints(weights, grid_path.cells)


def check_waypoints(weights: Grid, cells: NDArray[np.int32]) -> None:
    points = shortcut(weights, cells)
    np.testing.assert_array_equal(points, python_lines.shortcut(weights, cells))
    assert tuple(points[0]) == tuple(cells[0])
    assert tuple(points[-1]) == tuple(cells[-1])
    places = {tuple(cell): n for n, cell in enumerate(cells)}
    order = [places[tuple(point)] for point in points]
    assert order == sorted(order)
    for one, other in itertools.pairwise(points):
        assert touched_free(weights, one, other)


def touched_free(weights: Grid, one: NDArray[np.int32], other: NDArray[np.int32]) -> bool:
    """Check a line by dense sampling: every cell that it passes is free."""
    count = 50 * int(np.abs(other - one).max()) + 1
    points = one + (other - one) * np.linspace(0.0, 1.0, count)[:, None]
    near = np.rint(points).astype(int)
    inside = np.abs(points - near).max(axis=1) < 0.499  # not on the border between two cells
    apart = (near != one).any(axis=1) & inside
    return bool(weights[near[apart, 0], near[apart, 1]].all())


def test_a_path_around_a_wall_is_shortened_to_few_points() -> None:
    weights = np.ones((21, 21), np.uint8)
    weights[5:, 10] = 0
    grid_path = astar(weights, (20, 0), (20, 20))
    assert grid_path is not None
    points = shortcut(weights, grid_path.cells)
    assert len(points) <= 5
    assert grid_path.length == pytest.approx(grid_path.cost, rel=1e-3)
    assert not sees(weights, (20, 0), (20, 20))
    assert sees(weights, (0, 0), (0, 20))


@pytest.mark.parametrize("columns", [1, 3])
def test_cells_with_another_shape_are_rejected(columns: int) -> None:
    weights = np.ones((9, 9), np.uint8)
    for module in (compiled_lines, python_lines):
        with pytest.raises(ValueError, match="rows and columns"):
            module.shortcut(weights, np.zeros((4, columns), np.int32))


def test_a_line_through_a_corner_is_not_free() -> None:
    weights = np.array([[1, 0], [1, 1]], np.uint8)
    assert not sees(weights, (0, 0), (1, 1))
    assert astar(weights, (0, 0), (1, 1)).cells.tolist() == [[0, 0], [1, 0], [1, 1]]  # type: ignore[union-attr]


def test_expensive_cells_are_avoided_and_not_cut_across() -> None:
    weights = np.ones((30, 30), np.uint8)
    weights[3:, 10:20] = 200
    grid_path = astar(weights, (15, 0), (15, 29))
    assert grid_path is not None
    assert weights[grid_path.cells[:, 0], grid_path.cells[:, 1]].max() == 1
    points = shortcut(weights, grid_path.cells)
    assert points[:, 0].min() <= 2


def test_large_costs_use_64_bits() -> None:
    weights = np.random.default_rng(1).integers(1, 256, (300, 300)).astype(np.uint8)
    ends = (150, 150), (135, 165)
    grid_path, same = astar(weights, *ends), python.astar(weights, *ends)
    assert grid_path is not None
    assert grid_path.cost == same.cost == dijkstra(weights, *ends)
    np.testing.assert_array_equal(grid_path.cells, same.cells)


def test_the_open_list_grows(monkeypatch: pytest.MonkeyPatch) -> None:
    weights = np.random.default_rng(1).integers(1, 4, (600, 600)).astype(np.uint8)
    weights[200, :-1] = 0
    start, door, goal = (0, 0), (200, 599), (599, 0)
    whole, parts = astar(weights, start, goal), [astar(weights, start, door), astar(weights, door, goal)]
    assert whole is not None  # its open list has more than 4096 entries at once
    assert whole.cost == pytest.approx(sum(part.cost for part in parts if part is not None), rel=1e-12)
    few = weights[:30, :30]
    small = astar(few, (0, 0), (29, 29))
    assert small is not None
    monkeypatch.setattr(python, "_ENTRIES", 2)
    np.testing.assert_array_equal(small.cells, python.astar(few, (0, 0), (29, 29)).cells)
    monkeypatch.setattr(python, "_MOST_ENTRIES", 15)
    with pytest.raises(MemoryError, match="16 open cells"):
        python.astar(few, (0, 0), (29, 29))


@pytest.mark.parametrize("outside", [(-1, 0), (0, -1), (5, 0), (0, 5)])
@pytest.mark.parametrize("lines", [compiled_lines, python_lines], ids=["compiled", "uncompiled"])
def test_lines_that_leave_the_grid_are_rejected(lines: Any, outside: tuple[int, int]) -> None:
    weights = np.ones((5, 5), np.uint8)
    for one, other in (((2, 2), outside), (outside, (2, 2))):
        with pytest.raises(IndexError, match="outside the grid of 5 x 5"):
            lines.sees(weights, one, other)
    with pytest.raises(IndexError, match="outside the grid of 5 x 5"):
        lines.shortcut(weights, np.array([(0, 0), outside, (1, 1)], np.int32))


def test_the_start_may_be_an_obstacle_but_not_the_goal() -> None:
    weights = np.ones((5, 5), np.uint8)
    weights[2, 2] = 0
    assert astar(weights, (2, 2), (0, 0)) is not None
    assert astar(weights, (0, 0), (2, 2)) is None
    same = astar(weights, (1, 1), (1, 1))
    assert same is not None
    assert (same.cost, len(same.cells), len(shortcut(weights, same.cells))) == (0.0, 1, 1)


def test_an_unreachable_goal_gives_no_path() -> None:
    weights = np.ones((5, 5), np.uint8)
    weights[:, 2] = 0
    assert astar(weights, (0, 0), (0, 4)) is None


@pytest.mark.parametrize(("start", "goal"), [((-1, 0), (0, 0)), ((0, 0), (0, 5)), ((0, 0), (5, 0))])
def test_cells_outside_the_grid_are_rejected(start: tuple[int, int], goal: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=r"outside the grid of 5 x 5"):
        astar(np.ones((5, 5), np.uint8), start, goal)


def test_an_empty_grid_is_rejected() -> None:
    with pytest.raises(ValueError, match="0 x 5"):
        astar(np.ones((0, 5), np.uint8), (0, 0), (0, 0))
