"""The likelihood field: scores how well a scan fits a map at many poses.

Each beam's end is scored by its distance to the nearest wall, from a table (Thrun, Burgard, Fox, "Probabilistic
Robotics", 2005, section 6.4). A beam that ends far from walls, at a person or an unmapped object, lowers the score by
at most a fixed amount.
"""

from __future__ import annotations

import cython
import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.distance_transform import distance_transform

if cython.compiled:
    from cython.cimports.libc.math import cos, isfinite, sin, sqrt
else:
    from math import cos, isfinite, sin, sqrt

Floats = NDArray[np.float64]
Field = NDArray[np.float32]
Place = tuple[float, float, float]

_THROUGH = 0.3  # a beam that meets a wall at least this far (meters) before its end passed through it


class LikelihoodField:
    """A map as tables, in its own frame: meters right of and above its lower left corner.

    Args:
        walls: (rows, columns) whether a cell is a wall; rows from the bottom up.
        free: (rows, columns) cells in which a robot's center may be.
        resolution: meters per cell.

    Attributes:
        distances: (rows, columns) meters from each cell's center to the nearest surface of a wall.
        free: as given.
        resolution: as given.
    """

    def __init__(self, walls: NDArray[np.bool_], free: NDArray[np.bool_], resolution: float) -> None:
        self.free, self.resolution = free, resolution
        distances = distance_transform(_surface(walls))
        distances *= np.float32(resolution)
        self.distances = distances

    def table(self, sigma: float, hit: float) -> Field:
        """Return the logarithm of each cell's likelihood as a beam's end, at most 0.

        Args:
            sigma: standard deviation of a beam's end from its wall, meters.
            hit: share of beams that end at walls of the map; the others may end anywhere.
        """
        # computed in float64, because NumPy's exp and log of float32 differ between processors
        near = np.exp(-0.5 * np.square(self.distances / np.float64(sigma)))
        logs: Field = np.log(hit * near + (1.0 - hit)).astype(np.float32)
        return logs

    def score(self, table: Field, worst: float, poses: Floats, points: Floats) -> Floats:
        """Return the sum of all beams' scores at each pose.

        Args:
            table: the result of `table`.
            worst: the score of a beam that ends outside the map.
            poses: (n, 3) x, y, theta: meters, radians.
            points: (m, 2) the beams' ends in the robot's frame, meters.
        """
        out = np.empty(len(poses))
        _sum(table, worst, 1.0 / self.resolution, np.ascontiguousarray(poses), np.ascontiguousarray(points), out)
        return out

    def agreement(self, pose: Place, points: Floats, within: float) -> tuple[float, float]:
        """Return the share of beams that support a pose, and the share that contradicts it.

        A beam that ends at a wall supports the pose, a beam that passed through a wall contradicts it. Other beams,
        which end before a wall, may have met an unmapped object.

        Args:
            pose: x, y, theta: meters, radians.
            points: (m, 2) the beams' ends in the robot's frame, meters.
            within: meters; a beam that ends no farther than this from a wall ends at it.
        """
        if not len(points):
            return 0.0, 0.0
        scale = 1.0 / self.resolution
        supporting, against = _judge(self.distances, scale, *pose, np.ascontiguousarray(points), within, _THROUGH)
        return supporting / len(points), against / len(points)


def _surface(walls: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells of walls with a neighbor that is not a wall: no beam ends inside a wall."""
    padded = np.pad(walls, 1)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    surface: NDArray[np.bool_] = walls & ~inner
    return surface


@cython.boundscheck(False)  # shapes are checked first, and only cells of the table are read
@cython.wraparound(False)
@cython.initializedcheck(False)
def _sum(
    table: cython.const[cython.float][:, ::1],
    worst: cython.double,
    scale: cython.double,
    poses: cython.const[cython.double][:, ::1],
    points: cython.const[cython.double][:, ::1],
    out: cython.double[::1],
) -> None:
    """Sum the scores of each pose's beams; values that are not finite count as outside the map."""
    rows: cython.double = table.shape[0]
    columns: cython.double = table.shape[1]
    count: cython.Py_ssize_t = points.shape[0]
    cython.declare(n=cython.Py_ssize_t, m=cython.Py_ssize_t)
    if poses.shape[1] != 3 or points.shape[1] != 2 or out.shape[0] != poses.shape[0]:
        raise ValueError("poses must be (n, 3) and points (m, 2)")
    with cython.nogil:
        for n in range(poses.shape[0]):
            theta: cython.double = poses[n, 2]
            known: cython.bint = isfinite(theta)
            c: cython.double = cos(theta) * scale if known else theta
            s: cython.double = sin(theta) * scale if known else theta
            x: cython.double = poses[n, 0] * scale
            y: cython.double = poses[n, 1] * scale
            total: cython.double = 0.0
            for m in range(count):
                right: cython.double = x + c * points[m, 0] - s * points[m, 1]
                up: cython.double = y + s * points[m, 0] + c * points[m, 1]
                # this condition is false for NaN, which therefore never becomes an index
                if right >= 0.0 and up >= 0.0 and right < columns and up < rows:
                    total += float(table[cython.cast(cython.Py_ssize_t, up), cython.cast(cython.Py_ssize_t, right)])
                else:
                    total += worst
            out[n] = total


@cython.boundscheck(False)  # points' shape is checked first, and only cells of the table are looked up
@cython.wraparound(False)
@cython.initializedcheck(False)
@cython.cdivision(True)  # divisors: a length above 0, and the scale
def _judge(
    distances: cython.const[cython.float][:, ::1],
    scale: cython.double,
    x: cython.double,
    y: cython.double,
    theta: cython.double,
    points: cython.const[cython.double][:, ::1],
    within: cython.double,
    through: cython.double,
) -> tuple[int, int]:
    """Count the beams that end at walls, and those that passed through one some meters before their end."""
    rows: cython.double = distances.shape[0]
    columns: cython.double = distances.shape[1]
    supporting: cython.Py_ssize_t = 0
    against: cython.Py_ssize_t = 0
    m: cython.Py_ssize_t
    if points.shape[1] != 2:
        raise ValueError("points must be (m, 2)")
    if not isfinite(theta):
        return 0, 0
    with cython.nogil:
        c: cython.double = cos(theta)
        s: cython.double = sin(theta)
        for m in range(points.shape[0]):
            dx: cython.double = c * points[m, 0] - s * points[m, 1]
            dy: cython.double = s * points[m, 0] + c * points[m, 1]
            right: cython.double = (x + dx) * scale
            up: cython.double = (y + dy) * scale
            if (
                right >= 0.0
                and up >= 0.0
                and right < columns
                and up < rows
                and float(distances[cython.cast(cython.Py_ssize_t, up), cython.cast(cython.Py_ssize_t, right)]) < within
            ):
                supporting += 1
                continue
            length: cython.double = sqrt(dx * dx + dy * dy)
            if length <= through or not isfinite(length):  # also if the square of the length overflows
                continue
            passed: cython.double = 0.0
            last: cython.double = length - through
            while passed < last:
                right = (x + dx * passed / length) * scale
                up = (y + dy * passed / length) * scale
                if not (right >= 0.0 and up >= 0.0 and right < columns and up < rows):
                    break
                room: cython.double = float(
                    distances[cython.cast(cython.Py_ssize_t, up), cython.cast(cython.Py_ssize_t, right)]
                )
                if room == 0.0:
                    against += 1
                    break
                # a wall is nearer than the distance of the cells' centers by at most half a diagonal of each cell
                passed += max(room - 1.42 / scale, 0.4 / scale)
    return supporting, against
