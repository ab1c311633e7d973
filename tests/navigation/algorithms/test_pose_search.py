"""Searches for the pose of a scan, compiled and uncompiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from navigation.algorithms import pose_search
from navigation.algorithms.likelihood_field import LikelihoodField
from tests.support.uncompiled import uncompiled

MODULES = (pose_search, uncompiled("navigation.algorithms.pose_search"))
CELL = 0.1
ROWS, COLUMNS = 30, 45
TRUE = (1.7, 1.1, 0.4)


@pytest.fixture(scope="module")
def room() -> LikelihoodField:
    """A room with a pillar, so that every pose has a different view."""
    walls = np.ones((ROWS, COLUMNS), np.bool_)
    walls[1:-1, 1:-1] = False
    walls[20:24, 30:34] = True
    return LikelihoodField(walls, ~walls, CELL)


def seen(room: LikelihoodField) -> np.ndarray:
    """Return the centers of the walls' cells in the frame of the true pose."""
    rows, columns = np.nonzero(room.distances == 0.0)
    dx, dy = (columns + 0.5) * CELL - TRUE[0], (rows + 0.5) * CELL - TRUE[1]
    c, s = math.cos(TRUE[2]), math.sin(TRUE[2])
    return np.stack([c * dx + s * dy, c * dy - s * dx], axis=1)[::3]


def searches(room: LikelihoodField) -> list[Any]:
    return [module.PoseSearch(room, room.table(0.1, 0.9)) for module in MODULES]


def test_the_true_pose_is_found_compiled_and_uncompiled(room: LikelihoodField) -> None:
    window = pose_search.SearchWindow(2.1, 0.9, 0.2, 0.7, math.radians(25.0))
    (poses, scores), (others, other_scores) = (each.best(seen(room), window) for each in searches(room))
    np.testing.assert_array_equal(poses, others)
    np.testing.assert_array_equal(scores, other_scores)
    assert np.hypot(*(poses[0, :2] - TRUE[:2])) < 0.1
    assert abs(poses[0, 2] - TRUE[2]) < math.radians(3.0)


def test_invalid_beams_count_as_outside_the_map(room: LikelihoodField) -> None:
    window = pose_search.SearchWindow(1.7, 1.1, 0.4, 0.3, math.radians(12.0))
    points = seen(room)
    points[:8] = [(math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0), (0.0, -math.inf)] * 2
    points[8:12] = [(1e300, 0.0), (0.0, 1e300), (-1e300, 1e300), (1e18, -1e18)]
    with np.errstate(all="ignore"):
        (poses, scores), (others, _) = (each.best(points, window) for each in searches(room))
    np.testing.assert_array_equal(poses, others)
    assert np.isfinite(scores).all()
    assert np.hypot(*(poses[0, :2] - TRUE[:2])) < 0.1


@pytest.mark.parametrize("at", [(-9.0, 1.0), (1.0, 99.0)])
def test_no_pose_is_found_outside_the_map_or_without_points(room: LikelihoodField, at: tuple[float, float]) -> None:
    for search in searches(room):
        for points, window in (
            (seen(room), pose_search.SearchWindow(*at, 0.0, 0.5, 0.1)),
            (np.empty((0, 2)), pose_search.SearchWindow(1.7, 1.1, 0.0, 0.5, 0.1)),
        ):
            poses, scores = search.best(points, window)
            assert poses.shape == (0, 3)
            assert scores.shape == (0,)


@pytest.mark.parametrize("module", MODULES, ids=("compiled", "uncompiled"))
@pytest.mark.parametrize(
    ("row", "column", "stride", "high"),
    [(-1, 0, 1, 2), (9, 0, 1, 2), (0, -1, 1, 2), (0, 7, 3, 2), (0, 0, 0, 2), (8, 0, 1, 3)],
)
def test_a_lattice_outside_the_map_is_rejected(module: Any, row: int, column: int, stride: int, high: int) -> None:
    table, free = np.zeros((10, 10), np.float32), np.ones((10, 10), np.uint8)
    angles, out = np.array([0.0, math.nan]), np.empty((2, high, 2), np.float32)
    points = np.zeros((3, 2))
    with pytest.raises(ValueError, match="outside the map"):
        module._sweep(table, -1.0, free, points, angles, row, column, stride, out)
    with np.errstate(all="ignore"):
        module._sweep(table, -1.0, free, points, angles, 10 - high, 8, 1, out)
    assert (out[0] == 0.0).all()
    assert (out[1] == -3.0).all(), "at an invalid angle all beams are outside the map"
