"""Conditions with deadlines."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

_LONG, _PATIENCE = 10.0, 60.0
"""Seconds: who waits for so long does not measure but wants to know that something hangs, which a machine that computes
beside makes known late."""


_RAREST = 0.1
"""Seconds between two looks at most, where the look is cheap."""


def until(condition: Callable[[], T], what: str, seconds: float = 40.0, every: float = 0.02) -> T:
    """Return the condition's first true value; fail with ``what`` after ``seconds``, or a minute if these are many.

    What takes long is looked at more rarely, and so is what is dear to look at: a test that waits leaves the machine to
    those for whom it waits.
    """
    seconds = max(seconds, _PATIENCE) if seconds >= _LONG else seconds
    began = time.monotonic()
    while True:
        looked = time.monotonic()
        value = condition()
        if value:
            return value
        now = time.monotonic()
        if now > began + seconds:
            msg = f"not within {seconds:g} s: {what} (last: {value!r})"
            raise AssertionError(msg)
        time.sleep(max(every, 3 * (now - looked), min(_RAREST, (now - began) / 20)))
