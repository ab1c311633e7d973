"""Common ticks of a process's threads, so that one wake-up of an idle processor serves several of them.

A thread that wakes up on an idle processor first reloads the processor's caches; on a small or virtual machine that
takes more time than most of these threads compute.
"""

from __future__ import annotations

import time

_START = time.monotonic()  # differs between processes, which thus do not compete for the processor


def until_tick(period: float, offset: float = 0.0) -> float:
    """Return the seconds until the next multiple of ``period`` since the process's start, at most ``period``.

    Threads that wait like this wake up together if one period is a multiple of the other. Those with an ``offset`` wake
    up that many seconds later.
    """
    return period - (time.monotonic() - _START - offset) % period
