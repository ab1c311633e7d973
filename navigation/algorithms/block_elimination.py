"""Solves sparse systems of 3 x 3 blocks, such as those of pose graphs, with NumPy only.

Nodes that are not joined are eliminated together, in one vectorized step. In a chain, this is every other node, so that
a chain of n nodes takes about log2(n) steps. The few nodes that remain are solved as a dense system. The order depends
on the edges only, so that all iterations share it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

_DENSE = 60  # nodes that are solved as a dense system
_MOST_NEIGHBORS = 40  # largest number of neighbors of an eliminated node
_FEW_NEIGHBORS, _NEIGHBOR_FACTOR = 3, 1.3  # most neighbors in a step: 3, or 1.3 times the smallest number


class _Step(NamedTuple):
    """Nodes that are eliminated together; an extra node and the empty block stand for missing neighbors.

    Attributes:
        nodes: (m,) their indices.
        neighbors: (m, d) their neighbors.
        blocks: (m, d) indices of the blocks in a neighbor's row and the node's column.
        pairs: (m, d, d) indices of the blocks of each pair of neighbors.
    """

    nodes: Indices
    neighbors: Indices
    blocks: Indices
    pairs: Indices


class BlockElimination:
    """Eliminates a symmetric, positive definite matrix with a block for each node and for each direction of an edge.

    Args:
        count: the number of nodes.
        first, second: the nodes of each edge; an edge with a negative node has no blocks.

    Attributes:
        places: (edges, 2) the indices of each edge's two blocks: that in the first node's row and the second one's
            column, and its transpose. A node's own block has the node's index; the last block is empty.
        size: the number of blocks.
    """

    def __init__(self, count: int, first: Indices, second: Indices) -> None:
        self._count = count
        self._places: dict[tuple[int, int], int] = {}
        joined: list[set[int]] = [set() for _ in range(count)]
        edges = list(zip(first.tolist(), second.tolist(), strict=True))
        for a, b in edges:
            if a >= 0 and b >= 0 and a != b:
                joined[a].add(b)
                joined[b].add(a)
                self._allocate(a, b)
                self._allocate(b, a)
        steps, self._left = self._plan(joined)
        self.size = count + len(self._places) + 1
        last = self.size - 1
        self._steps = [self._step(nodes, last) for nodes in steps]
        self.places = np.array([(self._index(a, b), self._index(b, a)) for a, b in edges], np.intp).reshape(-1, 2)
        self.places[self.places < 0] = last
        left = self._left
        self._dense = np.array([[self._index(a, b) for b in left] for a in left], np.intp).reshape(len(left), len(left))
        self._dense[self._dense < 0] = last

    def solve(self, blocks: Floats, right: Floats) -> Floats:
        """Return the solution for blocks (size, 3, 3) and a right side (count, 3); changes the blocks."""
        blocks[-1] = 0.0
        right = np.concatenate((right, np.zeros((1, 3))))
        inverses, columns = [], []
        for nodes, neighbors, places, pairs in self._steps:
            inverse, column = np.linalg.inv(blocks[nodes]), blocks[places]
            scaled = column @ inverse[:, None]
            np.subtract.at(blocks, pairs, scaled[:, :, None] @ column.swapaxes(-1, -2)[:, None])
            np.subtract.at(right, neighbors, np.einsum("mdij,mj->mdi", scaled, right[nodes]))
            inverses.append(inverse)
            columns.append(column)
        result = np.zeros_like(right)
        if self._left:
            side = 3 * len(self._left)
            dense = blocks[self._dense].swapaxes(1, 2).reshape(side, side)
            result[self._left] = np.linalg.solve(dense, right[self._left].reshape(-1)).reshape(-1, 3)
        for step, inverse, column in zip(reversed(self._steps), reversed(inverses), reversed(columns), strict=True):
            known = np.einsum("mdij,mdi->mj", column, result[step.neighbors])
            result[step.nodes] = np.einsum("mij,mj->mi", inverse, right[step.nodes] - known)
        return result[:-1]

    def _plan(self, joined: list[set[int]]) -> tuple[list[list[tuple[int, list[int]]]], list[int]]:
        """Return the nodes of each step with their neighbors, and the nodes that remain; allocates all their blocks."""
        left, steps = set(range(self._count)), []
        while len(left) > _DENSE:
            blocked: set[int] = set()
            chosen: list[tuple[int, list[int]]] = []
            ordered = sorted(left, key=lambda node: (len(joined[node]), node))
            most = min(max(_FEW_NEIGHBORS, int(_NEIGHBOR_FACTOR * len(joined[ordered[0]]))), _MOST_NEIGHBORS)
            for node in ordered:
                if len(joined[node]) > most:
                    break
                if node not in blocked:
                    chosen.append((node, sorted(joined[node])))
                    blocked |= joined[node]
            if not chosen:
                break
            for node, neighbors in chosen:
                left.discard(node)
                for neighbor in neighbors:
                    joined[neighbor].discard(node)
                    joined[neighbor].update(other for other in neighbors if other != neighbor)
                    for other in neighbors:
                        self._allocate(neighbor, other)
            steps.append(chosen)
        return steps, sorted(left)

    def _step(self, chosen: list[tuple[int, list[int]]], last: int) -> _Step:
        most = max(len(neighbors) for _, neighbors in chosen)
        all_neighbors = np.full((len(chosen), most), self._count, np.intp)
        blocks, pairs = np.full((len(chosen), most), last, np.intp), np.full((len(chosen), most, most), last, np.intp)
        for number, (node, neighbors) in enumerate(chosen):
            count = len(neighbors)
            all_neighbors[number, :count] = neighbors
            blocks[number, :count] = [self._index(neighbor, node) for neighbor in neighbors]
            pairs[number, :count, :count] = [[self._index(a, b) for b in neighbors] for a in neighbors]
        return _Step(np.array([node for node, _ in chosen], np.intp), all_neighbors, blocks, pairs)

    def _allocate(self, row: int, column: int) -> None:
        if row != column:
            self._places.setdefault((row, column), self._count + len(self._places))

    def _index(self, row: int, column: int) -> int:
        return row if row == column else self._places.get((row, column), -1)
