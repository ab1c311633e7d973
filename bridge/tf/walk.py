"""Lookups on the buffer's arrays, for compiled functions: one frame at a time, then the way through the tree.

The rules are those of tf2 0.7.6 (github.com/ros/geometry2: buffer_core.cpp walkToTopParent and getLatestCommonTime,
cache.cpp findClosest and interpolate), so that answers and errors are the same.
"""

from __future__ import annotations

from typing import Any

from bridge.tf.layout import (
    BOUND,
    CAPACITY,
    COLUMNS,
    CONNECTIVITY,
    COUNT,
    DONE,
    EMPTY,
    EXTRAPOLATION,
    FIRST,
    FUTURE,
    KEY,
    KIND,
    LOOP,
    MAX_DEPTH,
    NONE,
    PAST,
    POSE,
    SINGLE,
    STAMP,
    START,
    STATIC,
    TROUBLE,
)
from bridge.tf.memory import floats, words
from bridge.tf.rotation import Quaternion, Vector, inverse, jit, product, rotate, slerp

Found = tuple[int, Vector, Quaternion]
"""The number of the parent, 0 for nothing, and the frame's pose in it."""

_NEVER = 1 << 62


@jit
def place(row: Any, at: int) -> int:
    """Where a frame's sample is, 0 the oldest."""
    return int(row[START] + ((row[FIRST] + at) & (row[CAPACITY] - 1)))


@jit
def row_of(table: int, frame: int) -> Any:
    """A frame's row."""
    return words(table + 8 * COLUMNS * frame)


@jit
def _pose(poses: int, at: int) -> tuple[Vector, Quaternion]:
    p = floats(poses + 8 * POSE * at)
    return (p[0], p[1], p[2]), (p[3], p[4], p[5], p[6])


@jit
def _between(keys: int, poses: int, one: int, two: int, time: int) -> tuple[Vector, Quaternion]:
    """The pose at a time, on the line through two samples; before, between or after them."""
    k = words(keys)
    ratio = float(time - k[KEY * one]) / float(k[KEY * two] - k[KEY * one])
    v1, q1 = _pose(poses, one)
    v2, q2 = _pose(poses, two)
    rest = 1.0 - ratio
    moved = (rest * v1[0] + ratio * v2[0], rest * v1[1] + ratio * v2[1], rest * v1[2] + ratio * v2[2])
    return moved, slerp(q1, q2, ratio)


@jit
def _beyond(row: Any, keys: int, poses: int, time: int, ahead: int) -> Found:
    """The pose ``ahead`` ns outside of the history: the frame goes on moving as it did over as long a time.

    So errors of two samples that are close to each other do not grow without bound.
    """
    k = words(keys)
    count = row[COUNT]
    step = 1 if ahead < 0 else -1
    edge = 0 if ahead < 0 else count - 1
    end = place(row, edge)
    other = end
    for n in range(1, count):
        at = place(row, edge + step * n)
        if k[KEY * at + 1] != k[KEY * end + 1]:
            break
        other = at
        if abs(k[KEY * at] - k[KEY * end]) >= abs(ahead):
            break
    if other == end:
        moved, turned = _pose(poses, end)
    else:
        moved, turned = _between(keys, poses, end, other, time)
    return k[KEY * end + 1], moved, turned


@jit
def _at(row: Any, keys: int, poses: int, time: int, horizon: int, facts: Any) -> Found:
    """A frame at a time; 0 is the newest. Facts say why there is nothing."""
    k = words(keys)
    count = row[COUNT]
    nothing = (0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    if count == 0:
        facts[TROUBLE] = EMPTY
        return nothing
    newest = place(row, count - 1)
    if row[KIND] == STATIC or time == 0 or time == k[KEY * newest]:
        moved, turned = _pose(poses, newest)
        return k[KEY * newest + 1], moved, turned
    oldest = place(row, 0)
    if time == k[KEY * oldest]:
        moved, turned = _pose(poses, oldest)
        return k[KEY * oldest + 1], moved, turned
    late, early = time - k[KEY * newest], time - k[KEY * oldest]
    if late > 0 or early < 0:
        beyond = late if late > 0 else early
        if count > 1 and abs(beyond) <= horizon:
            return _beyond(row, keys, poses, time, beyond)
        facts[BOUND] = k[KEY * newest] if late > 0 else k[KEY * oldest]
        facts[TROUBLE] = SINGLE if count == 1 else FUTURE if late > 0 else PAST
        return nothing
    low, high = 0, count - 1
    while high - low > 1:
        middle = (low + high) >> 1
        if k[KEY * place(row, middle)] <= time:
            low = middle
        else:
            high = middle
    one, two = place(row, low), place(row, high)
    if k[KEY * one] == time or k[KEY * one + 1] != k[KEY * two + 1]:
        moved, turned = _pose(poses, one)
    else:
        moved, turned = _between(keys, poses, one, two, time)
    return k[KEY * one + 1], moved, turned


@jit
def _latest(table: int, keys: int, frame: int) -> tuple[int, int]:
    """A frame's newest parent, 0 for none, and its stamp, 0 where it holds for all times."""
    row = row_of(table, frame)
    if row[COUNT] == 0:
        return 0, 0
    k = words(keys)
    at = KEY * place(row, row[COUNT] - 1)
    return k[at + 1], 0 if row[KIND] == STATIC else k[at]


@jit
def _earlier(common: int, stamp: int) -> int:
    return min(common, stamp) if stamp != 0 else common


@jit
def _known(common: int) -> int:
    return 0 if common == _NEVER else common


@jit
def _meets(table: int, keys: int, source: int, last: int, parent: int) -> int:
    """The time up to which the way from ``source`` to ``parent`` is known, -1 where ``parent`` is not above it.

    Args:
        table: address of the table.
        keys: address of the keys.
        source: the frame.
        last: frames of its way up.
        parent: the frame that is looked for on it.
    """
    common, frame = _NEVER, source
    for _ in range(last):
        above, stamp = _latest(table, keys, frame)
        common = _earlier(common, stamp)
        if above == parent:
            return common
        frame = above
    return -1


@jit
def common_time(table: int, keys: int, target: int, source: int) -> tuple[int, int]:
    """The newest time at which both frames are known, 0 for any time; as (answer, time)."""
    common, frame, depth = _NEVER, source, 0
    while frame != 0:
        parent, stamp = _latest(table, keys, frame)
        if parent == 0:
            break
        common = _earlier(common, stamp)
        frame = parent
        depth += 1
        if frame == target:
            return DONE, _known(common)
        if depth > MAX_DEPTH:
            return LOOP, 0
    last, common, frame, depth = depth, _NEVER, target, 0
    while True:
        parent, stamp = _latest(table, keys, frame)
        if parent == 0:
            return CONNECTIVITY, 0
        common = _earlier(common, stamp)
        met = _meets(table, keys, source, last, parent)
        if met >= 0:
            return DONE, _known(min(common, met))
        frame = parent
        depth += 1
        if frame == source:
            return DONE, _known(common)
        if depth > MAX_DEPTH:
            return LOOP, 0


@jit
def walk(
    table: int, keys: int, poses: int, target: int, source: int, time: int, horizon: int, facts: Any
) -> tuple[int, Vector, Quaternion]:
    """The pose of ``source`` in ``target``, two different frames.

    Args:
        table: address of the table.
        keys: address of the keys.
        poses: address of the poses.
        target: frame.
        source: frame.
        time: ns, 0 for the newest time at which both are known.
        horizon: ns that may be extrapolated.
        facts: pointer to `FACTS` numbers that are written.

    Returns:
        `DONE` or why not, translation in m, rotation.
    """
    zero, unit = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    if time == 0:
        answer, time = common_time(table, keys, target, source)
        if answer != DONE:
            return answer, zero, unit
    facts[STAMP] = time
    v1, q1, frame, depth, stopped = zero, unit, source, 0, False
    while frame != target:
        row = row_of(table, frame)
        if row[KIND] == NONE:
            break
        parent, v, q = _at(row, keys, poses, time, horizon, facts)
        if parent == 0:
            stopped = True
            break
        turned = rotate(q, v1)
        v1 = (turned[0] + v[0], turned[1] + v[1], turned[2] + v[2])
        q1 = product(q, q1)
        frame = parent
        depth += 1
        if depth > MAX_DEPTH:
            return LOOP, zero, unit
    if frame == target:
        return DONE, v1, q1
    top, bound, trouble = frame, facts[BOUND], facts[TROUBLE]
    v2, q2, frame, depth = zero, unit, target, 0
    while frame != top and frame != source:
        row = row_of(table, frame)
        if row[KIND] == NONE:
            break
        parent, v, q = _at(row, keys, poses, time, horizon, facts)
        if parent == 0:
            return EXTRAPOLATION, zero, unit
        turned = rotate(q, v2)
        v2 = (turned[0] + v[0], turned[1] + v[1], turned[2] + v[2])
        q2 = product(q, q2)
        frame = parent
        depth += 1
        if depth > MAX_DEPTH:
            return LOOP, zero, unit
    back = inverse(q2)
    if frame == source:
        return DONE, rotate(back, (-v2[0], -v2[1], -v2[2])), back
    if frame != top:
        facts[BOUND], facts[TROUBLE] = bound, trouble
        return EXTRAPOLATION if stopped else CONNECTIVITY, zero, unit
    one, two = rotate(back, v1), rotate(back, (-v2[0], -v2[1], -v2[2]))
    return DONE, (one[0] + two[0], one[1] + two[1], one[2] + two[2]), product(back, q1)
