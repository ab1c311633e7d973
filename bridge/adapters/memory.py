"""Settings of malloc and of the garbage collector for worker processes."""

from __future__ import annotations

import ctypes
import gc
import sys
from typing import Any

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -2, -3, -8  # glibc's malloc.h
_KEPT = 128 * 1024 * 1024
_PAD = 64 * 1024 * 1024
_ARENAS = 2
"""By default each thread has its own heap, and memory freed by one thread is not reused by the others."""
_LARGEST = 32 * 1024 * 1024
"""The largest value that glibc accepts on 64 bits (DEFAULT_MMAP_THRESHOLD_MAX)."""


def few_heaps() -> None:
    """Limit glibc to two heaps, which saves 2 to 5 MB per worker; call it before the process starts threads."""
    _mallopt((_ARENA_MAX, _ARENAS))


def keep_memory() -> None:
    """Let glibc reuse the memory of large messages; call it before the process starts threads.

    By default, glibc returns each block of 128 kB or more to the system, so every large message causes page faults: an
    image of 6 MB needed up to 9.6 ms from ROS 1 to ROS 2 instead of 5.2 ms (benchmarks/topic_latency.py). Without
    `_PAD`, glibc would still return the heaps of threads.
    """
    _mallopt((_MMAP_THRESHOLD, _LARGEST), (_TRIM_THRESHOLD, _KEPT), (_TOP_PAD, _PAD))


def _mallopt(*options: tuple[int, int]) -> None:
    """Set options of glibc's malloc; does nothing if the C library has no ``mallopt``."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        for option, value in options:
            mallopt(option, value)


def keep_objects() -> None:
    """Exempt long-lived objects from garbage collection after the first scan.

    With 500 routes, a full collection stops the threads for 60 to 100 ms; a collection that scans only newer objects
    stops them for a few milliseconds.
    """
    gc.collect()
    gc.freeze()
    gc.callbacks.append(_Frozen())


class _Frozen:
    """Freezes the survivors of each full collection; once their number has grown by half, all are scanned again."""

    def __init__(self) -> None:
        self._limit = self._least_limit()

    @staticmethod
    def _least_limit() -> int:
        return gc.get_freeze_count() * 3 // 2

    def __call__(self, phase: str, info: dict[str, Any]) -> None:
        if info["generation"] < 2:
            return
        if phase == "stop":
            gc.freeze()
            self._limit = self._limit or self._least_limit()
        elif gc.get_freeze_count() > self._limit:
            gc.unfreeze()
            self._limit = 0
