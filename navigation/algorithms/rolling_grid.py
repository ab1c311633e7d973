# cython: boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
# The arrays of times are the grid's own, square with a side of at least 1; rows and columns are taken modulo that side.
# Array arguments are checked first, beam indices are below the number of beams, and divisors are compared with 0 before
# each division.
"""A grid that moves with a robot and stores when the robot's lasers last saw each cell free or occupied.

The grid is a torus: a cell of the world has the index (row modulo side, column modulo side), so that nothing is copied
when the window moves. Rows go along y, columns along x. Each cell has three times, in seconds: when a beam last passed
through it, when a beam last ended in it, and since when beams have ended there without a longer break.
"""

from __future__ import annotations

import math
from typing import Any

import cython
import numpy as np

if cython.compiled:
    from cython.cimports.libc.math import cos, isfinite, isnan, sin
else:
    from math import cos, isfinite, isnan, sin

FREE, OCCUPIED, UNKNOWN = 0, 1, 2
NEVER = -1e9
"""The time of a cell that was never seen."""

# the same as C variables
_FREE = cython.declare(cython.int, FREE)
_OCCUPIED = cython.declare(cython.int, OCCUPIED)
_UNKNOWN = cython.declare(cython.int, UNKNOWN)
_NEVER = cython.declare(cython.double, NEVER)
_INFINITY = cython.declare(cython.double, math.inf)
_FULL_TURN = cython.declare(cython.double, 2.0 * math.pi)

_FAR = cython.declare(cython.double, 2.0**52)  # cells; beyond all positions: doubles have no fractions from there on
_SETTLED = cython.declare(cython.double, 0.5)
"""A cell counts as vacated this many seconds after its last echo; a later echo may be a new object."""

_BLIND_BEAMS = cython.declare(cython.int, 5)  # so many adjacent beams without a measurement are a blind sector
_WEDGE = cython.declare(cython.double, 0.4)  # radians from a blind sector within which beams are not valid nearby

_HOLD = cython.declare(cython.double, 0.35)
"""Seconds for which an echo outweighs passing beams: with noise, beams occasionally pass through a wall's cells."""

_MOVING_SECONDS = cython.declare(cython.double, 1.0)  # how long a new object counts as moving


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _floor(value: cython.double) -> cython.longlong:
    """Return the value rounded down; for NaN, or a value beyond all positions, an integer beyond all positions."""
    if not -_FAR < value < _FAR:
        value = _FAR if value > 0.0 else -_FAR
    whole: cython.longlong = cython.cast(cython.longlong, value)
    return whole - 1 if whole > value else whole


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _modulo(value: cython.longlong, side: cython.longlong) -> cython.longlong:
    """Compute Python's ``%``, which is never negative."""
    remainder: cython.longlong = value % side
    return remainder + side if remainder < 0 else remainder


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _state(passed: cython.double, ended: cython.double, now: cython.double, memory: cython.double) -> cython.int:
    if passed < now - memory and ended < now - memory:
        return _UNKNOWN
    return _OCCUPIED if ended >= passed else _FREE


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _shorten(
    ranges: cython.const[cython.double][::1],
    believed: cython.double[::1],
    step: cython.double,
    nearest: cython.double,
    reach: cython.double,
    aside: cython.double,
) -> cython.void:
    """Limit each beam's valid range to the nearest echo of another beam that it passes closer than ``aside``."""
    beams: cython.Py_ssize_t = ranges.shape[0]
    around: cython.bint = abs(beams * abs(step) - _FULL_TURN) < 2.0 * abs(step)
    cython.declare(beam=cython.Py_ssize_t, other=cython.Py_ssize_t, side_index=cython.Py_ssize_t)
    for beam in range(beams):
        distance: cython.double = ranges[beam]
        if not nearest <= distance < reach:
            continue
        wide: cython.double = min(aside / distance, 0.8) if distance > 0.0 else 0.8
        # at most all beams
        reached: cython.Py_ssize_t = cython.cast(cython.Py_ssize_t, min(beams, max(0.0, wide / abs(step))))
        for other in range(1, reached + 1):
            for side_index in range(2):
                place: cython.Py_ssize_t = beam + other if side_index else beam - other
                if around:
                    place = _modulo(place, beams)
                if 0 <= place < beams and believed[place] > distance:
                    believed[place] = distance


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _leave_out(
    ranges: cython.const[cython.double][::1], begins: cython.double[::1], step: cython.double, aside: cython.double
) -> cython.void:
    """Increase the distances in ``begins`` from which beams beside blind sectors are valid.

    Such a beam at first seems to pass through the sector.
    """
    beams: cython.Py_ssize_t = ranges.shape[0]
    around: cython.bint = abs(beams * abs(step) - _FULL_TURN) < 2.0 * abs(step)
    cython.declare(side_index=cython.Py_ssize_t, turn=cython.Py_ssize_t)
    for side_index in range(2):
        blind: cython.Py_ssize_t = 0
        rim: cython.Py_ssize_t = beams if around else 0
        for turn in range(2 * beams if around else beams):
            beam: cython.Py_ssize_t = _modulo(-1 - turn if side_index else turn, beams)
            if isnan(ranges[beam]):
                blind += 1
                rim = 0 if blind >= _BLIND_BEAMS else rim
                continue
            blind = 0
            rim += 1
            if rim * abs(step) < _WEDGE:
                begins[beam] = max(begins[beam], aside / (rim * abs(step)))


@cython.final
@cython.cclass
class RollingGrid:
    """A square window of cells that moves with a robot.

    Its first row and column are 0 until it moves. Raises `ValueError` if ``side`` is below 1, or ``resolution`` is not
    above 0.
    """

    _side: cython.longlong  # cells
    _row0: cython.longlong
    _column0: cython.longlong
    _resolution: cython.double  # meters per cell
    _memory: cython.double  # seconds for which observations are valid; afterwards a cell is unknown
    _passed: cython.double[:, ::1]
    _ended: cython.double[:, ::1]
    _since: cython.double[:, ::1]

    def __init__(self, side: int, resolution: float, memory: float) -> None:
        if side < 1 or not resolution > 0.0:
            raise ValueError(f"invalid window of {side} cells of {resolution} m")
        self._side, self._resolution, self._memory = side, resolution, memory
        self._row0 = self._column0 = 0
        self._passed, self._ended, self._since = (np.full((side, side), NEVER) for _ in range(3))

    @property
    def corner(self) -> tuple[int, int]:
        """The window's first row and column."""
        return self._row0, self._column0

    @property
    def times(self) -> tuple[Any, Any, Any]:
        """The three times of each cell, (side, side): last passed, last echo, and since when echoes have lasted."""
        return np.asarray(self._passed), np.asarray(self._ended), np.asarray(self._since)

    def move(self, row0: int, column0: int) -> None:
        """Move the window's corner to a row and column; new cells are unknown. Raises `ValueError` if too far away."""
        if not (-_FAR < row0 < _FAR and -_FAR < column0 < _FAR):
            raise ValueError(f"invalid window from row {row0}, column {column0}")
        for axis, new, old in ((0, row0, self._row0), (1, column0, self._column0)):
            moved = min(abs(new - old), self._side)
            begin = old + self._side if new > old else new
            places = np.arange(begin, begin + moved) % self._side
            for array in self.times:
                array[(places, slice(None)) if axis == 0 else (slice(None), places)] = NEVER
        self._row0, self._column0 = row0, column0

    def mark(
        self,
        now: cython.double,
        x: cython.double,
        y: cython.double,
        theta: cython.double,
        first: cython.double,
        step: cython.double,
        nearest: cython.double,
        farthest: cython.double,
        aside: cython.double,
        ranges: cython.const[cython.double][::1],
        points: cython.double[:, ::1],
    ) -> int:
        """Add a scan made at (x, y, theta); return the number of its points within the window.

        Scans of several lasers are merged as if from a single laser in the center, so that beams seem to pass through
        corners and blind sectors. Therefore a beam that passes another beam's echo closer than ``aside`` (meters) is
        valid only up to that echo's distance, and a beam beside a blind sector is valid only where it is farther than
        ``aside`` from the sector's edge.

        ``points`` (n, 3) receives x and y of each echo, and 1 for a new object, else 0. NaN and distances below
        ``nearest`` mean unknown, but minus infinity (REP 117) is an object directly in front of the laser. Raises
        `ValueError` if the pose or the beams' angles are not finite, the step is 0, or the arrays do not fit.
        """
        side: cython.longlong = self._side
        beams: cython.Py_ssize_t = ranges.shape[0]
        cython.declare(count=cython.Py_ssize_t, beam=cython.Py_ssize_t, point=cython.Py_ssize_t)
        if points.shape[0] < beams or points.shape[1] != 3:
            raise ValueError("points must have three numbers for each beam")
        if not isfinite(x + y + theta + first + step * beams) or step == 0.0:
            raise ValueError(
                f"a scan's pose and angles must be finite, its step not 0: {x}, {y}, {theta}, from {first} by {step}"
            )
        believed: cython.double[::1] = np.empty(beams)
        begins: cython.double[::1] = np.zeros(beams)
        with cython.nogil:
            reach: cython.double = 0.5 * side * self._resolution * 1.4143
            most: cython.double = min(reach, farthest)
            count = self._echoes(now, x, y, theta + first, step, nearest, farthest, reach, ranges, points)
            for beam in range(beams):
                distance: cython.double = ranges[beam]
                believed[beam] = min(distance, most)
            _shorten(ranges, believed, step, nearest, reach, aside)
            _leave_out(ranges, begins, step, aside)
            for beam in range(beams):
                distance = believed[beam]
                begin: cython.double = begins[beam]
                if isnan(distance) or distance < nearest or begin >= distance:
                    continue
                angle: cython.double = theta + first + beam * step
                c: cython.double = cos(angle)
                s: cython.double = sin(angle)
                self._pass(now, x + c * begin, y + s * begin, c, s, distance - begin)
            for point in range(count):
                row: cython.longlong = _floor(points[point, 1] / self._resolution)
                column: cython.longlong = _floor(points[point, 0] / self._resolution)
                points[point, 2] = self._is_new(row, column, now)
        return count

    def near(
        self,
        now: cython.double,
        x: cython.double,
        y: cython.double,
        reach: cython.double,
        scanned: cython.double,
        out: cython.double[:, ::1],
    ) -> int:
        """Return the number of occupied or unknown cells around a point, without those in which the newest scan ended.

        ``out`` (n, 3) receives the centers and `OCCUPIED` or `UNKNOWN`, of at most n cells. ``reach`` is half the side
        of the square around the point, meters; ``scanned`` is the time of the newest scan.
        Raises `ValueError` if the point is not finite, or the arrays do not fit.
        """
        side: cython.longlong = self._side
        count: cython.Py_ssize_t = 0
        cython.declare(row=cython.longlong, column=cython.longlong)
        if out.shape[1] != 3:
            raise ValueError("out must be (n, 3)")
        if not isfinite(x + y):
            raise ValueError(f"the point must be finite, not {x}, {y}")
        with cython.nogil:
            low_row: cython.longlong = max(_floor((y - reach) / self._resolution), self._row0)
            high_row: cython.longlong = min(_floor((y + reach) / self._resolution) + 1, self._row0 + side)
            low_column: cython.longlong = max(_floor((x - reach) / self._resolution), self._column0)
            high_column: cython.longlong = min(_floor((x + reach) / self._resolution) + 1, self._column0 + side)
            for row in range(low_row, high_row):
                r: cython.longlong = _modulo(row, side)
                for column in range(low_column, high_column):
                    k: cython.longlong = _modulo(column, side)
                    if self._ended[r, k] == scanned:
                        continue
                    state: cython.int = _state(self._passed[r, k], self._ended[r, k], now, self._memory)
                    if state != _FREE and count < out.shape[0]:
                        out[count, 0] = (column + 0.5) * self._resolution
                        out[count, 1] = (row + 0.5) * self._resolution
                        out[count, 2] = state
                        count += 1
        return count

    def states(self, now: cython.double, out: cython.uchar[:, ::1]) -> None:
        """Write the states of all cells to ``out``, from the window's corner; raises `ValueError` for another size."""
        side: cython.longlong = self._side
        cython.declare(row=cython.longlong, column=cython.longlong)
        if out.shape[0] != side or out.shape[1] != side:
            raise ValueError("out must have the window's shape")
        with cython.nogil:
            left: cython.longlong = _modulo(self._column0, side)
            for row in range(side):
                r: cython.longlong = _modulo(row + self._row0, side)
                for column in range(side):
                    k: cython.longlong = left + column if left + column < side else left + column - side
                    out[row, column] = _state(self._passed[r, k], self._ended[r, k], now, self._memory)

    def stand(self, now: cython.double, x: cython.double, y: cython.double, radius: cython.double) -> None:
        """Mark the unknown cells under the robot as free; raises `ValueError` if x or y is not finite."""
        side: cython.longlong = self._side
        cython.declare(row=cython.longlong, column=cython.longlong)
        if not isfinite(x + y):
            raise ValueError(f"the robot's position must be finite, not {x}, {y}")
        with cython.nogil:
            radius = min(side * self._resolution, radius)  # a disc of this size covers the whole window
            low_row: cython.longlong = _floor((y - radius) / self._resolution)
            high_row: cython.longlong = _floor((y + radius) / self._resolution)
            low_column: cython.longlong = _floor((x - radius) / self._resolution)
            high_column: cython.longlong = _floor((x + radius) / self._resolution)
            for row in range(low_row, high_row + 1):
                for column in range(low_column, high_column + 1):
                    dx: cython.double = (column + 0.5) * self._resolution - x
                    dy: cython.double = (row + 0.5) * self._resolution - y
                    if dx * dx + dy * dy <= radius * radius:
                        r: cython.longlong = _modulo(row, side)
                        k: cython.longlong = _modulo(column, side)
                        if _state(self._passed[r, k], self._ended[r, k], now, self._memory) == _UNKNOWN:
                            self._passed[r, k] = now

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _echoes(
        self,
        now: cython.double,
        x: cython.double,
        y: cython.double,
        first: cython.double,
        step: cython.double,
        nearest: cython.double,
        farthest: cython.double,
        reach: cython.double,
        ranges: cython.const[cython.double][::1],
        points: cython.double[:, ::1],
    ) -> cython.Py_ssize_t:
        """Mark the echoes; return the number within the window."""
        side: cython.longlong = self._side
        count: cython.Py_ssize_t = 0
        beam: cython.Py_ssize_t
        for beam in range(ranges.shape[0]):
            distance: cython.double = ranges[beam]
            if distance == -_INFINITY:
                distance = nearest
            if isnan(distance) or distance < nearest or distance >= farthest or distance > reach:
                continue
            angle: cython.double = first + beam * step
            hit_x: cython.double = x + distance * cos(angle)
            hit_y: cython.double = y + distance * sin(angle)
            row: cython.longlong = _floor(hit_y / self._resolution)
            column: cython.longlong = _floor(hit_x / self._resolution)
            if not (self._row0 <= row < self._row0 + side and self._column0 <= column < self._column0 + side):
                continue
            points[count, 0] = hit_x
            points[count, 1] = hit_y
            count += 1
            r: cython.longlong = _modulo(row, side)
            k: cython.longlong = _modulo(column, side)
            if self._ended[r, k] < now - _SETTLED:
                # a new object if the cell was free just before, otherwise an old one
                self._since[r, k] = now if now - self._passed[r, k] < _MOVING_SECONDS else _NEVER
            self._ended[r, k] = now
        return count

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _pass(
        self,
        now: cython.double,
        x: cython.double,
        y: cython.double,
        c: cython.double,
        s: cython.double,
        length: cython.double,
    ) -> cython.void:
        """Mark the cells of a beam as passed, up to the one before its end (Amanatides and Woo 1987)."""
        side: cython.longlong = self._side
        row: cython.longlong = _floor(y / self._resolution)
        column: cython.longlong = _floor(x / self._resolution)
        down: cython.longlong = 1 if s > 0.0 else -1
        right: cython.longlong = 1 if c > 0.0 else -1
        each_x: cython.double = self._resolution / abs(c) if c != 0.0 else _INFINITY
        each_y: cython.double = self._resolution / abs(s) if s != 0.0 else _INFINITY
        next_x: cython.double = ((column + (right > 0)) * self._resolution - x) / c if c != 0.0 else _INFINITY
        next_y: cython.double = ((row + (down > 0)) * self._resolution - y) / s if s != 0.0 else _INFINITY
        r: cython.longlong = _modulo(row, side)
        k: cython.longlong = _modulo(column, side)
        held: cython.double = now - _HOLD
        while self._row0 <= row < self._row0 + side and self._column0 <= column < self._column0 + side:
            if self._ended[r, k] < held:
                self._passed[r, k] = now
            if next_x < next_y:
                if next_x >= length:
                    return
                column += right
                k += right
                k = 0 if k == side else side - 1 if k < 0 else k
                next_x += each_x
            else:
                if next_y >= length:
                    return
                row += down
                r += down
                r = 0 if r == side else side - 1 if r < 0 else r
                next_y += each_y

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _is_new(self, row: cython.longlong, column: cython.longlong, now: cython.double) -> cython.double:
        """Return 1 for a cell with a new object that is not next to an old one."""
        side: cython.longlong = self._side
        cython.declare(i=cython.longlong, j=cython.longlong)
        if self._since[_modulo(row, side), _modulo(column, side)] < now - _MOVING_SECONDS:
            return 0.0
        for i in range(max(row - 2, self._row0), min(row + 3, self._row0 + side)):
            r: cython.longlong = _modulo(i, side)
            for j in range(max(column - 2, self._column0), min(column + 3, self._column0 + side)):
                k: cython.longlong = _modulo(j, side)
                if self._ended[r, k] > now - 3.0 * _SETTLED and self._since[r, k] < now - _MOVING_SECONDS:
                    return 0.0
        return 1.0
