"""Where on a map a scan was taken, without a guess or with a bad one: all poses of a window are tried.

First on a lattice, with a likelihood field wide enough that no peak falls between its points, then the best from each
neighbourhood are pushed uphill (correlative scan matching: Olson, "Real-Time Correlative Scan Matching", ICRA 2009).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from bridge.messages.cache import compiled
from navigation.algorithms.likelihood_field import Field, Floats, LikelihoodField

_SPACING = 0.2
_ANGLE = math.radians(6.0)
_COARSE_SIGMA = 0.25
_COARSE_BEAMS = 60
_HIT = 0.9
_KEPT = 16
"""Candidates that are pushed uphill."""

_APART = 0.6
_TURNED_APART = math.radians(25.0)
_PUSHES = ((0.1, 3.0), (0.1, 3.0), (0.05, 1.5), (0.05, 1.5), (0.025, 0.7), (0.025, 0.7))
"""Metres and degrees of each push."""

_AROUND = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))


@dataclass(frozen=True)
class Window:
    """Where to look.

    Attributes:
        x, y: the middle, metres.
        theta: radians.
        reach: metres to each side.
        turn: radians to each side.
    """

    x: float
    y: float
    theta: float
    reach: float
    turn: float


class PoseSearch:
    """Searches one map.

    Args:
        field: the map.
        table: of the field, as sharp as candidates are weighed by.
    """

    def __init__(self, field: LikelihoodField, table: Field) -> None:
        self._field, self._table = field, table
        self._worst = float(table.min())
        self._wide = field.table(_COARSE_SIGMA, _HIT)
        self._free = np.ascontiguousarray(field.free)

    def best(self, points: Floats, window: Window) -> tuple[Floats, Floats]:
        """The poses in a window that the scan fits best, no two near each other.

        Args:
            points: (m, 2) the beams' ends in the robot's frame, metres.
            window: where to look.

        Returns:
            (k, 3) poses, the best first, and each one's score with the sharp table; none where nothing is free.
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
        _sweep()(
            self._wide,
            self._free,
            np.ascontiguousarray(few / size),
            window.theta + turns,
            np.array([low_row, high_row, low_column, high_column, stride], np.int64),
            scores,
        )
        found = self._peaks(scores)
        if not len(found):
            return np.empty((0, 3)), np.empty(0)
        poses = np.stack(
            [
                (low_column + found[:, 2] * stride + 0.5) * size,
                (low_row + found[:, 1] * stride + 0.5) * size,
                window.theta + turns[found[:, 0]],
            ],
            axis=1,
        )
        return self._pushed(_apart(poses), points)

    def _peaks(self, scores: NDArray[np.float32]) -> NDArray[np.intp]:
        """The places of the highest scores, the highest first."""
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
        for metres, degrees in _PUSHES:
            steps = _AROUND * (metres, metres, math.radians(degrees))
            tried = (poses[:, None, :] + steps).reshape(-1, 3)
            found = self._field.score(self._table, self._worst, tried, points).reshape(len(poses), -1)
            best = found.argmax(axis=1)
            poses, scores = poses + steps[best], found.max(axis=1)
        order = np.argsort(-scores, kind="stable")
        return poses[order], scores[order]


def _cells(middle: float, reach: float, size: float, count: int) -> tuple[int, int]:
    """From which cell to before which one a window reaches."""
    low, high = (math.floor((middle + side * reach) / size) for side in (-1.0, 1.0))
    return min(max(low, 0), count), min(max(high + 1, 0), count)


def _apart(poses: Floats) -> Floats:
    """The first pose of each neighbourhood."""
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


def _lattice(
    table: Field,
    free: NDArray[np.bool_],
    points: Floats,
    angles: Floats,
    window: NDArray[np.int64],
    out: NDArray[np.float32],
) -> None:
    """Sums at each place of the lattice and each angle; points are in cells."""
    rows, columns = table.shape
    count = len(points)
    up, right = np.empty(count, np.int64), np.empty(count, np.int64)
    worst = table[0, 0]
    for row in range(rows):
        for column in range(columns):
            worst = min(worst, table[row, column])
    for n in range(len(angles)):
        c, s = math.cos(angles[n]), math.sin(angles[n])
        for m in range(count):
            right[m] = math.floor(c * points[m, 0] - s * points[m, 1] + 0.5)
            up[m] = math.floor(s * points[m, 0] + c * points[m, 1] + 0.5)
        for i in range(out.shape[1]):
            row = window[0] + i * window[4]
            for j in range(out.shape[2]):
                column = window[2] + j * window[4]
                if not free[row, column]:
                    continue
                total = numba.float32(0.0)
                for m in range(count):
                    r, k = row + up[m], column + right[m]
                    if 0 <= r < rows and 0 <= k < columns:
                        total += table[r, k]
                    else:
                        total += worst
                out[n, i, j] = total


@cache
def _sweep() -> Any:
    array = numba.types.Array
    signature = numba.void(
        array(numba.float32, 2, "C"),
        array(numba.boolean, 2, "C"),
        array(numba.float64, 2, "C"),
        array(numba.float64, 1, "C"),
        array(numba.int64, 1, "C"),
        array(numba.float32, 3, "C"),
    )
    return compiled(_lattice, signature, [Path(__file__)], nogil=True)
