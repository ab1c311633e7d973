"""Finds the messages among the records of a chunk of MCAP, or of a bag of ROS 1. A kernel, see `bridge.kernels`.

For each message a row of a table is filled: its channel or connection, its log and publish times in nanoseconds, and
the first byte and the size of its data. Each function continues at byte ``at`` and row ``filled`` up to the first
record that is not a valid message, which the caller has to handle; it returns the byte of that record, or the chunk's
size, and the number of filled rows. Every read is checked in advance.
"""

from __future__ import annotations

import cython
import numpy as np
from numpy.typing import NDArray

COLUMNS = 5

_MCAP_MESSAGE = cython.declare(cython.longlong, 5)
_MCAP_HEAD = cython.declare(cython.longlong, 9)
_MCAP_BODY = cython.declare(cython.longlong, 22)
_ROS1_HEAD = cython.declare(cython.longlong, 42)
_ROS1_MESSAGE = cython.declare(cython.longlong, 2)


def new_table(size: int) -> NDArray[np.uint64]:
    """Return a table with room for the messages of a chunk of ``size`` bytes."""
    return np.empty((size // (_MCAP_HEAD + _MCAP_BODY) + 1, COLUMNS), np.uint64)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _load(source: cython.p_const_uchar, at: cython.longlong, count: cython.longlong) -> cython.ulonglong:
    """Return the little-endian number in ``count`` bytes."""
    value: cython.ulonglong = 0
    k: cython.longlong
    for k in range(count):
        byte: cython.ulonglong = source[at + k]
        value |= byte << (8 * k)
    return value


@cython.boundscheck(False)
@cython.wraparound(False)
def split_mcap(
    data: bytes, table: cython.ulonglong[:, ::1], at: cython.longlong, filled: cython.longlong
) -> tuple[int, int]:
    """Find the messages in a chunk of MCAP (https://mcap.dev/spec)."""
    source: cython.p_const_uchar = data
    size: cython.longlong = len(data)
    room: cython.longlong = table.shape[0]
    while filled < room and at + _MCAP_HEAD + _MCAP_BODY <= size and source[at] == _MCAP_MESSAGE:
        length: cython.longlong = _load(source, at + 1, 8)  # negative if it is out of range
        body: cython.longlong = at + _MCAP_HEAD
        if length < _MCAP_BODY or length > size - body:
            break
        table[filled, 0] = _load(source, body, 2)
        table[filled, 1] = _load(source, body + 6, 8)
        table[filled, 2] = _load(source, body + 14, 8)
        table[filled, 3] = body + _MCAP_BODY
        table[filled, 4] = length - _MCAP_BODY
        filled += 1
        at = body + length
    return at, filled


@cython.boundscheck(False)
@cython.wraparound(False)
def split_ros1(
    data: bytes, table: cython.ulonglong[:, ::1], at: cython.longlong, filled: cython.longlong
) -> tuple[int, int]:
    """Find the messages in a chunk of ROS 1 (http://wiki.ros.org/Bags/Format/2.0); headers with more fields end it."""
    source: cython.p_const_uchar = data
    size: cython.longlong = len(data)
    room: cython.longlong = table.shape[0]
    while filled < room and at + _ROS1_HEAD + 4 <= size:
        head: cython.longlong = _load(source, at, 4)
        connection: cython.longlong = -1
        kind: cython.longlong = -1
        time: cython.longlong = -1
        field: cython.longlong = at + 4
        body: cython.longlong = at + _ROS1_HEAD + 4
        while head == _ROS1_HEAD - 4 and field + 8 <= body - 4:  # the shortest known field has 8 bytes
            length: cython.longlong = _load(source, field, 4)
            name: cython.ulonglong = _load(source, field + 4, 4)
            field += 4 + length
            if field > body - 4:
                break
            if length == 4 and name & 0xFFFFFF == 0x3D706F:  # op=
                kind = name >> 24
            elif length == 9 and name == 0x6E6E6F63 and source[field - 5] == 61:  # conn=
                connection = _load(source, field - 4, 4)
            elif length == 13 and name == 0x656D6974 and source[field - 9] == 61:  # time=
                time = _load(source, field - 8, 4) * 1000000000 + _load(source, field - 4, 4)
        count: cython.longlong = _load(source, body - 4, 4)
        if field != body - 4 or kind != _ROS1_MESSAGE or connection < 0 or time < 0 or count > size - body:
            break
        table[filled, 0] = connection
        table[filled, 1] = table[filled, 2] = time
        table[filled, 3] = body
        table[filled, 4] = count
        filled += 1
        at = body + count
    return at, filled
