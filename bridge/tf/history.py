# cython: boundscheck=False, wraparound=False, initializedcheck=False, cdivision=True
"""All frames' histories, and lookups in them: a kernel, compiled by Cython (`bridge.kernels`).

The rules are those of tf2 0.7.6 (github.com/ros/geometry2: buffer_core.cpp walkToTopParent and getLatestCommonTime,
cache.cpp findClosest and interpolate), so that results and errors are the same. Rotations are not normalized before
use, as in tf2.

The samples of each frame are a ring within the arrays of all samples. The compiled code does not check indices, because
only the history can access the arrays, each ring lies within them, each sample's parent is a frame with a row, and
frame numbers from callers are checked on entry.
"""

from __future__ import annotations

import struct
from typing import Any, TypeAlias

import cython
import numpy as np
from cython.cimports.libc.math import acos, isnan, sin, sqrt
from numpy.typing import NDArray

from bridge.tf import layout
from bridge.tf.transform import Quaternion as Rotation
from bridge.tf.transform import Vector as Translation

if cython.compiled:
    from cython.cimports.libc.string import memcpy

SMALLEST = 64
GROWTH = 4
LARGEST = 1 << 14
"""Maximum number of samples of a frame: 10 s at 1.6 kHz. Beyond this, the oldest are dropped."""

Found = tuple[Translation, Rotation, int]
"""A pose, and its stamp in ns."""

Int: TypeAlias = cython.typedef(cython.longlong)
Vector: TypeAlias = cython.struct(x=cython.double, y=cython.double, z=cython.double)
Quaternion: TypeAlias = cython.struct(x=cython.double, y=cython.double, z=cython.double, w=cython.double)
Pose: TypeAlias = cython.struct(v=Vector, q=Quaternion)
Sample: TypeAlias = cython.struct(parent=Int, pose=Pose)
"""The parent's number, 0 if there is no sample, and the frame's pose in it."""
Newest: TypeAlias = cython.struct(parent=Int, stamp=Int)
"""A frame's newest parent, 0 for none, and its stamp, 0 if it is valid at all times."""
Way: TypeAlias = cython.struct(end=Int, frame=Int, pose=Pose)
"""How a walk up the tree ended, the frame where it ended, and the pose of the walk's first frame in that frame."""

# C variables, read without the GIL
_NONE = cython.declare(Int, layout.NONE)
_TIMED = cython.declare(Int, layout.TIMED)
_STATIC = cython.declare(Int, layout.STATIC)
_DONE = cython.declare(Int, layout.DONE)
_LOOP = cython.declare(Int, layout.LOOP)
_CONNECTIVITY = cython.declare(Int, layout.CONNECTIVITY)
_EXTRAPOLATION = cython.declare(Int, layout.EXTRAPOLATION)
_EMPTY = cython.declare(Int, layout.EMPTY)
_SINGLE = cython.declare(Int, layout.SINGLE)
_FUTURE = cython.declare(Int, layout.FUTURE)
_PAST = cython.declare(Int, layout.PAST)
_NAN = cython.declare(Int, layout.NAN)
_DENORMALIZED = cython.declare(Int, layout.DENORMALIZED)
_OLD = cython.declare(Int, layout.OLD)
_REPEATED = cython.declare(Int, layout.REPEATED)
_FULL = cython.declare(Int, layout.FULL)
_MAX_DEPTH = cython.declare(Int, layout.MAX_DEPTH)
_TOLERANCE = cython.declare(cython.double, layout.TOLERANCE)
_LAST_STAMP = cython.declare(Int, layout.LAST_STAMP)
_NEVER = cython.declare(Int, 1 << 62)
# how a walk up the tree can end
_THERE = cython.declare(Int, 0)
_ROOT = cython.declare(Int, 1)
_GAP = cython.declare(Int, 2)
_ENDLESS = cython.declare(Int, 3)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the product, which rotates by ``b`` first, then by ``a``."""
    return Quaternion(
        a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
        a.w * b.y + a.y * b.w + a.z * b.x - a.x * b.z,
        a.w * b.z + a.z * b.w + a.x * b.y - a.y * b.x,
        a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
    )


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _inverse(q: Quaternion) -> Quaternion:
    return Quaternion(-q.x, -q.y, -q.z, q.w)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _rotate(q: Quaternion, v: Vector) -> Vector:
    """Rotate a vector; the result is scaled by the square of the quaternion's length."""
    turned: Quaternion = _product(_product(q, Quaternion(v.x, v.y, v.z, 0.0)), _inverse(q))
    return Vector(turned.x, turned.y, turned.z)


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _behind(a: Pose, b: Pose) -> Pose:
    """Transform pose ``a``, which is given in ``b``, to the frame in which ``b`` is given."""
    turned: Vector = _rotate(b.q, a.v)
    return Pose(Vector(turned.x + b.v.x, turned.y + b.v.y, turned.z + b.v.z), _product(b.q, a.q))


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _back(p: Pose) -> Pose:
    """Return the inverse pose."""
    q: Quaternion = _inverse(p.q)
    return Pose(_rotate(q, Vector(-p.v.x, -p.v.y, -p.v.z)), q)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _unit() -> Pose:
    return Pose(Vector(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))


@cython.cfunc
@cython.inline
@cython.nogil
@cython.exceptval(check=False)
def _slerp(a: Quaternion, b: Quaternion, ratio: cython.double) -> Quaternion:
    """Interpolate on the shorter arc from ``a`` (ratio 0) to ``b`` (1); beyond them, continue at the same rate."""
    dot: cython.double = a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w
    lengths: cython.double = (a.x * a.x + a.y * a.y + a.z * a.z + a.w * a.w) * (
        b.x * b.x + b.y * b.y + b.z * b.z + b.w * b.w
    )
    sign: cython.double = -1.0 if dot < 0.0 else 1.0
    cosine: cython.double = abs(dot) / sqrt(lengths)
    # rounding may give a cosine slightly above 1, for which tf2 returns NaN
    angle: cython.double = acos(min(cosine, 1.0))
    if angle == 0.0:
        return a
    whole: cython.double = sin(angle)
    weight_a: cython.double = sin((1.0 - ratio) * angle) / whole
    weight_b: cython.double = sign * sin(ratio * angle) / whole
    return Quaternion(
        weight_a * a.x + weight_b * b.x,
        weight_a * a.y + weight_b * b.y,
        weight_a * a.z + weight_b * b.z,
        weight_a * a.w + weight_b * b.w,
    )


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _normalized(q: Quaternion) -> Quaternion:
    length: cython.double = sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    return Quaternion(q.x / length, q.y / length, q.z / length, q.w / length)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _of_matrix(q: Quaternion) -> Quaternion:
    """Return ``q`` or ``-q``: as in tf2 for a matrix, w or (if abs(w) <= 0.5) the largest of x, y, z is positive."""
    x: cython.double = abs(q.x)
    y: cython.double = abs(q.y)
    z: cython.double = abs(q.z)
    chosen: cython.double
    if 4.0 * q.w * q.w > 1.0:
        chosen = q.w
    elif x >= y and x >= z:
        chosen = q.x
    else:
        chosen = q.y if y >= z else q.z
    if chosen < 0.0:
        return Quaternion(-q.x, -q.y, -q.z, -q.w)
    return q


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _composed(a: Pose, b: Pose) -> Pose:
    """Apply `_behind` as tf2 does for a fixed frame, by matrices: all rotations are normalized."""
    pose: Pose = _behind(Pose(a.v, _normalized(a.q)), Pose(b.v, _normalized(b.q)))
    return Pose(pose.v, _of_matrix(_normalized(pose.q)))


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _flaw(p: Pose) -> Int:
    if isnan(p.v.x) or isnan(p.v.y) or isnan(p.v.z):
        return _NAN
    if isnan(p.q.x) or isnan(p.q.y) or isnan(p.q.z) or isnan(p.q.w):
        return _NAN
    off: cython.double = abs(p.q.w * p.q.w + p.q.x * p.q.x + p.q.y * p.q.y + p.q.z * p.q.z - 1.0)
    return _DONE if off < _TOLERANCE else _DENORMALIZED


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _earlier(common: Int, stamp: Int) -> Int:
    return min(common, stamp) if stamp != 0 else common


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _known(common: Int) -> Int:
    return 0 if common == _NEVER else common


def _view(array: Any) -> Any:
    return memoryview(array)  # in uncompiled code, its elements are Python's numbers


def _zeros(*shape: int, kind: Any = np.int64) -> Any:
    return _view(np.zeros(shape, kind))


def _grown(old: Any, rows: int) -> Any:
    """Return an array's copy with more rows."""
    array = np.asarray(old)
    new = np.zeros((rows, *array.shape[1:]), array.dtype)
    new[: len(array)] = array
    return _view(new)


def pose_flaw(x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float) -> int:
    """Return what is wrong with a pose: `DONE`, `NAN` or `DENORMALIZED`."""
    return _flaw(Pose(Vector(x, y, z), Quaternion(qx, qy, qz, qw)))


@cython.cfunc
def _pose(translation: tuple[float, ...], rotation: tuple[float, ...]) -> Pose:
    x, y, z = translation
    qx, qy, qz, qw = rotation
    return Pose(Vector(x, y, z), Quaternion(qx, qy, qz, qw))


def compose(
    first: tuple[float, ...],
    first_rotation: tuple[float, ...],
    then: tuple[float, ...],
    then_rotation: tuple[float, ...],
) -> tuple[Translation, Rotation]:
    """Compose two poses as tf2 does in a lookup with a fixed frame."""
    p: Pose = _composed(_pose(first, first_rotation), _pose(then, then_rotation))
    return (p.v.x, p.v.y, p.v.z), (p.q.x, p.q.y, p.q.z, p.q.w)


def compose_many(poses: cython.double[:, ::1], then: tuple[float, ...], then_rotation: tuple[float, ...]) -> None:
    """Apply `compose` to each of the poses (N, 7), in place."""
    behind: Pose = _pose(then, then_rotation)
    p: Pose
    n: cython.Py_ssize_t
    if poses.shape[1] != 7:
        raise ValueError(f"poses of {poses.shape[1]} numbers: each must have 7 (x, y, z and the rotation's x, y, z, w)")
    for n in range(poses.shape[0]):
        p = Pose(
            Vector(poses[n, 0], poses[n, 1], poses[n, 2]),
            Quaternion(poses[n, 3], poses[n, 4], poses[n, 5], poses[n, 6]),
        )
        p = _composed(p, behind)
        poses[n, 0], poses[n, 1], poses[n, 2] = p.v.x, p.v.y, p.v.z
        poses[n, 3], poses[n, 4], poses[n, 5], poses[n, 6] = p.q.x, p.q.y, p.q.z, p.q.w


@cython.final
@cython.cclass
class TransformHistory:
    """Samples of all frames, which are numbered from 1. Not thread-safe: the caller must hold a lock during every call.

    Args:
        span: ns of history before each frame's newest sample.
    """

    span = cython.declare(Int, visibility="readonly")
    _rows: Int
    _used: Int
    # for each frame: the first index of its ring, the ring's size (a power of two), the oldest sample's position in
    # the ring, the number of samples, and the frame's kind
    _start: cython.longlong[::1]
    _capacity: cython.longlong[::1]
    _first: cython.longlong[::1]
    _count: cython.longlong[::1]
    _kind: cython.longlong[::1]
    # for each sample: its stamp in ns, the number of the parent, (x, y, z, qx, qy, qz, qw)
    _stamps: cython.longlong[::1]
    _parents: cython.longlong[::1]
    _poses: cython.double[:, ::1]
    # results of the last lookup
    _pose: Pose
    _answer: Int
    _stamp: Int
    _bound: Int
    _trouble: Int

    def __init__(self, span: int) -> None:
        if not 0 <= span <= layout.LAST_STAMP:
            raise ValueError(f"a history of {span / 1e9:g} s is not possible: give from 0 s to less than 146 years")
        self.span = span
        self._used = 0
        self._start, self._capacity, self._first = _zeros(64), _zeros(64), _zeros(64)
        self._count, self._kind = _zeros(64), _zeros(64)
        self._stamps, self._parents = _zeros(4096), _zeros(4096)
        self._poses = _zeros(4096, 7, kind=np.float64)
        self._answer = self._stamp = self._bound = self._trouble = 0
        self._rows = 64

    def make_room(self, frame: Int) -> None:
        """Allocate a row for a frame of this number."""
        if frame < self._rows:
            return
        rows = 2 * frame
        self._start, self._capacity = _grown(self._start, rows), _grown(self._capacity, rows)
        self._first, self._count, self._kind = (
            _grown(self._first, rows),
            _grown(self._count, rows),
            _grown(self._kind, rows),
        )
        self._rows = rows

    def begin(self, frame: Int, static: bool) -> None:
        """Set the kind of a frame without transforms, and allocate its ring."""
        self._check(frame)
        if self._capacity[frame] == 0:
            self._give(frame, 1 if static else SMALLEST)
        self._kind[frame] = _STATIC if static else _TIMED
        self._count[frame] = 0

    def insert(self, frame: Int, parent: Int, stamp: Int, pose: tuple[float, ...]) -> int:
        """Insert a sample in the order of stamps; a full ring grows.

        Args:
            frame: a frame for which `begin` was called.
            parent: a frame that has a row.
            stamp: ns.
            pose: x, y, z in m, and the rotation's x, y, z, w.

        Returns:
            `DONE`, or what is wrong with the sample.
        """
        x, y, z, qx, qy, qz, qw = pose
        return self._insert(frame, parent, stamp, Pose(Vector(x, y, z), Quaternion(qx, qy, qz, qw)))

    def insert_at(self, frame: Int, parent: Int, stamp: Int, cdr: bytes, at: cython.Py_ssize_t) -> int:
        """Apply `insert` to a pose in a message: 7 float64, little-endian, from byte ``at`` on."""
        if not 0 <= at <= len(cdr) - 56:
            raise IndexError(f"a message of {len(cdr)} bytes has no pose at byte {at}")
        pose: Pose = _unit()
        if cython.compiled:
            source: cython.p_const_uchar = cdr
            memcpy(cython.address(pose), source + at, 56)
        else:
            parts = struct.unpack_from("<7d", cdr, at)
            pose = Pose(Vector(*parts[:3]), Quaternion(*parts[3:]))
        return self._insert(frame, parent, stamp, pose)

    def lookup(self, target: Int, source: Int, stamp: Int, horizon: Int) -> Found | None:
        """Return the pose of ``source`` in ``target``, and its stamp; None if it is unknown, as `failure` explains.

        Args:
            target: number of a frame.
            source: number of another frame.
            stamp: ns, 0 for the newest time at which both are known.
            horizon: ns that may be extrapolated.
        """
        self._check(target)
        self._check(source)
        if self._walk(target, source, stamp, horizon) != _DONE:
            return None
        p: Pose = self._pose
        return (p.v.x, p.v.y, p.v.z), (p.q.x, p.q.y, p.q.z, p.q.w), self._stamp

    def failure(self) -> tuple[int, int, int, int]:
        """Return a failed lookup's result code, its stamp in ns, and the bound and the cause of an extrapolation.

        The bound is the known time nearest to the requested one, and the cause is one of `EMPTY` to `PAST`. Both are
        valid only if the result is `EXTRAPOLATION`.
        """
        return self._answer, self._stamp, self._bound, self._trouble

    def lookup_many(
        self, target: Int, source: Int, stamps: NDArray[np.int64], horizon: Int
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return poses (N, 7), NaN if unknown, and whether each is known (N), as in `lookup`; releases the GIL.

        Args:
            target: number of a frame.
            source: number of another frame.
            stamps: (N), contiguous; replaced by the results' stamps.
            horizon: ns that may be extrapolated.
        """
        self._check(target)
        self._check(source)
        poses: NDArray[np.float64] = np.full((len(stamps), 7), np.nan)
        known: NDArray[np.bool_] = np.zeros(len(stamps), np.bool_)
        times: cython.longlong[::1] = _view(stamps)
        rows: cython.double[:, ::1] = poses
        valid: cython.uchar[::1] = known.view(np.uint8)
        p: Pose
        n: cython.Py_ssize_t
        with cython.nogil:
            for n in range(times.shape[0]):
                if self._walk(target, source, times[n], horizon) == _DONE:
                    p = self._pose
                    rows[n, 0], rows[n, 1], rows[n, 2] = p.v.x, p.v.y, p.v.z
                    rows[n, 3], rows[n, 4], rows[n, 5], rows[n, 6] = p.q.x, p.q.y, p.q.z, p.q.w
                    times[n], valid[n] = self._stamp, 1
        return poses, known

    def newest(self, frame: Int) -> tuple[int, int]:
        """Return the number of a frame's newest parent and its stamp; 0, 0 if it has none."""
        self._check(frame)
        if self._count[frame] == 0:
            return 0, 0
        at: Int = self._place(frame, self._count[frame] - 1)
        return self._parents[at], self._stamps[at]

    def ends(self, frame: Int) -> tuple[int, int, int]:
        """Return a frame's oldest stamp, its newest stamp, and its number of samples."""
        self._check(frame)
        count: Int = self._count[frame]
        if count == 0:
            return 0, 0, 0
        return self._stamps[self._place(frame, 0)], self._stamps[self._place(frame, count - 1)], count

    def remove(self, frame: Int) -> None:
        """Remove a frame's samples and its kind."""
        self._check(frame)
        self._count[frame] = 0
        self._kind[frame] = _NONE

    def clear(self) -> None:
        """Remove the samples of all frames except static ones; their kind stays, as in tf2."""
        frame: Int
        for frame in range(self._rows):
            if self._kind[frame] == _TIMED:
                self._count[frame] = 0

    @cython.cfunc
    def _check(self, frame: Int) -> cython.int:
        if not 0 < frame < self._rows:
            raise IndexError(f"frame {frame} has no row: call make_room() first")
        return 0

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _place(self, frame: Int, at: Int) -> Int:
        """Return the index of a frame's sample; 0 is the oldest."""
        return self._start[frame] + ((self._first[frame] + at) & (self._capacity[frame] - 1))

    @cython.cfunc
    def _insert(self, frame: Int, parent: Int, stamp: Int, pose: Pose) -> Int:
        self._check(frame)
        self._check(parent)
        if self._kind[frame] == _NONE:
            raise ValueError(f"frame {frame} has no ring: call begin() first")
        if not 0 <= stamp < _LAST_STAMP and self._kind[frame] == _TIMED:
            raise ValueError(f"a stamp of {stamp} ns is out of range: give one from 0 to 146 years")
        answer: Int = self._store(frame, parent, stamp, pose, False)
        if answer == _FULL:
            if self._capacity[frame] < LARGEST:
                self._give(frame, GROWTH * self._capacity[frame])
            answer = self._store(frame, parent, stamp, pose, True)
        return answer

    @cython.cfunc
    def _give(self, frame: Int, capacity: Int) -> cython.int:
        """Move a frame's samples to a larger ring at the end of all rings; the previous ring remains unused."""
        start: Int = self._used
        n: Int
        if start + capacity > len(self._stamps):
            room = 2 * (start + capacity)
            self._poses = _grown(self._poses, room)
            self._parents = _grown(self._parents, room)
            self._stamps = _grown(self._stamps, room)
        self._used = start + capacity
        for n in range(self._count[frame]):
            self._move(self._place(frame, n), start + n)
        self._start[frame], self._capacity[frame], self._first[frame] = start, capacity, 0
        return 0

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _move(self, origin: Int, target: Int) -> cython.void:
        self._stamps[target] = self._stamps[origin]
        self._parents[target] = self._parents[origin]
        self._write(target, self._read(origin))

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _read(self, at: Int) -> Pose:
        return Pose(
            Vector(self._poses[at, 0], self._poses[at, 1], self._poses[at, 2]),
            Quaternion(self._poses[at, 3], self._poses[at, 4], self._poses[at, 5], self._poses[at, 6]),
        )

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _write(self, at: Int, p: Pose) -> cython.void:
        self._poses[at, 0], self._poses[at, 1], self._poses[at, 2] = p.v.x, p.v.y, p.v.z
        self._poses[at, 3], self._poses[at, 4], self._poses[at, 5] = p.q.x, p.q.y, p.q.z
        self._poses[at, 6] = p.q.w

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _store(self, frame: Int, parent: Int, stamp: Int, pose: Pose, force: cython.bint) -> Int:
        """Store a sample in the order of stamps; with ``force``, a full ring drops its oldest sample."""
        flaw: Int = _flaw(pose)
        if flaw != _DONE:
            return flaw
        count: Int = self._count[frame] if self._kind[frame] == _TIMED else 0
        at: Int = 0
        n: Int
        if count > 0:
            newest: Int = self._stamps[self._place(frame, count - 1)]
            if newest > stamp + self.span:
                return _OLD
            after: Int = count
            while after > 0 and self._stamps[self._place(frame, after - 1)] > stamp:
                after -= 1
            if after > 0 and self._stamps[self._place(frame, after - 1)] == stamp:
                return _REPEATED
            latest: Int = max(newest, stamp)
            dropped: Int = 0
            while dropped < count and self._stamps[self._place(frame, dropped)] + self.span < latest:
                dropped += 1
            if count - dropped == self._capacity[frame]:
                if not force:
                    return _FULL
                dropped += 1
            self._first[frame] = (self._first[frame] + dropped) & (self._capacity[frame] - 1)
            count -= dropped
            at = after - dropped if after > dropped else 0
            for n in range(count, at, -1):
                self._move(self._place(frame, n - 1), self._place(frame, n))
        else:
            self._first[frame] = 0
        sample: Int = self._place(frame, at)
        self._stamps[sample], self._parents[sample] = stamp, parent
        self._write(sample, pose)
        self._count[frame] = count + 1
        return _DONE

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _between(self, first: Int, second: Int, time: Int) -> Pose:
        """Interpolate the pose at a time between two samples, or extrapolate it if the time is outside them."""
        ratio: cython.double = float(time - self._stamps[first]) / float(self._stamps[second] - self._stamps[first])
        complement: cython.double = 1.0 - ratio
        a: Pose = self._read(first)
        b: Pose = self._read(second)
        return Pose(
            Vector(
                complement * a.v.x + ratio * b.v.x,
                complement * a.v.y + ratio * b.v.y,
                complement * a.v.z + ratio * b.v.z,
            ),
            _slerp(a.q, b.q, ratio),
        )

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _beyond(self, frame: Int, time: Int, ahead: Int) -> Sample:
        """Extrapolate ``ahead`` ns beyond the history from a part of it that lasts as long, which bounds the error."""
        count: Int = self._count[frame]
        step: Int = 1 if ahead < 0 else -1
        edge: Int = 0 if ahead < 0 else count - 1
        end: Int = self._place(frame, edge)
        other: Int = end
        cython.declare(at=Int, n=Int)
        for n in range(1, count):
            at = self._place(frame, edge + step * n)
            if self._parents[at] != self._parents[end]:
                break
            other = at
            if abs(self._stamps[at] - self._stamps[end]) >= abs(ahead):
                break
        return Sample(self._parents[end], self._read(end) if other == end else self._between(end, other, time))

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _last_before(self, frame: Int, time: Int) -> Int:
        """Return the last sample at or before a time in the history; the search first assumes evenly spaced samples."""
        low: Int = 0
        high: Int = self._count[frame] - 1
        oldest: Int = self._stamps[self._place(frame, low)]
        newest: Int = self._stamps[self._place(frame, high)]
        middle: Int = cython.cast(Int, float(time - oldest) / float(newest - oldest) * high)
        step: Int = 1
        while high - low > 1:
            if not low < middle < high:
                middle = (low + high) >> 1
            if self._stamps[self._place(frame, middle)] <= time:
                low = middle
                middle = low + step
            else:
                high = middle
                middle = high - step
            step *= 2
        return low

    @cython.cfunc
    @cython.inline
    @cython.nogil
    @cython.exceptval(check=False)
    def _sample_at(self, frame: Int, time: Int, horizon: Int) -> Sample:
        """Return a frame's sample at a time (0: the newest); if there is none, store the bound and the cause."""
        count: Int = self._count[frame]
        nothing: Sample = Sample(0, _unit())
        if count == 0:
            self._trouble = _EMPTY
            return nothing
        newest: Int = self._place(frame, count - 1)
        if self._kind[frame] == _STATIC or time == 0 or time == self._stamps[newest]:
            return Sample(self._parents[newest], self._read(newest))
        oldest: Int = self._place(frame, 0)
        if time == self._stamps[oldest]:
            return Sample(self._parents[oldest], self._read(oldest))
        late: Int = time - self._stamps[newest]
        early: Int = time - self._stamps[oldest]
        if late > 0 or early < 0:
            ahead: Int = late if late > 0 else early
            if count > 1 and abs(ahead) <= horizon:
                return self._beyond(frame, time, ahead)
            self._bound = self._stamps[newest] if late > 0 else self._stamps[oldest]
            self._trouble = _SINGLE if count == 1 else _FUTURE if late > 0 else _PAST
            return nothing
        low: Int = self._last_before(frame, time)
        before: Int = self._place(frame, low)
        after: Int = self._place(frame, low + 1)
        if self._stamps[before] == time or self._parents[before] != self._parents[after]:
            return Sample(self._parents[before], self._read(before))
        return Sample(self._parents[before], self._between(before, after, time))

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _latest(self, frame: Int) -> Newest:
        if self._count[frame] == 0:
            return Newest(0, 0)
        at: Int = self._place(frame, self._count[frame] - 1)
        return Newest(self._parents[at], 0 if self._kind[frame] == _STATIC else self._stamps[at])

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _meets(self, source: Int, last: Int, parent: Int) -> Int:
        """Return until when ``parent`` is known among the first ``last`` ancestors of a frame; -1 if it is not."""
        common: Int = _NEVER
        frame: Int = source
        above: Newest
        for _ in range(last):
            above = self._latest(frame)
            common = _earlier(common, above.stamp)
            if above.parent == parent:
                return common
            frame = above.parent
        return -1

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _common_time(self, target: Int, source: Int) -> Int:
        """Set the stamp to the newest time at which both frames are known, 0 for any; return `DONE` or the failure."""
        common: Int = _NEVER
        frame: Int = source
        depth: Int = 0
        met: Int
        above: Newest = self._latest(frame)
        while above.parent != 0:
            common = _earlier(common, above.stamp)
            frame = above.parent
            depth += 1
            if frame == target:
                self._stamp = _known(common)
                return _DONE
            if depth > _MAX_DEPTH:
                return _LOOP
            above = self._latest(frame)
        last: Int = depth
        common, frame, depth = _NEVER, target, 0
        while True:
            above = self._latest(frame)
            if above.parent == 0:
                return _CONNECTIVITY
            common = _earlier(common, above.stamp)
            met = self._meets(source, last, above.parent)
            if met >= 0 or above.parent == source:
                self._stamp = _known(min(common, met) if met >= 0 else common)
                return _DONE
            frame = above.parent
            depth += 1
            if depth > _MAX_DEPTH:
                return _LOOP

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _climb(self, frame: Int, end: Int, other: Int, time: Int, horizon: Int) -> Way:
        """Walk up the tree from a frame to ``end`` or ``other``, whichever comes first."""
        depth: Int = 0
        pose: Pose = _unit()
        above: Sample
        while frame != end and frame != other:
            if self._kind[frame] == _NONE:
                return Way(_ROOT, frame, pose)
            above = self._sample_at(frame, time, horizon)
            if above.parent == 0:
                return Way(_GAP, frame, pose)
            pose = _behind(pose, above.pose)
            frame = above.parent
            depth += 1
            if depth > _MAX_DEPTH:
                return Way(_ENDLESS, frame, pose)
        return Way(_THERE, frame, pose)

    @cython.cfunc
    @cython.nogil
    @cython.exceptval(check=False)
    def _walk(self, target: Int, source: Int, time: Int, horizon: Int) -> Int:
        """Set the pose of ``source`` in ``target``, and its stamp; return `DONE` or the failure."""
        self._stamp = time
        if time == 0:
            self._answer = self._common_time(target, source)
            if self._answer != _DONE:
                return self._answer
            time = self._stamp
        time = min(max(time, -_LAST_STAMP), _LAST_STAMP)  # no stamp is outside, and differences fit 64 bits
        up: Way = self._climb(source, target, target, time, horizon)
        bound: Int = self._bound
        trouble: Int = self._trouble
        down: Way = Way(_THERE, target, _unit())
        if up.end != _ENDLESS and up.frame != target:
            down = self._climb(target, up.frame, source, time, horizon)
        self._answer = _DONE
        if up.end == _ENDLESS or down.end == _ENDLESS:
            self._answer = _LOOP
        elif up.frame == target:
            self._pose = up.pose
        elif down.end == _GAP:
            self._answer = _EXTRAPOLATION
        elif down.frame == source:
            self._pose = _back(down.pose)
        elif down.frame == up.frame:
            self._pose = _behind(up.pose, _back(down.pose))
        else:
            self._bound, self._trouble = bound, trouble
            self._answer = _EXTRAPOLATION if up.end == _GAP else _CONNECTIVITY
        return self._answer
