# cython: boundscheck=False, wraparound=False, initializedcheck=False
# Indices in a block are below 512, and a block has at most as many leaves as known voxels.
"""Leaves of an octree from blocks of voxels (`navigation.algorithms.voxel_map`)."""

from __future__ import annotations

import cython
import numpy as np
from numpy.typing import NDArray

_CELLS = cython.declare(cython.longlong, 512)
_BITS = 13  # bits of a block's key along one axis


def leaves(
    blocks: NDArray[np.int64], values: NDArray[np.float32]
) -> tuple[NDArray[np.uint64], NDArray[np.uint8], NDArray[np.float32]]:
    """Return the leaves of the tree within blocks; eight equal leaves of one parent are merged, level by level.

    Args:
        blocks: (count, 3) keys of blocks.
        values: (count, 512) log odds of their voxels in Morton order; NaN is unknown.

    Returns:
        (n,) Morton codes of each leaf's lowest voxel, 48 bits (x lowest), ascending; (n,) depths, from 13
        for a block to 16 for a voxel; (n,) log odds. Raises `ValueError` if blocks do not have 512 values each.
    """
    if values.shape != (len(blocks), 512):
        raise ValueError(f"{len(blocks)} blocks must have 512 values each, not {values.shape}")
    bits = np.arange(_BITS, dtype=np.int64)
    codes = np.zeros(len(blocks), np.int64)
    for axis in range(3):
        codes += ((blocks[:, axis, None] >> bits & 1) << 3 * bits + axis).sum(-1)
    size = int((~np.isnan(values)).sum())
    places, depths, odds = np.empty(size, np.int64), np.empty(size, np.uint8), np.empty(size, np.float32)
    count = _leaves(np.argsort(codes), codes, np.ascontiguousarray(values), places, depths, odds)
    return places[:count].astype(np.uint64), depths[:count], odds[:count]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _leaves(
    order: cython.const[cython.longlong][::1],
    blocks: cython.const[cython.longlong][::1],
    values: cython.const[cython.float][:, ::1],
    codes: cython.longlong[::1],
    depths: cython.uchar[::1],
    odds: cython.float[::1],
) -> cython.longlong:
    """Write the leaves of all blocks in that order to the arrays; return their number."""
    count: cython.longlong = 0
    index: cython.longlong
    for index in range(order.shape[0]):
        slot: cython.longlong = order[index]
        place: cython.longlong = 0
        while place < _CELLS:
            size: cython.longlong = _alike(values, slot, place)
            value: cython.float = values[slot, place]
            if value == value:
                codes[count] = blocks[slot] << 9 | place
                depths[count] = 16 if size == 1 else 15 if size == 8 else 14 if size == 64 else 13
                odds[count] = value
                count += 1
            place += size
    return count


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _alike(
    values: cython.const[cython.float][:, ::1], slot: cython.longlong, place: cython.longlong
) -> cython.longlong:
    """Return the number of voxels in the largest cube that begins at an index and has equal voxels."""
    value: cython.float = values[slot, place]
    size: cython.longlong = 1
    while value == value and size < _CELLS and place % (8 * size) == 0:
        other: cython.longlong
        for other in range(place + size, place + 8 * size):
            if values[slot, other] != value:
                return size
        size *= 8
    return size
