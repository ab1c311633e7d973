"""The sparse solver finds the same solution as a dense one."""

from __future__ import annotations

import numpy as np
import pytest

from navigation.algorithms.block_elimination import BlockElimination

RANDOM = np.random.default_rng(5)


@pytest.mark.parametrize(("count", "loops"), [(1, 0), (2, 1), (30, 0), (150, 60), (150, 900)])
def test_the_solution_is_that_of_the_dense_system(count: int, loops: int) -> None:
    chain = np.arange(-1, count - 1)
    ends = np.concatenate((np.stack((chain, chain + 1), 1), RANDOM.integers(-1, count, (loops, 2))))
    ends = ends[ends[:, 0] != ends[:, 1]]
    order = BlockElimination(count, ends[:, 0], ends[:, 1])
    blocks, dense = np.zeros((order.size, 3, 3)), np.zeros((3 * count + 3, 3 * count + 3))
    for places, pair in zip(order.places, ends, strict=True):
        left, right = RANDOM.normal(size=(2, 3, 3))
        for number, (one, other) in enumerate(((left, right), (right, left))):
            node, across = 3 * pair[number], 3 * pair[1 - number]
            blocks[pair[number] if pair[number] >= 0 else -1] += one.T @ one
            blocks[places[number]] += one.T @ other
            dense[node : node + 3 or None, node : node + 3 or None] += one.T @ one
            dense[node : node + 3 or None, across : across + 3 or None] += one.T @ other
    blocks[:count] += 0.1 * np.eye(3)
    dense = dense[: 3 * count, : 3 * count] + 0.1 * np.eye(3 * count)
    right_side = RANDOM.normal(size=(count, 3))
    expected = np.linalg.solve(dense, right_side.reshape(-1)).reshape(-1, 3)
    assert order.solve(blocks, right_side) == pytest.approx(expected, abs=1e-8 * (1.0 + np.abs(expected).max()))
