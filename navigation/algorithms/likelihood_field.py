"""How well a scan fits a map at many poses: the likelihood field.

Each beam's end is held against the distance to the nearest wall, looked up in a table (Thrun, Burgard, Fox,
"Probabilistic Robotics", 2005, section 6.4). A beam that ends nowhere near a wall, at a person or at a thing that the
map does not have, costs no more than a fixed share, however many metres it is off.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from bridge.messages.cache import compiled
from navigation.algorithms.distance_transform import distance_transform

Floats = NDArray[np.float64]
Field = NDArray[np.float32]


class LikelihoodField:
    """A map as tables, in a frame of its own: metres right of and above its lower left corner.

    Args:
        walls: (rows, columns) whether a cell is a wall; rows from the bottom up.
        free: (rows, columns) where a robot's middle may be.
        resolution: metres per cell.

    Attributes:
        distances: (rows, columns) metres from each cell's middle to the nearest surface of a wall.
        free: as given.
        resolution: as given.
    """

    def __init__(self, walls: NDArray[np.bool_], free: NDArray[np.bool_], resolution: float) -> None:
        self.free, self.resolution = free, resolution
        distances = distance_transform(_surface(walls))
        distances *= np.float32(resolution)
        self.distances = distances

    def table(self, sigma: float, hit: float) -> Field:
        """The logarithm of each cell's likelihood as a beam's end, 0 at best.

        Args:
            sigma: standard deviation of a beam's end from its wall, metres.
            hit: share of beams that end at walls of the map; the others may end anywhere.
        """
        near = np.exp(-0.5 * np.square(self.distances / np.float32(sigma)))
        found: Field = np.log(np.float32(hit) * near + np.float32(1.0 - hit)).astype(np.float32)
        return found

    def score(self, table: Field, worst: float, poses: Floats, points: Floats) -> Floats:
        """The sum over all beams at each pose.

        Args:
            table: of `table`.
            worst: what a beam scores that ends off the map.
            poses: (n, 3) x, y, theta: metres, radians.
            points: (m, 2) the beams' ends in the robot's frame, metres.
        """
        out = np.empty(len(poses))
        _score()(table, worst, 1.0 / self.resolution, np.ascontiguousarray(poses), np.ascontiguousarray(points), out)
        return out

    def misses(self, pose: tuple[float, float, float], points: Floats) -> Floats:
        """How far each beam's end is from the nearest wall at a pose, metres; infinite off the map."""
        c, s = math.cos(pose[2]), math.sin(pose[2])
        columns = np.floor((pose[0] + c * points[:, 0] - s * points[:, 1]) / self.resolution).astype(np.int64)
        rows = np.floor((pose[1] + s * points[:, 0] + c * points[:, 1]) / self.resolution).astype(np.int64)
        height, width = self.distances.shape
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        found = np.full(len(points), math.inf)
        found[inside] = self.distances[rows[inside], columns[inside]]
        return found

    def is_free(self, x: float, y: float) -> bool:
        """Whether a robot's middle may be there."""
        row, column = math.floor(y / self.resolution), math.floor(x / self.resolution)
        height, width = self.free.shape
        return 0 <= row < height and 0 <= column < width and bool(self.free[row, column])


def _surface(walls: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The cells of walls that have a neighbour that is none: no beam ends within a wall."""
    padded = np.pad(walls, 1)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    found: NDArray[np.bool_] = walls & ~inner
    return found


def _sum(table: Field, worst: float, scale: float, poses: Floats, points: Floats, out: Floats) -> None:
    rows, columns = table.shape
    for n in range(len(poses)):
        c, s = math.cos(poses[n, 2]) * scale, math.sin(poses[n, 2]) * scale
        x, y = poses[n, 0] * scale, poses[n, 1] * scale
        total = 0.0
        for m in range(len(points)):
            px, py = points[m, 0], points[m, 1]
            right, up = x + c * px - s * py, y + s * px + c * py
            if right >= 0.0 and up >= 0.0 and right < columns and up < rows:
                total += table[int(up), int(right)]
            else:
                total += worst
        out[n] = total


@cache
def _score() -> Any:
    floats = numba.types.Array(numba.float64, 2, "C")
    table = numba.types.Array(numba.float32, 2, "C")
    number = numba.float64
    signature = numba.void(table, number, number, floats, floats, numba.types.Array(numba.float64, 1, "C"))
    return compiled(_sum, signature, [Path(__file__)], nogil=True)
