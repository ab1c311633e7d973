# cython: boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
# Slots are indices of existing blocks, indices in a block are below 512, and indices in the table are taken modulo its
# size; arguments are checked first, and divisors are compared with 0 before each division.
"""Probabilities of voxels from point clouds: the same tree as OctoMap's, stored in blocks of 8 x 8 x 8.

OctoMap descends sixteen levels of its tree for each voxel of each ray; this module looks up a hash table once for each
block that a ray enters, and a tree is built only to be sent or saved. Keys, rays, odds and limits are OctoMap's
(Hornung et al., "OctoMap", Autonomous Robots 2013; release 1.9 of its library): a voxel's key is its position in units
of the resolution, rounded down, plus 32768; rays go from cell to cell (Amanatides and Woo 1987) in OctoMap's
floating-point precision, so that both maps have equal leaves.
"""

from __future__ import annotations

import math
from typing import Any

import cython
import numpy as np
from numpy.typing import NDArray

if cython.compiled:
    from cython.cimports.libc.math import floor, sqrt
else:
    from math import floor, sqrt

SIDE, CELLS = 8, 512
"""Voxels along a block's side, and in a block."""

MIDDLE = 32768
"""Key of the voxel whose lower corner is the map's origin; keys are from 0 to 65535."""


def _odds(probability: float) -> float:
    return float(np.float32(math.log(probability / (1.0 - probability))))


HIT, MISS, LEAST, MOST = _odds(0.7), _odds(0.4), _odds(0.1192), _odds(0.971)
"""Log odds that OctoMap adds to a voxel for a hit and a miss, and the limits of the sum (OctoMap's default values)."""

_HIT = cython.declare(cython.float, HIT)
_MISS = cython.declare(cython.float, MISS)
_LEAST = cython.declare(cython.float, LEAST)
_MOST = cython.declare(cython.float, MOST)
_MIDDLE = cython.declare(cython.longlong, MIDDLE)
_KEYS = cython.declare(cython.longlong, 2 * MIDDLE)
_CELLS = cython.declare(cython.longlong, CELLS)
_UNKNOWN = cython.declare(cython.float, math.nan)
_INFINITY = cython.declare(cython.double, math.inf)
_LOWER = cython.declare(cython.longlong, (1 << 39) - 1)  # 39 bits, so that a 24-bit factor does not overflow
_NO_ROOM = cython.declare(cython.longlong, -2)
_BEGIN = 64  # initial capacity in blocks
_BYTES = 9 * CELLS + 13  # per block


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _hash(key: cython.longlong) -> cython.longlong:
    return ((key ^ (key >> 21)) & _LOWER) * 0x9E3779 >> 22


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _spread(value: cython.longlong) -> cython.longlong:
    """Spread the lower three bits of a key to every third bit, for one axis in a block (Morton order)."""
    return (value & 1) | ((value & 2) << 2) | ((value & 4) << 4)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _key(coordinate: cython.float, factor: cython.double) -> cython.longlong:
    """Return a key along one axis; -1 for NaN, or if the coordinate is outside the range of keys."""
    place: cython.double = floor(factor * coordinate) if abs(factor * coordinate) < _MIDDLE else _INFINITY
    return cython.cast(cython.longlong, place) + _MIDDLE if place < _MIDDLE else -1


@cython.final
@cython.cclass
class VoxelMap:
    """Log odds of voxels, and when each was last seen occupied.

    Args:
        resolution: a voxel's side, meters.
        most: the maximum number of blocks of 8 x 8 x 8 voxels, 4.6 kB each; values above 2**26 are lowered to it.

    Raises `ValueError` if a parameter is not above 0.
    """

    resolution = cython.declare(cython.double, visibility="readonly")
    most = cython.declare(cython.longlong, visibility="readonly")
    count = cython.declare(cython.longlong, visibility="readonly")
    left_out = cython.declare(cython.longlong, visibility="readonly")
    _values: cython.float[:, ::1]  # log odds by block and place; NaN: unknown
    _seen: cython.float[:, ::1]  # when a ray last ended there, seconds
    _marks: cython.uchar[:, ::1]  # the current cloud's observation of a voxel: 1 passed, 2 hit
    _blocks: cython.longlong[::1]  # packed keys of the blocks
    _table: cython.int[::1]  # slots by hash, -1: none
    _touched: cython.int[::1]  # slots of blocks that have marks, the first `_marked` of them
    _is_touched: cython.uchar[::1]
    _marked: cython.longlong
    _ends: cython.longlong[::1]
    _set: cython.longlong[::1]
    _ox: cython.float
    _oy: cython.float
    _oz: cython.float

    def __init__(self, resolution: float, most: int) -> None:
        if not resolution > 0.0 or most < 1:
            raise ValueError(f"invalid map of {most} blocks with voxels of {resolution} m")
        self.resolution, self.most = resolution, min(most, 1 << 26)
        self._ends, self._set = np.empty(0, np.int64), np.empty(0, np.int64)
        self.clear()

    def clear(self) -> None:
        """Remove all voxels."""
        self.count = self.left_out = self._marked = 0
        self._store(np.empty((0, CELLS), np.float32), np.empty((0, CELLS), np.float32), np.empty(0, np.int64), _BEGIN)

    @property
    def full(self) -> bool:
        """Whether the last cloud did not fit completely."""
        return self.left_out > 0

    @property
    def megabytes(self) -> float:
        """The memory in use (MiB), without the temporary memory for adding a cloud."""
        return (self._blocks.shape[0] * _BYTES + 4 * self._table.shape[0]) / 2**20

    @property
    def blocks(self) -> NDArray[np.int64]:
        """Each block's key, (count, 3): a voxel's key divided by 8."""
        packed = np.asarray(self._blocks)[: self.count]
        return np.stack((packed & 0x1FFF, packed >> 13 & 0x1FFF, packed >> 26), -1)

    @property
    def values(self) -> NDArray[np.float32]:
        """The log odds by block and index, (count, 512), in Morton order (x lowest); NaN is unknown. Not a copy."""
        return np.asarray(self._values)[: self.count]

    @property
    def seen(self) -> NDArray[np.float32]:
        """The time in seconds at which a ray last ended in each voxel, (count, 512); 0 for never. Not a copy."""
        return np.asarray(self._seen)[: self.count]

    def insert(
        self, points: cython.float[:, ::1], origin: tuple[float, float, float], farthest: float, now: float = 0.0
    ) -> int:
        """Add a cloud like OctoMap's ``insertPointCloud`` with ``discretize``; return the number of observed voxels.

        Raises `ValueError` if the points are not (n, 3).

        Args:
            points: (n, 3) meters; points that are not finite, or outside the range of keys, are ignored.
            origin: the sensor's position, meters. Raises `ValueError` if it is outside the range of keys.
            farthest: meters; a ray to a point farther away frees the voxels up to this distance, and hits none. Raises
                `ValueError` if it is not above 0.
            now: seconds of any clock.
        """
        if points.shape[1] != 3:
            raise ValueError(f"points must be (n, 3), not (n, {points.shape[1]})")
        self._ox, self._oy, self._oz = origin
        factor = 1.0 / self.resolution
        if min(_key(self._ox, factor), _key(self._oy, factor), _key(self._oz, factor)) < 0 or not farthest > 0.0:
            raise ValueError(f"a sensor at {origin} with a range of {farthest} m is outside the map")
        room = 1 << max(4, 2 * points.shape[0] - 1).bit_length()
        if self._set.shape[0] != room:
            self._set, self._ends = np.empty(room, np.int64), np.empty(room // 2, np.int64)
        np.asarray(self._set)[:] = -1
        ends: cython.longlong = self._collect(points)
        self.left_out = 0
        while not self._mark(ends, farthest):
            self._grow()
        return int(self._update(now))

    def log_odds(self, places: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the log odds (n,) at points (n, 3), meters; NaN is unknown."""
        odds = np.full(len(places), np.nan, np.float32)
        self._read(np.ascontiguousarray(places, np.float32), odds)
        return odds

    def fill(self, keys: NDArray[np.int64], sides: NDArray[np.int64], values: NDArray[np.float32]) -> None:
        """Set cubes of voxels, such as the leaves of a tree.

        Args:
            keys: (n, 3) key of each cube's lowest voxel.
            sides: (n,) voxels along each cube's side, a power of 2.
            values: (n,) log odds.

        Raises `ValueError` if a cube is invalid, or the map is full; in that case, some cubes may be set already.
        """
        keys, sides = np.ascontiguousarray(keys, np.int64), np.ascontiguousarray(sides, np.int64)
        if keys.size and not (
            (sides > 0).all() and (sides & sides - 1 == 0).all() and (keys % sides[:, None] == 0).all()
            and (keys >= 0).all() and (keys + sides[:, None] <= 2 * MIDDLE).all() and len(keys) == len(values)
        ):  # fmt: skip
            raise ValueError("a cube of the tree is outside its keys, 0 to 65535")
        blocks = float(((np.maximum(sides, SIDE) / SIDE) ** 3)[sides > SIDE].sum())
        done = 0 if blocks <= self.most else -1
        while done >= 0 and done < len(keys):
            done = self._fill(done, keys, sides, np.ascontiguousarray(values, np.float32))
            if 0 <= done < len(keys):
                self._grow()
        if done < 0:
            raise ValueError(f"the tree needs more than the {self.most} blocks of {SIDE} voxels per side that fit")

    def keep(self, chosen: NDArray[np.bool_]) -> None:
        """Remove all blocks except the chosen ones; ``chosen`` is (count,)."""
        wanted = np.flatnonzero(chosen)
        self._store(self.values[wanted], self.seen[wanted], np.asarray(self._blocks)[wanted], len(wanted))

    @cython.cfunc
    def _store(
        self, values: NDArray[np.float32], seen: NDArray[np.float32], blocks: NDArray[np.int64], room: int
    ) -> Any:
        """Replace all blocks by these; ``room`` is the new capacity in blocks."""
        room = min(max(room, _BEGIN), self.most)
        held = len(blocks)
        odds = np.full((room, CELLS), np.nan, np.float32)
        times = np.zeros((room, CELLS), np.float32)
        odds[:held], times[:held] = values, seen
        self._values, self._seen, self._marks = odds, times, np.zeros((room, CELLS), np.uint8)
        keys = np.zeros(room, np.int64)
        keys[:held] = blocks
        self._blocks = keys
        self._touched, self._is_touched = np.empty(room, np.int32), np.zeros(room, np.uint8)
        self._marked = 0
        self._table = np.full(1 << (4 * room - 1).bit_length(), -1, np.int32)
        self.count = 0
        for key in blocks.tolist():
            self._slot(key)

    @cython.cfunc
    def _grow(self) -> Any:
        """Double the capacity; all marks are lost, and the caller makes them again."""
        self._store(self.values, self.seen, np.asarray(self._blocks)[: self.count], 2 * self._blocks.shape[0])

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _find(self, key: cython.longlong) -> cython.longlong:
        """Return the slot of a block, or -1."""
        mask: cython.longlong = self._table.shape[0] - 1
        at: cython.longlong = _hash(key) & mask
        while self._table[at] >= 0 and self._blocks[self._table[at]] != key:
            at = (at + 1) & mask
        return self._table[at]

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _slot(self, key: cython.longlong) -> cython.longlong:
        """Return the slot of an existing or new block; -1 if the map is full, -2 if it has to grow first."""
        mask: cython.longlong = self._table.shape[0] - 1
        at: cython.longlong = _hash(key) & mask
        while self._table[at] >= 0:
            if self._blocks[self._table[at]] == key:
                return self._table[at]
            at = (at + 1) & mask
        if self.count == self._blocks.shape[0]:
            return -1 if self.count >= self.most else _NO_ROOM
        self._table[at] = cython.cast(cython.int, self.count)
        self._blocks[self.count] = key
        self.count += 1
        return self.count - 1

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _read(self, places: cython.const[cython.float][:, ::1], found: cython.float[::1]) -> cython.void:
        factor: cython.double = 1.0 / self.resolution
        index: cython.Py_ssize_t
        for index in range(found.shape[0]):
            x: cython.longlong = _key(places[index, 0], factor)
            y: cython.longlong = _key(places[index, 1], factor)
            z: cython.longlong = _key(places[index, 2], factor)
            if x >= 0 and y >= 0 and z >= 0:
                slot: cython.longlong = self._find(_packed(x >> 3, y >> 3, z >> 3))
                if slot >= 0:
                    found[index] = self._values[slot, _spread(x) | _spread(y) << 1 | _spread(z) << 2]

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _fill(
        self,
        done: cython.longlong,
        keys: cython.const[cython.longlong][:, ::1],
        sides: cython.const[cython.longlong][::1],
        values: cython.const[cython.float][::1],
    ) -> cython.longlong:
        """Set the cubes from index ``done`` on; return the index of the first that needs more capacity.

        Returns -1 if the map is full, and the number of cubes if all are set.
        """
        index: cython.longlong
        for index in range(done, sides.shape[0]):
            side: cython.longlong = sides[index]
            wide: cython.longlong = max(1, side >> 3)
            first: cython.longlong = 0
            many: cython.longlong = _CELLS
            if side < 8:
                first = _spread(keys[index, 0]) | _spread(keys[index, 1]) << 1 | _spread(keys[index, 2]) << 2
                many = side * side * side
            block: cython.longlong
            for block in range(wide * wide * wide):
                slot: cython.longlong = self._slot(
                    _packed(
                        (keys[index, 0] >> 3) + block % wide,
                        (keys[index, 1] >> 3) + block // wide % wide,
                        (keys[index, 2] >> 3) + block // (wide * wide),
                    )
                )
                if slot < 0:
                    return index if slot == _NO_ROOM else -1
                place: cython.longlong
                for place in range(first, first + many):
                    self._values[slot, place] = values[index]
        return sides.shape[0]

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _collect(self, points: cython.const[cython.float][:, ::1]) -> cython.longlong:
        """Write the voxels of the points to ``_ends``, each once; return their number."""
        factor: cython.double = 1.0 / self.resolution
        mask: cython.longlong = self._set.shape[0] - 1
        count: cython.longlong = 0
        last: cython.longlong = -1
        index: cython.Py_ssize_t
        for index in range(points.shape[0]):
            x: cython.longlong = _key(points[index, 0], factor)
            y: cython.longlong = _key(points[index, 1], factor)
            z: cython.longlong = _key(points[index, 2], factor)
            if x < 0 or y < 0 or z < 0:
                continue
            key: cython.longlong = x | y << 16 | z << 32
            if key == last:
                continue
            last = key
            at: cython.longlong = _hash(key) & mask
            while self._set[at] >= 0 and self._set[at] != key:
                at = (at + 1) & mask
            if self._set[at] < 0:
                self._set[at] = key
                self._ends[count] = key
                count += 1
        return count

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _mark(self, count: cython.longlong, farthest: cython.double) -> cython.bint:
        """Mark the hit voxels, then those that rays pass without a hit; return False if the capacity must grow first.

        Voxels for which a full map has no block are counted in ``left_out``.
        """
        index: cython.longlong
        for index in range(count):
            key: cython.longlong = self._ends[index]
            x: cython.longlong = key & 0xFFFF
            y: cython.longlong = key >> 16 & 0xFFFF
            z: cython.longlong = key >> 32
            if self._distance(x, y, z) > farthest:
                continue
            slot: cython.longlong = self._slot(_packed(x >> 3, y >> 3, z >> 3))
            if slot == _NO_ROOM:
                return False
            if slot < 0:
                self.left_out += 1
                continue
            self._touch(slot)
            self._marks[slot, _spread(x) | _spread(y) << 1 | _spread(z) << 2] = 2
        for index in range(count):
            key = self._ends[index]
            if not self._ray(key & 0xFFFF, key >> 16 & 0xFFFF, key >> 32, farthest):
                return False
        return True

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _touch(self, slot: cython.longlong) -> cython.void:
        if not self._is_touched[slot]:
            self._is_touched[slot] = 1
            self._touched[self._marked] = cython.cast(cython.int, slot)
            self._marked += 1

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _middle(self, key: cython.longlong) -> cython.float:
        return cython.cast(cython.float, (key - _MIDDLE + 0.5) * self.resolution)

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _distance(self, x: cython.longlong, y: cython.longlong, z: cython.longlong) -> cython.double:
        dx: cython.float = self._middle(x) - self._ox
        dy: cython.float = self._middle(y) - self._oy
        dz: cython.float = self._middle(z) - self._oz
        square: cython.float = dx * dx + dy * dy + dz * dz
        return sqrt(square)

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _ray(
        self, to_x: cython.longlong, to_y: cython.longlong, to_z: cython.longlong, farthest: cython.double
    ) -> cython.bint:
        """Mark the voxels on the ray to a voxel's center, within range and without the last one.

        Returns False if the capacity must grow first.
        """
        factor: cython.double = 1.0 / self.resolution
        dx: cython.float = self._middle(to_x) - self._ox
        dy: cython.float = self._middle(to_y) - self._oy
        dz: cython.float = self._middle(to_z) - self._oz
        far: cython.double = self._distance(to_x, to_y, to_z)
        length: cython.float = cython.cast(cython.float, far)
        if far > farthest:
            reach: cython.float = cython.cast(cython.float, farthest)
            end_x: cython.float = self._ox + dx / length * reach
            end_y: cython.float = self._oy + dy / length * reach
            end_z: cython.float = self._oz + dz / length * reach
            to_x = _key(end_x, factor)
            to_y = _key(end_y, factor)
            to_z = _key(end_z, factor)
            if to_x < 0 or to_y < 0 or to_z < 0:
                return True
            dx = end_x - self._ox
            dy = end_y - self._oy
            dz = end_z - self._oz
            square: cython.float = dx * dx + dy * dy + dz * dz
            length = cython.cast(cython.float, sqrt(square))
        x: cython.longlong = _key(self._ox, factor)
        y: cython.longlong = _key(self._oy, factor)
        z: cython.longlong = _key(self._oz, factor)
        if (x == to_x and y == to_y and z == to_z) or not length > 0.0:
            return True
        dx = dx / length
        dy = dy / length
        dz = dz / length
        step_x: cython.longlong = 1 if dx > 0.0 else -1
        step_y: cython.longlong = 1 if dy > 0.0 else -1
        step_z: cython.longlong = 1 if dz > 0.0 else -1
        next_x: cython.double = self._border(x, step_x, dx, self._ox)
        next_y: cython.double = self._border(y, step_y, dy, self._oy)
        next_z: cython.double = self._border(z, step_z, dz, self._oz)
        each_x: cython.double = self.resolution / abs(dx) if dx != 0.0 else _INFINITY
        each_y: cython.double = self.resolution / abs(dy) if dy != 0.0 else _INFINITY
        each_z: cython.double = self.resolution / abs(dz) if dz != 0.0 else _INFINITY
        place: cython.longlong = _spread(x) | _spread(y) << 1 | _spread(z) << 2
        slot: cython.longlong = self._slot(_packed(x >> 3, y >> 3, z >> 3))
        while True:
            if slot >= 0:
                if not self._marks[slot, place]:
                    self._touch(slot)
                    self._marks[slot, place] = 1
            elif slot == _NO_ROOM:
                return False
            else:
                self.left_out += 1
            crossed: cython.bint
            if next_x < next_y and next_x < next_z:
                x += step_x
                next_x += each_x
                place = (place & ~0o111) | _spread(x)
                crossed = (x & 7) == (0 if step_x > 0 else 7)
            elif next_x >= next_y and next_y < next_z:
                y += step_y
                next_y += each_y
                place = (place & ~0o222) | _spread(y) << 1
                crossed = (y & 7) == (0 if step_y > 0 else 7)
            else:
                z += step_z
                next_z += each_z
                place = (place & ~0o444) | _spread(z) << 2
                crossed = (z & 7) == (0 if step_z > 0 else 7)
            if (x == to_x and y == to_y and z == to_z) or min(next_x, min(next_y, next_z)) > length:
                return True
            if crossed:
                slot = self._slot(_packed(x >> 3, y >> 3, z >> 3))

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _border(
        self, key: cython.longlong, step: cython.longlong, along: cython.float, origin: cython.float
    ) -> cython.double:
        """Return the meters of a ray until it leaves its first voxel along one axis."""
        if along == 0.0:
            return _INFINITY
        half: cython.float = cython.cast(cython.float, step * self.resolution * 0.5)
        border: cython.double = (key - _MIDDLE + 0.5) * self.resolution + half
        return (border - origin) / along

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _update(self, now: cython.float) -> cython.longlong:
        """Change the odds of marked voxels, and remove the marks; return the number of marked voxels."""
        count: cython.longlong = 0
        index: cython.longlong
        place: cython.longlong
        for index in range(self._marked):
            slot: cython.longlong = self._touched[index]
            self._is_touched[slot] = 0
            for place in range(_CELLS):
                mark: cython.uchar = self._marks[slot, place]
                if mark:
                    count += 1
                    value: cython.float = self._values[slot, place]
                    value = (_HIT if mark == 2 else _MISS) + (value if value == value else 0.0)
                    self._values[slot, place] = min(max(value, _LEAST), _MOST)
                    self._marks[slot, place] = 0
                    if mark == 2:
                        self._seen[slot, place] = now
        self._marked = 0
        return count


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _packed(x: cython.longlong, y: cython.longlong, z: cython.longlong) -> cython.longlong:
    return x | y << 13 | z << 26


def within(places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the positions in a block, (n, 3) voxels, of indices in Morton order."""
    places = np.asarray(places, np.int64)
    return np.stack([(places >> a & 1) | (places >> a + 2 & 2) | (places >> a + 4 & 4) for a in range(3)], -1)
