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

_THROUGH = 0.3
"""Metres before its end at which a beam that meets a wall went through it."""


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

    def agreement(self, pose: tuple[float, float, float], points: Floats, within: float) -> tuple[float, float]:
        """How well the map explains a scan at a pose: the share of beams that speak for it, and of those against it.

        For it speak those that end at a wall, against it those that went through one. The others, which ended before a
        wall, may have met what the map does not have.

        Args:
            pose: x, y, theta: metres, radians.
            points: (m, 2) the beams' ends in the robot's frame, metres.
            within: metres from a wall at which a beam ends at it.
        """
        counts = np.zeros(2, np.int64)
        scale = 1.0 / self.resolution
        _judged()(self.distances, scale, *pose, np.ascontiguousarray(points), within, _THROUGH, counts)
        return float(counts[0]) / len(points), float(counts[1]) / len(points)


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


def _judge(
    distances: Field,
    scale: float,
    x: float,
    y: float,
    theta: float,
    points: Floats,
    within: float,
    through: float,
    counts: NDArray[np.int64],
) -> None:
    """Count beams that end at walls, and those that went through one so many metres before their end."""
    rows, columns = distances.shape
    c, s = math.cos(theta), math.sin(theta)
    for m in range(len(points)):
        dx, dy = c * points[m, 0] - s * points[m, 1], s * points[m, 0] + c * points[m, 1]
        right, up = (x + dx) * scale, (y + dy) * scale
        if right >= 0.0 and up >= 0.0 and right < columns and up < rows and distances[int(up), int(right)] < within:
            counts[0] += 1
            continue
        length = math.hypot(dx, dy)
        if length <= through:
            continue
        gone, last = 0.0, length - through
        while gone < last:
            right, up = (x + dx * gone / length) * scale, (y + dy * gone / length) * scale
            if right < 0.0 or up < 0.0 or right >= columns or up >= rows:
                break
            room = distances[int(up), int(right)]
            if room == 0.0:
                counts[1] += 1
                break
            # a wall's cell is not nearer than its middle less two halves of a cell's diagonal
            gone += max(room - 1.42 / scale, 0.4 / scale)


@cache
def _judged() -> Any:
    floats = numba.types.Array(numba.float64, 2, "C")
    table = numba.types.Array(numba.float32, 2, "C")
    number = numba.float64
    counts = numba.types.Array(numba.int64, 1, "C")
    signature = numba.void(table, number, number, number, number, floats, number, number, counts)
    return compiled(_judge, signature, [Path(__file__)], nogil=True)


@cache
def _score() -> Any:
    floats = numba.types.Array(numba.float64, 2, "C")
    table = numba.types.Array(numba.float32, 2, "C")
    number = numba.float64
    signature = numba.void(table, number, number, floats, floats, numba.types.Array(numba.float64, 1, "C"))
    return compiled(_sum, signature, [Path(__file__)], nogil=True)
