"""Distances to obstacles, against all pairs."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from navigation.algorithms.distance_transform import distance_transform


@settings(max_examples=200, deadline=None)
@given(rows=st.integers(1, 20), columns=st.integers(1, 20), chance=st.floats(0.0, 1.0), seed=st.integers(0, 2**32))
def test_distances_are_exact(rows: int, columns: int, chance: float, seed: int) -> None:
    obstacles = np.random.default_rng(seed).random((rows, columns)) < chance**3
    places = np.argwhere(obstacles)
    cells = np.argwhere(np.ones_like(obstacles))
    if len(places):
        wanted = np.sqrt(((cells[:, None] - places[None]) ** 2).sum(axis=2).min(axis=1))
    else:
        wanted = np.full(len(cells), np.inf)
    np.testing.assert_allclose(distance_transform(obstacles).ravel(), wanted, rtol=1e-6)
