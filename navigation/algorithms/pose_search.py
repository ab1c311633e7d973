"""Finds the pose of a scan on a map without a good guess, by a search of all poses in a window.

It scores poses on a lattice, with a likelihood field wide enough that no peak falls between lattice points, and then
improves the best pose of each neighborhood (correlative scan matching: Olson, "Real-Time Correlative Scan Matching",
ICRA 2009).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import cython
import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.likelihood_field import Field, Floats, LikelihoodField

if cython.compiled:
    from cython.cimports.libc.math import cos, isfinite, sin
else:
    from math import cos, isfinite, sin

_SPACING = 0.2  # meters between two lattice points
_ANGLE = math.radians(6.0)  # the largest angle between two lattice points
_COARSE_SIGMA = 0.25  # meters, of the wide likelihood field
_COARSE_BEAMS = 60  # beams that are scored on the lattice
_HIT = 0.9  # share of beams that end at walls of the map
_KEPT = 16  # candidates that are improved
_APART = 0.6  # meters from a pose within which others belong to its neighborhood
_TURNED_APART = math.radians(25.0)  # the same for the heading
_PUSHES = ((0.1, 3.0), (0.1, 3.0), (0.05, 1.5), (0.05, 1.5), (0.025, 0.7), (0.025, 0.7))
"""Meters and degrees of each improvement step."""

_AROUND = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))


@dataclass(frozen=True)
class SearchWindow:
    """The range of a search.

    Attributes:
        x, y: the center, meters.
        theta: radians.
        reach: meters to each side.
        turn: radians to each side.
    """

    x: float
    y: float
    theta: float
    reach: float
    turn: float


class PoseSearch:
    """Searches for poses on one map.

    Args:
        table: the field's table, with the sharpness for scoring candidates.
    """

    def __init__(self, field: LikelihoodField, table: Field) -> None:
        self._field, self._table = field, table
        self._worst = float(table.min())
        self._wide = field.table(_COARSE_SIGMA, _HIT)
        self._wide_worst = float(self._wide.min())
        self._free = np.ascontiguousarray(field.free)

    def best(self, points: Floats, window: SearchWindow) -> tuple[Floats, Floats]:
        """Return the poses in a window at which the scan fits best, no two near each other.

        Args:
            points: (m, 2) the beams' ends in the robot's frame, meters.
            window: the range of the search.

        Returns:
            (k, 3) poses, the best first, and their scores with the sharp table; no poses without points, or without
            free cells in the window.
        """
        if not len(points):
            return np.empty((0, 3)), np.empty(0)
        steps = max(1, math.ceil(window.turn / _ANGLE))
        turns = np.arange(-steps, steps + (0 if window.turn >= math.pi else 1)) * (window.turn / steps)
        size = self._field.resolution
        stride = max(1, round(_SPACING / size))
        rows, columns = self._free.shape
        low_row, high_row = _cells(window.y, window.reach, size, rows)
        low_column, high_column = _cells(window.x, window.reach, size, columns)
        few = points[np.linspace(0, len(points) - 1, min(_COARSE_BEAMS, len(points))).astype(np.intp)]
        shape = (len(turns), len(range(low_row, high_row, stride)), len(range(low_column, high_column, stride)))
        scores = np.full(shape, -np.inf, np.float32)
        _sweep(
            self._wide,
            self._wide_worst,
            self._free.view(np.uint8),
            np.ascontiguousarray(few / size),
            window.theta + turns,
            low_row,
            low_column,
            stride,
            scores,
        )
        peaks = self._peaks(scores)
        if not len(peaks):
            return np.empty((0, 3)), np.empty(0)
        poses = np.stack(
            [
                (low_column + peaks[:, 2] * stride + 0.5) * size,
                (low_row + peaks[:, 1] * stride + 0.5) * size,
                window.theta + turns[peaks[:, 0]],
            ],
            axis=1,
        )
        return self._pushed(_apart(poses), points)

    def _peaks(self, scores: NDArray[np.float32]) -> NDArray[np.intp]:
        """Return the indices of the highest scores, the highest first."""
        flat = scores.ravel()
        count = min(40 * _KEPT, flat.size)
        if not count:
            return np.empty((0, 3), np.intp)
        top = np.argpartition(flat, flat.size - count)[flat.size - count :]
        top = top[np.isfinite(flat[top])]
        top = top[np.argsort(-flat[top], kind="stable")]
        return np.stack(np.unravel_index(top, scores.shape), axis=1)

    def _pushed(self, poses: Floats, points: Floats) -> tuple[Floats, Floats]:
        scores = np.full(len(poses), -np.inf)
        for meters, degrees in _PUSHES:
            steps = _AROUND * (meters, meters, math.radians(degrees))
            tried = (poses[:, None, :] + steps).reshape(-1, 3)
            scored = self._field.score(self._table, self._worst, tried, points).reshape(len(poses), -1)
            best = scored.argmax(axis=1)
            poses, scores = poses + steps[best], scored.max(axis=1)
        order = np.argsort(-scores, kind="stable")
        return poses[order], scores[order]


def _cells(middle: float, reach: float, size: float, count: int) -> tuple[int, int]:
    """Return the first cell of a window, and the one after its last."""
    low, high = (math.floor((middle + side * reach) / size) for side in (-1.0, 1.0))
    return min(max(low, 0), count), min(max(high + 1, 0), count)


def _apart(poses: Floats) -> Floats:
    """Return the first pose of each neighborhood."""
    kept: list[Floats] = []
    for pose in poses:
        if all(
            math.hypot(pose[0] - other[0], pose[1] - other[1]) > _APART
            or abs(math.remainder(pose[2] - other[2], math.tau)) > _TURNED_APART
            for other in kept
        ):
            kept.append(pose)
            if len(kept) == _KEPT:
                break
    return np.array(kept)


@cython.boundscheck(False)  # the lattice is checked to be on the map, and only cells of the map are read
@cython.wraparound(False)
@cython.initializedcheck(False)
def _sweep(
    table: cython.const[cython.float][:, ::1],  # the field's table
    worst: cython.float,  # the score of a beam that ends outside the map, or is not finite
    free: cython.const[cython.uchar][:, ::1],  # cells to search, with the table's shape
    points: cython.const[cython.double][:, ::1],  # (m, 2) the beams' ends in the robot's frame, cells
    angles: cython.const[cython.double][::1],  # radians
    low_row: cython.Py_ssize_t,  # the lattice's first row
    low_column: cython.Py_ssize_t,  # the lattice's first column
    stride: cython.Py_ssize_t,  # cells between two lattice points
    out: cython.float[:, :, ::1],  # (angles, rows, columns) of the lattice; changed at free points
) -> None:
    """Sum the scores at each lattice point and angle; points are in cells."""
    rows: cython.Py_ssize_t = table.shape[0]
    columns: cython.Py_ssize_t = table.shape[1]
    count: cython.Py_ssize_t = points.shape[0]
    high: cython.Py_ssize_t = out.shape[1]
    wide: cython.Py_ssize_t = out.shape[2]
    up: cython.Py_ssize_t[::1] = np.empty(count, np.intp)
    right: cython.Py_ssize_t[::1] = np.empty(count, np.intp)
    cython.declare(n=cython.Py_ssize_t, m=cython.Py_ssize_t, i=cython.Py_ssize_t, j=cython.Py_ssize_t)
    if free.shape[0] != rows or free.shape[1] != columns or points.shape[1] != 2 or out.shape[0] != angles.shape[0]:
        raise ValueError("points must be (m, 2), and free must have the table's shape")
    if high > 0 and wide > 0:
        if stride < 1 or not (0 <= low_row < rows and 0 <= low_column < columns):
            raise ValueError("the lattice starts outside the map")
        if high - 1 > (rows - 1 - low_row) // stride or wide - 1 > (columns - 1 - low_column) // stride:
            raise ValueError("the lattice ends outside the map")
    with cython.nogil:
        for n in range(angles.shape[0]):
            known: cython.bint = isfinite(angles[n])
            c: cython.double = cos(angles[n]) if known else angles[n]
            s: cython.double = sin(angles[n]) if known else angles[n]
            for m in range(count):
                right[m] = _cell(c * points[m, 0] - s * points[m, 1] + 0.5, columns)
                up[m] = _cell(s * points[m, 0] + c * points[m, 1] + 0.5, rows)
            for i in range(high):
                row: cython.Py_ssize_t = low_row + i * stride
                for j in range(wide):
                    column: cython.Py_ssize_t = low_column + j * stride
                    if not free[row, column]:
                        continue
                    total: cython.float = 0.0
                    for m in range(count):
                        r: cython.Py_ssize_t = row + up[m]
                        k: cython.Py_ssize_t = column + right[m]
                        if 0 <= r < rows and 0 <= k < columns:
                            total += table[r, k]
                        else:
                            total += worst
                    out[n, i, j] = total


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _cell(value: cython.double, count: cython.Py_ssize_t) -> cython.Py_ssize_t:
    """Return the index of a cell at a coordinate; ``count`` for NaN, or if the coordinate is too far away."""
    if not -count <= value < count:
        return count
    whole: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, value)
    return whole - 1 if whole > value else whole
