# cython: boundscheck=False, wraparound=False, initializedcheck=False
# Columns and blocks are compared with the shapes of the tables before they are looked up; each column is put into each
# queue once at most, and a queue has a place for each.
"""What a robot on wheels would touch, and where it would fall, as a grid: by the voxels of each column.

The floor is followed from the robot on, from column to column: a column's floor is the surface nearest to its
neighbour's, if it is not more than a step above or below. Where no surface is there, the column is blocked if something
stands between the wheels' step and the robot's height, a drop if what lies below is known and is no floor, and unknown
otherwise; behind such columns the floor is looked for at the height that it had. Columns whose floor is known are
followed first, those that are unknown next, so that a ramp is climbed from its foot and not from its flank.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cython
import numpy as np
from numpy.typing import NDArray

UNKNOWN, FLOOR, OBSTACLE, EDGE = 0, 1, 2, 3
"""What a column is: not known, free, blocked, or at a drop or a step that wheels cannot take."""

SPAN = 0.3
"""Metres along which a slope is measured: about the distance of wheels."""

_FLOOR = cython.declare(cython.uchar, FLOOR)
_OBSTACLE = cython.declare(cython.uchar, OBSTACLE)
_EDGE = cython.declare(cython.uchar, EDGE)
_NONE = cython.declare(cython.longlong, -(1 << 40))
_NOT_REACHED = 3  # worse than all queues: 0 is of columns whose floor is known, 1 of unknown, 2 of blocked ones


class RobotSize(NamedTuple):
    """What decides where a robot may drive: metres, and radians of the steepest ramp."""

    height: float
    width: float
    step: float
    margin: float
    slope: float


class LayerColumns(NamedTuple):
    """Columns of voxels: rows along y, the first one at the corner; what each is, and the height of its floor.

    Attributes:
        corner: x and y of the first column's corner, metres.
        kinds: (rows, columns) uint8 of the kinds above.
        floors: (rows, columns) float32, metres to the middle of the floor's voxel, or where it would be.
        hits: (rows, columns, 2) float32, metres above the floor of the lowest and the highest voxel that the robot
            would touch; NaN where it touches none.
    """

    corner: tuple[float, float]
    kinds: NDArray[np.uint8]
    floors: NDArray[np.float32]
    hits: NDArray[np.float32]


def columns(
    blocks: NDArray[np.int64],
    values: NDArray[np.float32],
    resolution: float,
    base: tuple[float, float, float],
    robot: RobotSize,
    largest: float,
) -> LayerColumns:
    """Follow the floor from the robot on.

    Args:
        blocks: (count, 3) keys of blocks of 8 x 8 x 8 voxels; 4096 is at 0 m.
        values: (count, 512) log odds in Morton's order; NaN is unknown.
        resolution: metres of a voxel's side.
        base: of the robot, on the floor, metres.
        robot: what it touches, and what it takes.
        largest: metres; what is farther than half of it from the robot, to a side, is left out.

    Raises `ValueError` if a number is not finite, or blocks have no 512 values each.
    """
    if values.shape != (len(blocks), 512):
        raise ValueError(f"{len(blocks)} blocks have 512 values each, not {values.shape}")
    numbers = list(base) + list(robot) + [largest]  # Cython does not unpack C's tuples
    if not all(map(math.isfinite, numbers)) or not resolution > 0.0:
        raise ValueError(f"a robot of {robot} at {base} is nowhere")
    side = 8 * resolution
    own = np.array([math.floor(value / side) + 4096 for value in base])
    reach = max(1, round(0.5 * largest / side))
    near = (np.abs(blocks - own) <= reach).all(-1)
    slots = np.flatnonzero(near)
    there = blocks[slots]
    low, high = (np.vstack((there, own[None])).min(0), np.vstack((there, own[None])).max(0))
    table = np.full(tuple(high - low + 1), -1, np.int32)
    table[tuple((there - low).T)] = slots
    count = table.shape[0] * table.shape[1] * 64
    kinds, floors = np.zeros((table.shape[1] * 8, table.shape[0] * 8), np.uint8), np.zeros(count, np.int32)
    hits = np.zeros((*kinds.shape, 2), np.int32)
    made = _Columns(table, np.ascontiguousarray(values), kinds, floors.reshape(kinds.shape), hits)
    corner = (low - 4096) * side
    x, y, z = ((value - edge) / resolution for value, edge in zip(base, corner.tolist(), strict=True))
    step = max(1, int(robot.step / resolution + 1e-6))
    top = math.ceil((robot.height + robot.margin) / resolution - 1e-6)
    made.follow(x, y, math.floor(z), 0.5 * robot.width / resolution, step, top)
    span = max(2, round(SPAN / resolution))
    made.find_edges(span, step + round(span * math.tan(robot.slope)))
    heights = (floors.reshape(kinds.shape) + 0.5) * resolution + corner[2]
    touched = np.full(hits.shape, np.nan, np.float32)
    np.multiply(hits, np.float32(resolution), out=touched, where=hits > 0)
    return LayerColumns((float(corner[0]), float(corner[1])), kinds, heights.astype(np.float32), touched)


@cython.final
@cython.cclass
class _Columns:
    """The columns while they are made."""

    _table: cython.int[:, :, ::1]
    _values: cython.const[cython.float][:, ::1]
    _kinds: cython.uchar[:, ::1]
    _floors: cython.int[:, ::1]
    _hits: cython.int[:, :, ::1]
    _best: cython.uchar[::1]
    _settled: cython.uchar[::1]
    _queues: cython.int[:, ::1]
    _levels: cython.int[:, ::1]
    _ends: cython.longlong[::1]
    _step: cython.longlong
    _top: cython.longlong

    def __init__(
        self,
        table: NDArray[np.int32],
        values: NDArray[np.float32],
        kinds: NDArray[np.uint8],
        floors: NDArray[np.int32],
        hits: NDArray[np.int32],
    ) -> None:
        self._table, self._values, self._kinds, self._floors, self._hits = table, values, kinds, floors, hits
        self._best, self._settled = np.full(kinds.size, _NOT_REACHED, np.uint8), np.zeros(kinds.size, np.uint8)
        self._queues, self._levels = np.empty((3, kinds.size), np.int32), np.empty((3, kinds.size), np.int32)
        self._ends = np.zeros(3, np.int64)

    def follow(
        self,
        x: cython.double,
        y: cython.double,
        level: cython.longlong,
        radius: cython.double,
        step: cython.longlong,
        top: cython.longlong,
    ) -> None:
        """Find the floor of all columns, from a disc about the robot on; all in voxels."""
        rows: cython.longlong = self._kinds.shape[0]
        wide: cython.longlong = self._kinds.shape[1]
        self._step, self._top = step, top
        cython.declare(row=cython.longlong, column=cython.longlong, queue=cython.longlong)
        with cython.nogil:
            for row in range(max(0, cython.cast(cython.longlong, y - radius)), rows):
                if row > y + radius:
                    break
                for column in range(max(0, cython.cast(cython.longlong, x - radius)), wide):
                    if column > x + radius:
                        break
                    apart: cython.double = (row + 0.5 - y) ** 2 + (column + 0.5 - x) ** 2
                    if apart <= max(radius * radius, 0.5):
                        self._kinds[row, column] = _FLOOR  # it stands there
                        self._reach(row, column, level)
            begins_0: cython.longlong = 0
            begins_1: cython.longlong = 0
            begins_2: cython.longlong = 0
            while True:
                if begins_0 < self._ends[0]:
                    queue = 0
                    index: cython.longlong = begins_0
                    begins_0 += 1
                elif begins_1 < self._ends[1]:
                    queue = 1
                    index = begins_1
                    begins_1 += 1
                elif begins_2 < self._ends[2]:
                    queue = 2
                    index = begins_2
                    begins_2 += 1
                else:
                    break
                place: cython.longlong = self._queues[queue, index]
                if self._settled[place]:
                    continue
                self._settled[place] = 1
                row = place // wide
                column = place % wide
                floor: cython.longlong = self._levels[queue, index]
                self._floors[row, column] = cython.cast(cython.int, floor)
                self._settle(row, column, floor, queue)
                if row > 0:
                    self._reach(row - 1, column, floor)
                if row < rows - 1:
                    self._reach(row + 1, column, floor)
                if column > 0:
                    self._reach(row, column - 1, floor)
                if column < wide - 1:
                    self._reach(row, column + 1, floor)

    def find_edges(self, span: cython.longlong, most: cython.longlong) -> None:
        """Make edges of floors that lie more than a step above a neighbour's.

        So are those that rise by more than ``most`` voxels within ``span`` columns, by steps that can be taken.
        """
        rows: cython.longlong = self._kinds.shape[0]
        wide: cython.longlong = self._kinds.shape[1]
        cython.declare(row=cython.longlong, column=cython.longlong, way=cython.longlong, apart=cython.longlong)
        with cython.nogil:
            for row in range(rows):
                for column in range(wide):
                    if self._best[row * wide + column] != 0:
                        continue
                    for way in range(2):
                        before: cython.longlong = self._floors[row, column]
                        for apart in range(1, span + 1):
                            to_row: cython.longlong = row + apart if way else row
                            to: cython.longlong = column if way else column + apart
                            if to_row >= rows or to >= wide or self._best[to_row * wide + to] != 0:
                                break
                            there: cython.longlong = self._floors[to_row, to]
                            sheer: cython.bint = abs(there - before) > self._step
                            rise: cython.longlong = there - self._floors[row, column]
                            if (rise > most and not sheer) or (sheer and there > before and apart == 1):
                                self._kinds[to_row, to] = max(self._kinds[to_row, to], _EDGE)
                            elif (-rise > most and not sheer) or (sheer and there < before and apart == 1):
                                self._kinds[row, column] = max(self._kinds[row, column], _EDGE)
                            if sheer:
                                break
                            before = there

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _state(self, row: cython.longlong, column: cython.longlong, level: cython.longlong) -> cython.int:
        """0: a voxel is not known, 1: free, 2: occupied."""
        if level < 0 or level >= 8 * self._table.shape[2]:
            return 0
        slot: cython.longlong = self._table[column >> 3, row >> 3, level >> 3]
        if slot < 0:
            return 0
        value: cython.float = self._values[slot, _spread(column) | _spread(row) << 1 | _spread(level) << 2]
        return 2 if value > 0.0 else 1 if value <= 0.0 else 0

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _surface(self, row: cython.longlong, column: cython.longlong, floor: cython.longlong) -> cython.longlong:
        """The level of the surface that is nearest to a floor's, if it is within a step of it."""
        apart: cython.longlong
        for apart in range(self._step + 1):
            if self._state(row, column, floor + apart) == 2 and self._state(row, column, floor + apart + 1) != 2:
                return floor + apart
            if self._state(row, column, floor - apart) == 2 and self._state(row, column, floor - apart + 1) != 2:
                return floor - apart
        return _NONE

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _blocked(self, row: cython.longlong, column: cython.longlong, floor: cython.longlong) -> cython.bint:
        """Whether something is between the wheels' step and the robot's height."""
        level: cython.longlong
        for level in range(floor + self._step + 1, floor + self._top + 1):
            if self._state(row, column, level) == 2:
                return True
        return False

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _measure(self, row: cython.longlong, column: cython.longlong, floor: cython.longlong) -> cython.void:
        """Note what blocks a column: its lowest and its highest voxel, counted from the floor."""
        level: cython.longlong
        for level in range(self._step + 1, self._top + 1):
            if self._state(row, column, floor + level) == 2:
                if self._hits[row, column, 0] == 0:
                    self._hits[row, column, 0] = cython.cast(cython.int, level)
                self._hits[row, column, 1] = cython.cast(cython.int, level)

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _drops(self, row: cython.longlong, column: cython.longlong, floor: cython.longlong) -> cython.bint:
        """Whether what lies more than a step below a floor is known."""
        level: cython.longlong
        for level in range(max(0, floor - self._step - self._top), floor - self._step):
            if self._state(row, column, level) != 0:
                return True
        return False

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _reach(self, row: cython.longlong, column: cython.longlong, floor: cython.longlong) -> cython.void:
        """Queue a column for a neighbour's floor, unless it is known as well already."""
        place: cython.longlong = row * self._kinds.shape[1] + column
        if self._settled[place] or self._best[place] == 0:
            return
        found: cython.longlong = self._surface(row, column, floor)
        queue: cython.longlong = 0
        if found == _NONE:
            found = floor
            queue = 2 if self._blocked(row, column, floor) or self._drops(row, column, floor) else 1
        if queue >= self._best[place]:
            return
        self._best[place] = cython.cast(cython.uchar, queue)
        end: cython.longlong = self._ends[queue]
        self._queues[queue, end] = cython.cast(cython.int, place)
        self._levels[queue, end] = cython.cast(cython.int, found)
        self._ends[queue] = end + 1

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _settle(
        self, row: cython.longlong, column: cython.longlong, floor: cython.longlong, queue: cython.longlong
    ) -> cython.void:
        """Say what a column is, whose floor is known (queue 0), or not (1), or which is blocked or drops (2)."""
        if self._blocked(row, column, floor):
            self._kinds[row, column] = _OBSTACLE
            self._measure(row, column, floor)
        elif queue == 0:
            self._kinds[row, column] = _FLOOR
        elif queue == 2:
            self._kinds[row, column] = _EDGE


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _spread(value: cython.longlong) -> cython.longlong:
    """The lower three bits of a number, every third one."""
    return (value & 1) | ((value & 2) << 2) | ((value & 4) << 4)
