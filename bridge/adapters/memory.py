"""How a worker's process keeps memory: in few heaps, that of large messages, and the objects that stay."""

from __future__ import annotations

import ctypes
import gc
import sys
from typing import Any

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -2, -3, -8  # glibc's malloc.h
_KEPT = 128 * 1024 * 1024
_PAD = 64 * 1024 * 1024
_ARENAS = 2
"""By default each thread has a heap of its own, and what one frees of another's helps nobody."""
_LARGEST = 32 * 1024 * 1024
"""The largest that glibc takes on 64 bits (DEFAULT_MMAP_THRESHOLD_MAX)."""


def few_heaps() -> None:
    """Have glibc make two heaps, which saves 2 to 5 MB in each worker; call it before the process's threads start."""
    _mallopt((_ARENA_MAX, _ARENAS))


def keep_memory() -> None:
    """Have glibc use the memory of large messages again; to be called before the process's threads start.

    By default it gives each block of 128 kB and more back to the system, and every message pays for page faults anew:
    an image of 6 MB took up to 9.6 ms from ROS 1 to ROS 2 instead of 5.2 (benchmarks/topic_latency.py). Without the
    pad the heaps of threads are still given back.
    """
    _mallopt((_MMAP_THRESHOLD, _LARGEST), (_TRIM_THRESHOLD, _KEPT), (_TOP_PAD, _PAD))


def _mallopt(*options: tuple[int, int]) -> None:
    """Other C libraries than glibc have no ``mallopt``; there nothing is done."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        for option, value in options:
            mallopt(option, value)


def keep_objects() -> None:
    """Have the garbage collector look once at each object that stays, rather than again and again.

    With 500 routes a full collection stops the threads for 60 to 100 ms; one of what is new since the last takes a few.
    """
    gc.collect()
    gc.freeze()
    gc.callbacks.append(_Frozen())


class _Frozen:
    """Takes what a full collection left out of the next ones, and gives all back once it has grown by half."""

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
