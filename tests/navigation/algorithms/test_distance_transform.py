"""Distances to obstacles, compared with a search over all pairs of cells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navigation.algorithms.distance_transform import distance_transform
from tests.support.uncompiled import uncompiled


@settings(max_examples=200)
@given(rows=st.integers(1, 20), columns=st.integers(1, 20), chance=st.floats(0.0, 1.0), seed=st.integers(0, 2**32))
def test_distances_are_exact(rows: int, columns: int, chance: float, seed: int) -> None:
    obstacles = np.random.default_rng(seed).random((rows, columns)) < chance**3
    places = np.argwhere(obstacles)
    cells = np.argwhere(np.ones_like(obstacles))
    if len(places):
        wanted = np.sqrt(((cells[:, None] - places[None]) ** 2).sum(axis=2).min(axis=1))
    else:
        wanted = np.full(len(cells), np.inf)
    distances = distance_transform(obstacles)
    np.testing.assert_allclose(distances.ravel(), wanted, rtol=1e-6)
    python = uncompiled("navigation.algorithms.distance_transform")
    np.testing.assert_array_equal(distances, python.distance_transform(obstacles))


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (0, 0)])
def test_empty_arrays_are_accepted(shape: tuple[int, int]) -> None:
    assert distance_transform(np.ones(shape, bool)).shape == shape


def test_slices_of_arrays_are_accepted() -> None:
    obstacles = np.random.default_rng(1).random((40, 60)) < 0.05
    part = obstacles[3:30:2, ::-3]
    np.testing.assert_array_equal(distance_transform(part), distance_transform(part.copy()))
