"""Waits that Ctrl-C interrupts on every system."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable

_STEP_SECONDS = 0.2


def interruptible(wait: Callable[[float | None], bool], seconds: float | None = None) -> bool:
    """Wait for a lock up to ``seconds`` by its own method, such as ``Event.wait``; return the method's result.

    On Windows, a thread that waits for a lock handles no signal until the wait has ended, so it waits in steps there.
    """
    if sys.platform != "win32":
        return wait(seconds)
    end = math.inf if seconds is None else time.monotonic() + seconds
    while not wait(min(_STEP_SECONDS, max(end - time.monotonic(), 0.0))):
        if time.monotonic() >= end:
            return False
    return True
