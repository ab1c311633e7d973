"""Threads that zenoh's library made and that call Python keep their Python state between calls."""

from __future__ import annotations

import ctypes
import threading

_kept: set[int] = set()


def keep_thread_state() -> None:
    """Keep this thread's Python state after the call from zenoh that it runs in; to be called in each of them.

    CPython makes such a thread a new state for each call, maps a page of stack for it, and unmaps it afterwards: 20 us
    a message, and a flush of the other core's address cache.
    """
    me = threading.get_ident()
    if me not in _kept:
        _kept.add(me)
        ctypes.pythonapi.PyGILState_Ensure()
