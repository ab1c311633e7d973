"""A graph of poses in the plane, and its most likely poses by least squares.

The solver is Gauss-Newton (Grisetti et al., "A Tutorial on Graph-Based SLAM", ITSM 2010) with a sparse matrix. A graph
has one node per few meters of the robot's path, so hundreds of nodes for a building. The 12 iterations after a
search take 0.14 s of processor time with 250 nodes, 0.4 s with 500 and 0.7 s with 800, if each node has two loops.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.block_elimination import BlockElimination
from navigation.pose import Pose

Floats = NDArray[np.float64]

_CHANGE = 1e-4  # meters or radians; the iterations end when no pose changes by more
_ROBUST = 3.0  # standard deviations beyond which an edge that may be wrong loses its weight
_IDENTITY = Pose(0.0, 0.0, 0.0)


class Edge(NamedTuple):
    """A measurement between two nodes.

    Attributes:
        first, second: the nodes' indices.
        offset: a pose in the second node's frame.
        measured: the same pose in the first node's frame.
        information: (3, 3) inverse covariance of ``measured``: x, y (meters), theta (radians).
        loop: whether the edge closes a loop. Such an edge may be wrong, so its weight falls with its error.
    """

    first: int
    second: int
    offset: Pose
    measured: Pose
    information: Floats
    loop: bool


class PoseGraph:
    """Nodes with poses in one frame, joined by measurements. The first node is fixed."""

    def __init__(self) -> None:
        self.poses: list[Pose] = []
        self.edges: list[Edge] = []

    def add(self, pose: Pose) -> int:
        """Add a node; return its index."""
        self.poses.append(pose)
        return len(self.poses) - 1

    def join(
        self,
        first: int,
        second: int,
        measured: Pose,
        information: Floats,
        *,
        offset: Pose = _IDENTITY,
        loop: bool = False,
    ) -> None:
        """Add an edge; see `Edge`."""
        self.edges.append(Edge(first, second, offset, measured, information, loop))

    def errors(self) -> Floats:
        """Return each edge's error in standard deviations."""
        edges = _Edges(self.edges)
        error, _, _ = edges.linearize(np.array([pose[:3] for pose in self.poses]))
        return np.sqrt(np.einsum("ni,nij,nj->n", error, edges.information, error))

    def optimize(self, steps: int = 10, *, trusting: int = 0) -> float:
        """Move the nodes to their most likely poses; return the largest movement of a node, meters.

        Args:
            steps: maximum number of iterations.
            trusting: the number of iterations, from the first, in which loops count fully, whatever their error.
        """
        count = len(self.poses)
        if count < 2 or not self.edges:
            return 0.0
        begin = np.array([pose[:3] for pose in self.poses])
        poses, equations = begin.copy(), _Equations(self.edges, count)
        for number in range(steps):
            change = equations.step(poses, trusting=number < trusting)
            poses += change
            if np.abs(change).max() < _CHANGE and number >= trusting:
                break
        self.poses = [Pose(float(x), float(y), float(theta)) for x, y, theta in poses]
        return float(np.hypot(*(poses - begin)[:, :2].T).max())


class _Edges:
    """All edges as arrays."""

    def __init__(self, edges: list[Edge]) -> None:
        self.first = np.array([edge.first for edge in edges], np.intp)
        self.second = np.array([edge.second for edge in edges], np.intp)
        self.offset = np.array([edge.offset[:3] for edge in edges]).reshape(-1, 3)
        self.measured = np.array([edge.measured[:3] for edge in edges]).reshape(-1, 3)
        self.information = np.array([edge.information for edge in edges]).reshape(-1, 3, 3)
        self.loop = np.array([edge.loop for edge in edges], np.bool_)

    def linearize(self, poses: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the edges' errors (n, 3), and their derivatives by the first and the second pose (n, 3, 3)."""
        a, b = poses[self.first], poses[self.second]
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        cb, sb = np.cos(b[:, 2]), np.sin(b[:, 2])
        x, y, theta = self.offset.T
        arm_x, arm_y = cb * x - sb * y, sb * x + cb * y
        dx, dy = b[:, 0] + arm_x - a[:, 0], b[:, 1] + arm_y - a[:, 1]
        error = np.stack((c * dx + s * dy, -s * dx + c * dy, b[:, 2] + theta - a[:, 2]), axis=1) - self.measured
        error[:, 2] = np.remainder(error[:, 2] + np.pi, 2.0 * np.pi) - np.pi
        zero, unit = np.zeros_like(c), np.ones_like(c)
        by_a = np.stack((-c, -s, -s * dx + c * dy, s, -c, -c * dx - s * dy, zero, zero, -unit), axis=1).reshape(
            -1, 3, 3
        )
        by_b = np.stack((c, s, -c * arm_y + s * arm_x, -s, c, s * arm_y + c * arm_x, zero, zero, unit), axis=1).reshape(
            -1, 3, 3
        )
        return error, by_a, by_b


class _Equations(_Edges):
    """The normal equations of all edges. The first node is fixed."""

    def __init__(self, edges: list[Edge], count: int) -> None:
        super().__init__(edges)
        self._order = BlockElimination(count - 1, self.first - 1, self.second - 1)
        last = self._order.size - 1
        self._own = [np.where(node > 0, node - 1, last) for node in (self.first, self.second)]

    def step(self, poses: Floats, *, trusting: bool) -> Floats:
        """Return the change of all poses that one step of Gauss-Newton makes."""
        error, by_a, by_b = self.linearize(poses)
        squares = np.einsum("ni,nij,nj->n", error, self.information, error)
        doubtful = self.loop & (not trusting)
        weight = np.where(doubtful, 1.0 / (1.0 + squares / (_ROBUST * _ROBUST)) ** 2, 1.0)
        information = self.information * weight[:, None, None]
        blocks = np.zeros((self._order.size, 3, 3))
        gradient = np.zeros((len(poses), 3))
        ends = ((self.first, by_a), (self.second, by_b))
        for number, (node, derivative) in enumerate(ends):
            weighted = derivative.transpose(0, 2, 1) @ information
            np.add.at(gradient, node, np.einsum("nij,nj->ni", weighted, error))
            np.add.at(blocks, self._own[number], weighted @ derivative)
            np.add.at(blocks, self._order.places[:, number], weighted @ ends[1 - number][1])
        blocks[: len(poses) - 1] += 1e-6 * np.eye(3)
        change = np.zeros((len(poses), 3))
        change[1:] = self._order.solve(blocks, -gradient[1:])
        return change
