"""What the buffer calls: compiled once, kept in numba's cache on disk.

Addresses are plain integers, since numba takes an array apart at each call. Nothing here checks an address, a frame or
the room that is written to: `bridge.tf.history` does, and its caller's lock keeps the arrays where they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from bridge.messages.cache import compiled, entry_point
from bridge.tf.layout import (
    CAPACITY,
    COUNT,
    DENORMALIZED,
    DONE,
    FIRST,
    FULL,
    KEY,
    KIND,
    NAN,
    OLD,
    POSE,
    REPEATED,
    STAMP,
    START,
    STATIC,
    TOLERANCE,
)
from bridge.tf.memory import floats, words
from bridge.tf.rotation import Quaternion, Vector, jit, normalized, of_matrix, product, rotate
from bridge.tf.walk import place, row_of, walk

_WORD, _FLOAT = numba.int64, numba.float64
_NAMES = ("kernels.py", "layout.py", "memory.py", "rotation.py", "walk.py")
_SOURCES = [Path(__file__).with_name(name) for name in _NAMES]


@jit
def _write(out: int, v: Vector, q: Quaternion) -> None:
    o = floats(out)
    o[0], o[1], o[2] = v
    o[3], o[4], o[5], o[6] = q


@jit
def _flaw(x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float) -> int:
    if math.isnan(x) or math.isnan(y) or math.isnan(z):
        return NAN
    if math.isnan(qx) or math.isnan(qy) or math.isnan(qz) or math.isnan(qw):
        return NAN
    return DONE if abs(qw * qw + qx * qx + qy * qy + qz * qz - 1.0) < TOLERANCE else DENORMALIZED


@jit
def _move(keys: int, poses: int, one: int, two: int) -> None:
    """Copy a sample."""
    k, p = words(keys), floats(poses)
    k[KEY * two] = k[KEY * one]
    k[KEY * two + 1] = k[KEY * one + 1]
    for n in range(POSE):
        p[POSE * two + n] = p[POSE * one + n]


def _pose_flaw(x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float) -> int:
    """What is wrong with a pose: `DONE`, `NAN` or `DENORMALIZED`."""
    return _flaw(x, y, z, qx, qy, qz, qw)


@jit
def _put(
    table: int,
    keys: int,
    poses: int,
    frame: int,
    parent: int,
    stamp: int,
    history: int,
    force: int,
    x: float,
    y: float,
    z: float,
    qx: float,
    qy: float,
    qz: float,
    qw: float,
) -> int:
    """Put a sample in its place by time.

    Args:
        table: address of the table.
        keys: address of the keys.
        poses: address of the poses.
        frame: the frame, whose kind and ring are set.
        parent: number of its parent.
        stamp: ns.
        history: ns that are kept before the newest sample.
        force: not 0: where the ring is full, its oldest sample goes.
        x: translation in m.
        y: translation.
        z: translation.
        qx: rotation.
        qy: rotation.
        qz: rotation.
        qw: rotation.

    Returns:
        `DONE`, or why nothing was done.
    """
    flaw = _flaw(x, y, z, qx, qy, qz, qw)
    if flaw != DONE:
        return flaw
    row = row_of(table, frame)
    k = words(keys)
    count = row[COUNT]
    if row[KIND] == STATIC:
        count = 0
    if count > 0:
        newest = k[KEY * place(row, count - 1)]
        if newest > stamp + history:
            return OLD
        place_after = count
        while place_after > 0 and k[KEY * place(row, place_after - 1)] > stamp:
            place_after -= 1
        if place_after > 0 and k[KEY * place(row, place_after - 1)] == stamp:
            return REPEATED
        latest = max(newest, stamp)
        first, kept = row[FIRST], count
        while kept > 0 and k[KEY * (row[START] + (first & (row[CAPACITY] - 1)))] + history < latest:
            first += 1
            kept -= 1
        if kept == row[CAPACITY]:
            if force == 0:
                return FULL
            first += 1
            kept -= 1
        row[FIRST] = first & (row[CAPACITY] - 1)
        at = max(place_after - (count - kept), 0)
        for n in range(kept, at, -1):
            _move(keys, poses, place(row, n - 1), place(row, n))
        count = kept
    else:
        at = 0
        row[FIRST] = 0
    sample = place(row, at)
    k[KEY * sample] = stamp
    k[KEY * sample + 1] = parent
    _write(poses + 8 * POSE * sample, (x, y, z), (qx, qy, qz, qw))
    row[COUNT] = count + 1
    return DONE


def _insert(
    table: int,
    keys: int,
    poses: int,
    frame: int,
    parent: int,
    stamp: int,
    history: int,
    force: int,
    x: float,
    y: float,
    z: float,
    qx: float,
    qy: float,
    qz: float,
    qw: float,
) -> int:
    """`_put`."""
    return _put(table, keys, poses, frame, parent, stamp, history, force, x, y, z, qx, qy, qz, qw)


def _insert_at(
    table: int, keys: int, poses: int, frame: int, parent: int, stamp: int, history: int, force: int, pose: int
) -> int:
    """`_put` of the pose at an address."""
    p = floats(pose)
    return _put(table, keys, poses, frame, parent, stamp, history, force, p[0], p[1], p[2], p[3], p[4], p[5], p[6])


def _move_ring(table: int, keys: int, poses: int, frame: int, start: int, capacity: int) -> None:
    """Give a frame's samples another place."""
    row = row_of(table, frame)
    for n in range(row[COUNT]):
        _move(keys, poses, place(row, n), start + n)
    row[START], row[CAPACITY], row[FIRST] = start, capacity, 0


def _lookup(
    table: int, keys: int, poses: int, target: int, source: int, time: int, horizon: int, out: int, facts: int
) -> int:
    """`bridge.tf.walk.walk`, with the pose written to ``out``."""
    answer, v, q = walk(table, keys, poses, target, source, time, horizon, words(facts))
    if answer == DONE:
        _write(out, v, q)
    return answer


def _lookup_many(
    table: int,
    keys: int,
    poses: int,
    target: int,
    source: int,
    stamps: int,
    count: int,
    horizon: int,
    out: int,
    answers: int,
    facts: int,
) -> None:
    """A lookup for each of ``count`` stamps; each has `POSE` numbers in ``out`` and one in ``answers``."""
    times, said, told = words(stamps), words(answers), words(facts)
    for n in range(count):
        answer, v, q = walk(table, keys, poses, target, source, times[n], horizon, told)
        said[n] = answer
        if answer == DONE:
            times[n] = told[STAMP]
            _write(out + 8 * POSE * n, v, q)


def _compose(first: int, then: int, count: int) -> None:
    """Put one pose behind each of ``count``, in place, as tf2 does with a fixed frame: normalised, as matrices are."""
    for n in range(count):
        at = first + 8 * POSE * n
        a, b = floats(at), floats(then)
        q = normalized((b[3], b[4], b[5], b[6]))
        v = rotate(q, (a[0], a[1], a[2]))
        turned = normalized(product(q, normalized((a[3], a[4], a[5], a[6]))))
        _write(at, (v[0] + b[0], v[1] + b[1], v[2] + b[2]), of_matrix(turned))


def _compile(function: Callable[..., Any], signature: Any, **options: Any) -> Callable[..., Any]:
    return entry_point(compiled(function, signature, _SOURCES, **options), signature)


pose_flaw = _compile(_pose_flaw, _WORD(*[_FLOAT] * POSE))
insert_at = _compile(_insert_at, _WORD(*[_WORD] * 9))
insert = _compile(_insert, _WORD(*[_WORD] * 8, *[_FLOAT] * POSE))
move_ring = _compile(_move_ring, numba.void(*[_WORD] * 6))
lookup = _compile(_lookup, _WORD(*[_WORD] * 9))
lookup_many = _compile(_lookup_many, numba.void(*[_WORD] * 11), nogil=True)
compose = _compile(_compose, numba.void(*[_WORD] * 3))
