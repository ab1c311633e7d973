"""Occupancy grid maps from laser scans; each cell has the log odds that it is occupied.

A beam makes the cells that it passes more likely free, and the one in which it ends more likely occupied (Moravec and
Elfes, "High Resolution Maps from Wide Angle Sonar", ICRA 1985; Thrun, Burgard, Fox, "Probabilistic Robotics", table
9.2). A scan changes each cell at most once: as hit if any beam ends in it, otherwise as passed. A beam frees cells only
as far as the shorter of its two neighboring beams reaches, so that walls seen at a glancing angle are not erased: in an
apartment, the map has 98 % of the visible walls, without this rule 87 %.
"""

from __future__ import annotations

import math

import cython
import numpy as np
from numpy.typing import NDArray

if cython.compiled:
    from cython.cimports.libc.math import cos, isfinite, sin
else:
    from math import cos, isfinite, sin

Odds = NDArray[np.float32]
Corner = tuple[float, float]
Place = tuple[float, float, float]

HIT, PASS = 0.85, -0.4
"""Added to a cell's log odds: probabilities of 0.7 and 0.4."""

LEAST, MOST = -4.0, 4.0
"""Log odds are limited to these values, so that the map follows changes: a free cell counts as occupied after 6 hits,
an occupied one as free after 14 passes."""

# the same as C floats, the type of the map, so that the compiler can vectorize the loop over the cells
_HIT = cython.declare(cython.float, HIT)
_PASS = cython.declare(cython.float, PASS)
_LEAST = cython.declare(cython.float, LEAST)
_MOST = cython.declare(cython.float, MOST)

OCCUPIED, FREE = 0.65, 0.196
"""Probabilities beyond which a cell counts as occupied or free, like map_server's thresholds."""


class OccupancyMap:
    """A grid of log odds; 0 is unknown.

    Args:
        rows: cells along y, the first row at the origin's y.
        columns: cells along x.
        resolution: meters per cell.
        origin: (x, y) of the corner of cell (0, 0), meters.

    Attributes:
        odds: (rows, columns).
        marks: (rows, columns) 0, or the current scan's observation of a cell.
    """

    def __init__(self, rows: int, columns: int, resolution: float, origin: Corner) -> None:
        if rows <= 0 or columns <= 0 or not resolution > 0.0:
            raise ValueError(
                f"a map must have rows, columns and a resolution above 0, not {rows} rows, {columns} columns and "
                f"{resolution} m"
            )
        self.resolution, self.origin = resolution, origin
        self.odds: Odds = np.zeros((rows, columns), np.float32)
        self.marks = np.zeros((rows, columns), np.uint8)
        self._ends = np.empty((0, 2), np.int64)

    def grow(self, below: int, above: int, left: int, right: int) -> None:
        """Add rows and columns of unknown cells on the four sides; known cells keep their position."""
        around = (below, above), (left, right)
        self.odds, self.marks = np.pad(self.odds, around), np.pad(self.marks, around)
        self.origin = self.origin[0] - left * self.resolution, self.origin[1] - below * self.resolution

    def insert(self, pose: Place, ranges: NDArray[np.float64], first: float, step: float, farthest: float) -> int:
        """Add a scan; raises `ValueError` if the pose or the beams' angles are not finite.

        Args:
            pose: the laser's x and y (meters) and direction (radians).
            ranges: meters, one per beam; infinity means no obstacle within ``farthest``, NaN means unknown.
            first: the first beam's angle from the laser's direction, radians.
            step: the angle from a beam to the next.
            farthest: meters up to which cells are changed.

        Returns:
            the number of cells that were hit or passed.
        """
        if not all(map(math.isfinite, pose)):
            raise ValueError(f"a scan's pose must be finite, not {pose}")
        beams = np.ascontiguousarray(ranges, np.float64)
        place = ((pose[0] - self.origin[0]) / self.resolution, (pose[1] - self.origin[1]) / self.resolution)
        reach = farthest / self.resolution
        if not all(-reach <= at <= cells + reach for at, cells in zip(place, self.odds.shape[::-1], strict=True)):
            return 0  # no beam reaches the map
        if len(self._ends) < beams.size:
            self._ends = np.empty((beams.size, 2), np.int64)
        touched = _insert(
            self.odds, self.marks, self._ends, *place, pose[2], beams, first, step, farthest, self.resolution
        )
        return int(touched)

    def occupancy(self) -> NDArray[np.int8]:
        """Return the cells (rows, columns) as in `nav_msgs/OccupancyGrid`: 100 occupied, 0 free, -1 unknown."""
        values = np.full(self.odds.shape, -1, np.int8)
        values[self.odds > np.log(OCCUPIED / (1.0 - OCCUPIED))] = 100
        values[self.odds < np.log(FREE / (1.0 - FREE))] = 0
        return values


@cython.boundscheck(False)  # shapes are checked first, and only cells of the map are marked and changed
@cython.wraparound(False)
@cython.initializedcheck(False)
@cython.cdivision(True)  # divisors: the larger component of a direction, and the checked resolution
def _insert(
    odds: cython.float[:, ::1],
    marks: cython.uchar[:, ::1],
    ends: cython.longlong[:, ::1],
    x: cython.double,
    y: cython.double,
    direction: cython.double,
    ranges: cython.const[cython.double][::1],
    first: cython.double,
    step: cython.double,
    farthest: cython.double,
    resolution: cython.double,
) -> int:
    """Mark the cells that each beam passes (1) and hits (2), then change the log odds of each marked cell once.

    ``x`` and ``y`` are in cells from the map's corner, ``ranges``, ``farthest`` and ``resolution`` in meters.
    A beam marks one cell per column that it crosses, or per row if it is steep. Except for its end, it marks cells only
    as far as the shorter of its two neighboring beams reaches: along a wall, a beam passes through the cells between
    the hits of other beams, and would free them.
    """
    rows: cython.longlong = odds.shape[0]
    columns: cython.longlong = odds.shape[1]
    beams: cython.Py_ssize_t = ranges.shape[0]
    cython.declare(beam=cython.Py_ssize_t, hit=cython.Py_ssize_t)
    hits: cython.Py_ssize_t = 0
    cython.declare(at=cython.longlong, other=cython.longlong, low=cython.longlong, high=cython.longlong)
    cython.declare(clear=cython.double, place=cython.double, slope=cython.double, turned_x=cython.double)
    cython.declare(mark=cython.uchar)
    cython.declare(change=cython.float, changed=cython.float)
    touched: cython.longlong = 0
    if marks.shape[0] != rows or marks.shape[1] != columns or ends.shape[0] < beams or ends.shape[1] != 2:
        raise ValueError("marks must have the map's shape, and ends two columns and a row for each beam")
    if not isfinite(direction + first + step):
        raise ValueError(f"a scan's angles must be finite, not {direction}, {first} and {step}")
    if not resolution > 0.0:
        raise ValueError(f"the map's resolution must be above 0, not {resolution}")
    with cython.nogil:
        column: cython.longlong = _cell(x, columns)
        row: cython.longlong = _cell(y, rows)
        left: cython.longlong = column
        right: cython.longlong = column
        bottom: cython.longlong = row
        top: cython.longlong = row
        turn_x: cython.double = cos(step)
        turn_y: cython.double = sin(step)
        dx: cython.double = cos(direction + first - step)
        dy: cython.double = sin(direction + first - step)
        for beam in range(beams):
            turned_x = dx * turn_x - dy * turn_y
            dy = dx * turn_y + dy * turn_x
            dx = turned_x
            meters: cython.double = ranges[beam]
            if not meters > 0.0:
                continue
            clear = meters
            if beam > 0 and 0.0 < ranges[beam - 1] < clear:
                clear = ranges[beam - 1]
            if beam + 1 < beams and 0.0 < ranges[beam + 1] < clear:
                clear = ranges[beam + 1]
            length: cython.double = min(meters, farthest) / resolution
            clear = min(clear, farthest) / resolution
            end_column: cython.longlong = _cell(x + length * dx, columns)
            end_row: cython.longlong = _cell(y + length * dy, rows)
            left = min(left, end_column)
            right = max(right, end_column)
            bottom = min(bottom, end_row)
            top = max(top, end_row)
            if 0 <= end_row < rows and 0 <= end_column < columns:
                if meters <= farthest:
                    ends[hits, 0] = end_row
                    ends[hits, 1] = end_column
                    hits += 1
                else:
                    marks[end_row, end_column] = 1
            if abs(dx) >= abs(dy):
                slope = dy / dx
                other = _cell(x + clear * dx, columns)
                low = max(column if dx > 0.0 else other + 1, 0)
                high = min(other if dx > 0.0 else column + 1, columns)
                for at in range(low, high):
                    place = y + (at + 0.5 - x) * slope
                    if 0.0 <= place < rows:
                        marks[cython.cast(cython.longlong, place), at] = 1
            else:
                slope = dx / dy
                other = _cell(y + clear * dy, rows)
                low = max(row if dy > 0.0 else other + 1, 0)
                high = min(other if dy > 0.0 else row + 1, rows)
                for at in range(low, high):
                    place = x + (at + 0.5 - y) * slope
                    if 0.0 <= place < columns:
                        marks[at, cython.cast(cython.longlong, place)] = 1
        for hit in range(hits):
            marks[ends[hit, 0], ends[hit, 1]] = 2
        # beams start and end anywhere in a cell, but are evaluated at the centers of columns or rows, so they mark at
        # most one cell outside of the rectangle around their ends
        low = max(left - 1, 0)
        high = min(right + 2, columns)
        for at in range(max(bottom - 1, 0), min(top + 2, rows)):
            for other in range(low, high):
                mark = marks[at, other]
                touched += mark != 0
                change = _HIT if mark == 2 else (_PASS if mark == 1 else 0.0)
                changed = odds[at, other] + change
                odds[at, other] = min(max(changed, _LEAST), _MOST)
                marks[at, other] = 0
    return touched


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _cell(value: cython.double, count: cython.longlong) -> cython.longlong:
    """Return the index of the cell at a coordinate: -1 before the first one or for NaN, ``count`` after the last."""
    if value < count:
        return cython.cast(cython.longlong, value) if value >= 0.0 else -1
    return count if value >= count else -1
