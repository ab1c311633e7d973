# cython: boundscheck=False, wraparound=False, initializedcheck=False
# Indices of columns and blocks are checked before use; each column is added to each queue at most once, and each queue
# has room for all columns.
"""A grid of obstacles and drops for a wheeled robot, from the voxels of each column.

The floor is followed outward from the robot, column by column: a column's floor is the surface nearest to the floor of
its neighbor, if that surface is at most a step above or below. Without such a surface, the column is blocked if it has
occupied voxels between the wheels' step and the robot's height, a drop if it has known voxels below but no floor, and
unknown otherwise; beyond such columns, the floor is expected at its last height. Columns with a known floor are
followed first, then unknown ones, then the others, so that a ramp is climbed from its foot and not from its side.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cython
import numpy as np
from numpy.typing import NDArray

UNKNOWN, FLOOR, OBSTACLE, EDGE = 0, 1, 2, 3
"""The kinds of columns: unknown, free, blocked, or a drop, the edge of a step or a slope that wheels cannot climb."""

SPAN = 0.3
"""Meters along which a slope is measured: about the distance between wheels."""

_FLOOR = cython.declare(cython.uchar, FLOOR)
_OBSTACLE = cython.declare(cython.uchar, OBSTACLE)
_EDGE = cython.declare(cython.uchar, EDGE)
_NONE = cython.declare(cython.longlong, -(1 << 40))
_NOT_REACHED = 3  # above all queues: 0 has columns with a known floor, 1 unknown ones, 2 blocks and drops


class RobotSize(NamedTuple):
    """The robot's dimensions that decide where it can drive, in meters, and the steepest ramp in radians.

    ``step`` is the highest step that the wheels climb, ``margin`` the room to leave above ``height``.
    """

    height: float
    width: float
    step: float
    margin: float
    slope: float


class LayerColumns(NamedTuple):
    """The kinds of columns and their floors' heights; rows along y, the first one at the corner.

    Attributes:
        corner: x and y of the first column's corner, meters.
        kinds: (rows, columns) uint8 of the kinds above.
        floors: (rows, columns) float32, height in meters of the floor's voxel center, or its expected height.
        hits: (rows, columns, 2) float32, heights above the floor, in meters, of the lowest and the highest voxel that
            the robot would touch; NaN if there is none.
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
    """Follow the floor from the robot.

    Args:
        blocks: (count, 3) keys of blocks of 8 x 8 x 8 voxels; 4096 is at 0 m.
        values: (count, 512) log odds in Morton order; NaN is unknown.
        resolution: a voxel's side, meters.
        base: the robot's position on the floor, meters.
        robot: the robot's dimensions.
        largest: the layer's side in meters; columns outside it are left out.

    Raises `ValueError` if a number is not finite, the resolution is not above 0, or blocks do not have 512 values each.
    """
    if values.shape != (len(blocks), 512):
        raise ValueError(f"{len(blocks)} blocks must have 512 values each, not {values.shape}")
    numbers = list(base) + list(robot) + [largest]  # Cython does not unpack C's tuples
    if not all(map(math.isfinite, numbers)) or not resolution > 0.0:
        raise ValueError(f"invalid robot {robot} at {base}")
    side = 8 * resolution
    robot_block = np.array([math.floor(value / side) + 4096 for value in base])
    reach = max(1, round(0.5 * largest / side))
    near = (np.abs(blocks - robot_block) <= reach).all(-1)
    slots = np.flatnonzero(near)
    nearby = blocks[slots]
    covered = np.vstack((nearby, robot_block[None]))
    low, high = covered.min(0), covered.max(0)
    table = np.full(tuple(high - low + 1), -1, np.int32)
    table[tuple((nearby - low).T)] = slots
    count = table.shape[0] * table.shape[1] * 64
    kinds, floors = np.zeros((table.shape[1] * 8, table.shape[0] * 8), np.uint8), np.zeros(count, np.int32)
    hits = np.zeros((*kinds.shape, 2), np.int32)
    builder = _Columns(table, np.ascontiguousarray(values), kinds, floors.reshape(kinds.shape), hits)
    corner = (low - 4096) * side
    x, y, z = ((value - edge) / resolution for value, edge in zip(base, corner.tolist(), strict=True))
    step = max(1, int(robot.step / resolution + 1e-6))
    top = math.ceil((robot.height + robot.margin) / resolution - 1e-6)
    builder.follow(x, y, math.floor(z), 0.5 * robot.width / resolution, step, top)
    span = max(2, round(SPAN / resolution))
    builder.find_edges(span, step + round(span * math.tan(robot.slope)))
    heights = (floors.reshape(kinds.shape) + 0.5) * resolution + corner[2]
    touched = np.full(hits.shape, np.nan, np.float32)
    np.multiply(hits, np.float32(resolution), out=touched, where=hits > 0)
    return LayerColumns((float(corner[0]), float(corner[1])), kinds, heights.astype(np.float32), touched)


@cython.final
@cython.cclass
class _Columns:
    """The columns, and the state of the search for their floors."""

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
        """Find the floor of all columns, starting in the disc under the robot; all arguments are in voxels."""
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
                        self._kinds[row, column] = _FLOOR  # the robot is here
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
        """Mark floors more than a step above a neighbor's as edges.

        Floors that rise by more than ``most`` voxels within ``span`` columns in small steps are marked too.
        """
        rows: cython.longlong = self._kinds.shape[0]
        wide: cython.longlong = self._kinds.shape[1]
        cython.declare(row=cython.longlong, column=cython.longlong, axis=cython.longlong, apart=cython.longlong)
        with cython.nogil:
            for row in range(rows):
                for column in range(wide):
                    if self._best[row * wide + column] != 0:
                        continue
                    for axis in range(2):
                        before: cython.longlong = self._floors[row, column]
                        for apart in range(1, span + 1):
                            to_row: cython.longlong = row + apart if axis else row
                            to: cython.longlong = column if axis else column + apart
                            if to_row >= rows or to >= wide or self._best[to_row * wide + to] != 0:
                                break
                            height: cython.longlong = self._floors[to_row, to]
                            sheer: cython.bint = abs(height - before) > self._step
                            rise: cython.longlong = height - self._floors[row, column]
                            if (rise > most and not sheer) or (sheer and height > before and apart == 1):
                                self._kinds[to_row, to] = max(self._kinds[to_row, to], _EDGE)
                            elif (-rise > most and not sheer) or (sheer and height < before and apart == 1):
                                self._kinds[row, column] = max(self._kinds[row, column], _EDGE)
                            if sheer:
                                break
                            before = height

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _state(self, row: cython.longlong, column: cython.longlong, level: cython.longlong) -> cython.int:
        """Return 0 for an unknown voxel, 1 for a free one, 2 for an occupied one."""
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
        """Return the level of the surface nearest to a floor's, or `_NONE` if no surface is within a step."""
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
        """Whether a voxel between the wheels' step and the robot's height is occupied."""
        level: cython.longlong
        for level in range(floor + self._step + 1, floor + self._top + 1):
            if self._state(row, column, level) == 2:
                return True
        return False

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _measure(self, row: cython.longlong, column: cython.longlong, floor: cython.longlong) -> cython.void:
        """Store the lowest and highest voxel that block a column, counted from the floor."""
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
        """Whether a voxel more than a step below a floor is known, down to the robot's height below that step."""
        level: cython.longlong
        for level in range(max(0, floor - self._step - self._top), floor - self._step):
            if self._state(row, column, level) != 0:
                return True
        return False

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _reach(self, row: cython.longlong, column: cython.longlong, floor: cython.longlong) -> cython.void:
        """Queue a column at a neighbor's floor, unless at least as much is already known about it."""
        place: cython.longlong = row * self._kinds.shape[1] + column
        if self._settled[place] or self._best[place] == 0:
            return
        level: cython.longlong = self._surface(row, column, floor)
        queue: cython.longlong = 0
        if level == _NONE:
            level = floor
            queue = 2 if self._blocked(row, column, floor) or self._drops(row, column, floor) else 1
        if queue >= self._best[place]:
            return
        self._best[place] = cython.cast(cython.uchar, queue)
        end: cython.longlong = self._ends[queue]
        self._queues[queue, end] = cython.cast(cython.int, place)
        self._levels[queue, end] = cython.cast(cython.int, level)
        self._ends[queue] = end + 1

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _settle(
        self, row: cython.longlong, column: cython.longlong, floor: cython.longlong, queue: cython.longlong
    ) -> cython.void:
        """Set the kind of a column with a known floor (queue 0), an unknown one (1), or a block or drop (2)."""
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
    """Spread the lower three bits of a number to every third bit."""
    return (value & 1) | ((value & 2) << 2) | ((value & 4) << 4)
