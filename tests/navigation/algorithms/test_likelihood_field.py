"""Scans scored on a map, compiled and uncompiled."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from navigation.algorithms import likelihood_field
from tests.support.uncompiled import uncompiled

MODULES = (likelihood_field, uncompiled("navigation.algorithms.likelihood_field"))
ODD = (np.nan, np.inf, -np.inf, 1e300, -1e300)
CELL = 0.05


@pytest.fixture(params=MODULES, ids=("compiled", "uncompiled"))
def room(request: pytest.FixtureRequest) -> Any:
    """A field 4 m wide and 3 m high, surrounded by walls."""
    return field(request.param, box(60, 80))


def box(rows: int, columns: int) -> np.ndarray:
    walls = np.ones((rows, columns), np.bool_)
    walls[1:-1, 1:-1] = False
    return walls


def field(module: ModuleType, walls: np.ndarray) -> Any:
    return module.LikelihoodField(walls, ~walls, CELL)


def test_compiled_and_uncompiled_scores_are_equal() -> None:
    rng = np.random.default_rng(3)
    walls = rng.random((50, 70)) < 0.04
    poses = rng.uniform((-0.5, -0.5, -9.0), (4.0, 3.0, 9.0), (40, 3))
    points = rng.normal(0.0, 1.5, (60, 2))
    poses[::9, rng.integers(0, 3)], points[::7, 0] = rng.choice(ODD, 5), rng.choice(ODD, 9)
    fit: list[tuple[np.ndarray, np.ndarray]] = []
    for module in MODULES:
        made = field(module, walls)
        table = made.table(0.1, 0.9)
        with np.errstate(all="ignore"):
            scores = made.score(table, float(table.min()), poses, points)
            agreed = [made.agreement(tuple(pose), points, 0.1) for pose in poses.tolist()]
        fit.append((scores, np.array(agreed)))
    (scores, shares), (others, other_shares) = fit
    np.testing.assert_array_equal(scores, others)
    np.testing.assert_array_equal(shares, other_shares)
    assert np.isfinite(scores).all()
    assert (shares.max(axis=0) > 0.0).all()


def test_the_table_is_rounded_from_float64(room: Any) -> None:
    """NumPy has its own float32 ``exp`` and ``log`` for each processor, whose last bits differ."""
    sigma, hit = 0.1, 0.9
    distances = np.unique(room.distances)
    expected = [math.log(hit * math.exp(-0.5 * (float(d) / sigma) ** 2) + (1.0 - hit)) for d in distances]
    cells = room.table(sigma, hit)[
        np.unravel_index(np.unique(room.distances, return_index=True)[1], room.distances.shape)
    ]
    np.testing.assert_array_equal(cells, np.array(expected, np.float32))


def test_a_scan_fits_best_at_its_true_pose(room: Any) -> None:
    table = room.table(0.1, 0.9)
    points = np.array([(1.975, 0.0), (-1.975, 0.0), (0.0, 1.475), (0.0, -1.475)])
    poses = np.array([(2.0, 1.5, 0.0), (2.2, 1.5, 0.0), (2.0, 1.5, 0.3)])
    scores = room.score(table, float(table.min()), poses, points)
    assert scores.argmax() == 0
    assert room.agreement((2.0, 1.5, 0.0), points, 0.1) == (1.0, 0.0)
    assert room.agreement((2.0, 1.5, 0.0), 0.5 * points, 0.1) == (0.0, 0.0), "the beams end before a wall"
    assert room.agreement((2.0, 1.5, 0.0), 2.0 * points, 0.1) == (0.0, 1.0), "the beams pass through a wall"


@pytest.mark.parametrize("odd", ODD)
def test_nan_and_distant_points_count_as_outside_the_map(room: Any, odd: float) -> None:
    table = room.table(0.1, 0.9)
    good = np.array([(1.0, 0.0), (0.0, 1.0)])
    with np.errstate(all="ignore"):
        for axis in range(2):
            pose, points = np.array([(2.0, 1.5, 0.0)]), good.copy()
            pose[0, axis] = points[0, axis] = points[1, axis] = odd
            assert room.score(table, -7.0, pose, good) == -14.0
            assert room.score(table, -7.0, np.array([(2.0, 1.5, 0.0)]), points) == -14.0
            assert room.agreement(tuple(pose[0].tolist()), good, 0.1) == (0.0, 0.0)
            # such a beam supports no pose; a long one passes through a wall
            assert room.agreement((2.0, 1.5, 0.0), points, 0.1) in ((0.0, 0.0), (0.0, 1.0))
        if not np.isfinite(odd):
            assert room.score(table, -7.0, np.array([(2.0, 1.5, odd)]), good) == -14.0
            assert room.agreement((2.0, 1.5, odd), good, 0.1) == (0.0, 0.0)


def test_empty_scans_fit_nothing(room: Any) -> None:
    table, none = room.table(0.1, 0.9), np.empty((0, 2))
    assert room.score(table, -1.0, np.empty((0, 3)), none).shape == (0,)
    assert (room.score(table, -1.0, np.zeros((4, 3)), none) == 0.0).all()
    assert room.agreement((2.0, 1.5, 0.0), none, 0.1) == (0.0, 0.0)


def test_arrays_of_any_layout_are_accepted(room: Any) -> None:
    rng = np.random.default_rng(1)
    table, poses, points = (
        room.table(0.1, 0.9),
        rng.uniform(0.0, 3.0, (3, 9)).T,
        rng.normal(0.0, 1.0, (40, 4))[::2, ::2],
    )
    assert not poses.flags.c_contiguous
    assert not points.flags.c_contiguous
    wanted = room.score(table, -1.0, poses.copy(), points.copy())
    np.testing.assert_array_equal(room.score(table, -1.0, poses, points), wanted)
    pose = (2.0, 1.5, 0.0)
    assert room.agreement(pose, points, 0.1) == room.agreement(pose, points.copy(), 0.1)
    with pytest.raises(ValueError, match="poses"):
        room.score(table, -1.0, np.zeros((2, 2)), points)
    with pytest.raises(ValueError, match="points"):
        room.score(table, -1.0, poses, np.zeros((2, 1)))
    with pytest.raises(ValueError, match="points"):
        room.agreement(pose, np.zeros((2, 3)), 0.1)
