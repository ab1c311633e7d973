"""Frontiers of a growing map: free cells next to unknown ones, in groups (Yamauchi, CIRA 1997)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Cells = NDArray[np.int32]
Mask = NDArray[np.bool_]

_FORWARD = ((0, 1), (1, -1), (1, 0), (1, 1))
"""Half of a cell's neighbors: rows and columns."""


def frontiers(free: Mask, unknown: Mask, least: int = 1) -> list[Cells]:
    """Return the groups of at least ``least`` connected frontier cells, the largest first.

    Args:
        free: (rows, columns) the free cells.
        unknown: (rows, columns) the unknown cells; cells outside the grid do not count.
        least: the minimum number of cells in a group.

    Returns:
        (n, 2) rows and columns of each group; cells that touch at a corner are connected.
    """
    beside = np.zeros(free.shape, np.bool_)
    beside[1:] |= unknown[:-1]
    beside[:-1] |= unknown[1:]
    beside[:, 1:] |= unknown[:, :-1]
    beside[:, :-1] |= unknown[:, 1:]
    cells = np.argwhere(free & beside).astype(np.int32)
    if not len(cells):
        return []
    labels = _labels(cells, free.shape)
    order = np.argsort(labels, kind="stable")
    _, starts = np.unique(labels[order], return_index=True)
    groups = [cells[part] for part in np.split(order, starts[1:]) if len(part) >= least]
    return sorted(groups, key=len, reverse=True)


def _labels(cells: Cells, shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Return a number for each cell, the same for connected cells."""
    rows, columns = shape
    numbers = np.full((rows + 2, columns + 2), -1, np.intp)
    numbers[cells[:, 0] + 1, cells[:, 1] + 1] = labels = np.arange(len(cells))
    first, second = [], []
    for down, right in _FORWARD:
        other = numbers[cells[:, 0] + 1 + down, cells[:, 1] + 1 + right]
        joined = other >= 0
        first.append(labels[joined])
        second.append(other[joined])
    a, b = np.concatenate(first), np.concatenate(second)
    labels = labels.copy()
    while True:
        apart = (labels[a] - labels[b]).astype(np.bool_)
        if not apart.any():
            return labels
        least = np.minimum(labels[a], labels[b])
        for ends in (a, b):
            # the representative changes too, so that long chains need few passes
            np.minimum.at(labels, labels[ends][apart], least[apart])
        while not np.array_equal(further := labels[labels], labels):
            labels = further


def in_sight(free: Mask, cells: Cells, target: tuple[int, int]) -> Mask:
    """Return for each cell whether all cells on the straight line to the target are free."""
    offsets = np.array(target) - cells
    count = 2 * int(np.abs(offsets).max(initial=0)) + 1
    shares = np.linspace(0.0, 1.0, count)[:, None]
    rows, columns = (np.round(cells[:, axis] + shares * offsets[:, axis]).astype(np.intp) for axis in (0, 1))
    return np.logical_and.reduce(free[rows, columns], axis=0, dtype=np.bool_)
