"""The arrays that hold all frames' histories, and their growth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.tf import kernels
from bridge.tf.layout import (
    CAPACITY,
    COLUMNS,
    COUNT,
    FACTS,
    FIRST,
    FULL,
    KEY,
    KIND,
    NONE,
    POSE,
    START,
    STATIC,
    TIMED,
)

_insert, _insert_at = kernels.insert, kernels.insert_at

SMALLEST = 64
GROWTH = 4
LARGEST = 1 << 14
"""Most samples of a frame: 10 s at 1.6 kHz. The oldest go where there are more."""


class History:
    """Samples of frames, which are numbered from 1. Its user's lock is held during every call.

    Args:
        span: ns that are kept before each frame's newest sample.
    """

    def __init__(self, span: int) -> None:
        self.span = span
        self._table: NDArray[np.int64] = np.zeros((64, COLUMNS), np.int64)
        self._keys: NDArray[np.int64] = np.empty((4096, KEY), np.int64)
        self._poses: NDArray[np.float64] = np.empty((4096, POSE), np.float64)
        self._used = 0
        self._out = np.zeros(2 * POSE, np.float64)
        self._facts = np.zeros(FACTS, np.int64)
        self._at_out, self._at_facts = self._out.ctypes.data, self._facts.ctypes.data
        self._then = self._at_out + 8 * POSE
        self._addresses()

    def _addresses(self) -> None:
        self._at = (self._table.ctypes.data, self._keys.ctypes.data, self._poses.ctypes.data)

    def make_room(self, frame: int) -> None:
        """Have a row for a frame of this number."""
        if frame >= len(self._table):
            table = np.zeros((2 * frame, COLUMNS), np.int64)
            table[: len(self._table)] = self._table
            self._table = table
            self._addresses()

    def begin(self, frame: int, *, static: bool) -> None:
        """Give a frame without transforms its kind and its ring."""
        row = self._table[frame]
        row[KIND] = STATIC if static else TIMED
        if row[CAPACITY] == 0:
            row[CAPACITY] = 1 if static else SMALLEST
            row[START] = self._allocate(int(row[CAPACITY]))

    def insert(self, frame: int, parent: int, stamp: int, pose: tuple[float, ...]) -> int:
        """Put a sample in its place; `DONE`, or why not. The ring grows where it is full."""
        table, keys, poses = self._at
        x, y, z, qx, qy, qz, qw = pose
        answer: int = _insert(table, keys, poses, frame, parent, stamp, self.span, 0, x, y, z, qx, qy, qz, qw)
        if answer == FULL:
            force = self._make_way(frame)
            answer = _insert(*self._at, frame, parent, stamp, self.span, force, *pose)
        return answer

    def insert_at(self, frame: int, parent: int, stamp: int, address: int) -> int:
        """`insert` of a pose of 7 float64 at an address."""
        table, keys, poses = self._at
        answer: int = _insert_at(table, keys, poses, frame, parent, stamp, self.span, 0, address)
        if answer == FULL:
            force = self._make_way(frame)
            answer = _insert_at(*self._at, frame, parent, stamp, self.span, force, address)
        return answer

    def lookup(self, target: int, source: int, stamp: int, horizon: int) -> int:
        """`DONE` and `pose` and `facts` are set, or why not."""
        answer: int = kernels.lookup(*self._at, target, source, stamp, horizon, self._at_out, self._at_facts)
        return answer

    def pose(self) -> list[float]:
        """The pose that was found."""
        found: list[float] = self._out[:POSE].tolist()
        return found

    def facts(self) -> list[int]:
        """Stamp, bound and trouble of the last lookup."""
        found: list[int] = self._facts.tolist()
        return found

    def compose(self, first: list[float], then: list[float]) -> list[float]:
        """A pose with another behind it."""
        self._out[:] = first + then
        kernels.compose(self._at_out, self._then, 1)
        return self.pose()

    def lookup_many(
        self, target: int, source: int, stamps: NDArray[np.int64], horizon: int
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Poses (N, 7) and answers (N) at the stamps (N, contiguous), which become those of the answers."""
        count = len(stamps)
        poses, answers = np.full((count, POSE), np.nan), np.empty(count, np.int64)
        kernels.lookup_many(
            *self._at,
            target,
            source,
            stamps.ctypes.data,
            count,
            horizon,
            poses.ctypes.data,
            answers.ctypes.data,
            self._at_facts,
        )
        return poses, answers

    def compose_many(self, poses: NDArray[np.float64], then: list[float]) -> None:
        """Put a pose behind each of the poses (N, 7), in place."""
        self._out[POSE:] = then
        kernels.compose(poses.ctypes.data, self._then, len(poses))

    def newest(self, frame: int) -> tuple[int, int]:
        """Number of a frame's newest parent and its stamp; 0, 0 where there is none."""
        row = self._table[frame]
        if row[COUNT] == 0:
            return 0, 0
        stamp, parent = self._keys[self._places(row)[-1]]
        return int(parent), int(stamp)

    def ends(self, frame: int) -> tuple[int, int, int]:
        """A frame's oldest stamp, its newest, and how many samples it has."""
        row = self._table[frame]
        places = self._places(row)
        if not len(places):
            return 0, 0, 0
        return int(self._keys[places[0], 0]), int(self._keys[places[-1], 0]), len(places)

    def forget(self, frame: int) -> None:
        """A frame's samples and its kind."""
        self._table[frame, COUNT] = 0
        self._table[frame, KIND] = NONE

    def clear(self) -> None:
        """Forget the samples of all frames but the static ones; their kind stays, as in tf2."""
        self._table[self._table[:, KIND] == TIMED, COUNT] = 0

    def _places(self, row: NDArray[np.int64]) -> Any:
        return row[START] + ((row[FIRST] + np.arange(row[COUNT])) & (row[CAPACITY] - 1))

    def _make_way(self, frame: int) -> int:
        """Let a full ring grow; 1 where it may not, and its oldest sample is to go."""
        if self._table[frame, CAPACITY] >= LARGEST:
            return 1
        capacity = GROWTH * int(self._table[frame, CAPACITY])
        start = self._allocate(capacity)
        kernels.move_ring(*self._at, frame, start, capacity)
        return 0

    def _allocate(self, count: int) -> int:
        """Room behind what is used. What a ring leaves that grows is not used again; it is less than what it gets."""
        start, self._used = self._used, self._used + count
        if self._used > len(self._keys):
            keys: NDArray[np.int64] = np.empty((2 * self._used, KEY), np.int64)
            poses: NDArray[np.float64] = np.empty((2 * self._used, POSE), np.float64)
            keys[:start], poses[:start] = self._keys[:start], self._poses[:start]
            self._keys, self._poses = keys, poses
            self._addresses()
        return start
