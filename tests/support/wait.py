"""Conditions with deadlines."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Literal, TypeVar

T = TypeVar("T")

_LONG, _PATIENCE = 10.0, 60.0
"""Waits of at least 10 s only detect hangs, and are extended to a minute, because a busy machine is slow."""

SLOWNESS = float(os.environ.get("MIDSPAN_TEST_SLOWNESS", "1"))
"""Factor for all deadlines that only detect hangs; more than 1 under an emulator (`scripts/arm64.py`)."""


def until(
    condition: Callable[[], T | Literal[False] | None], what: str, seconds: float = 40.0, every: float = 0.02
) -> T:
    """Return the condition's first true value; fail with ``what`` after ``seconds``, or a minute from 10 s on."""
    seconds = (max(seconds, _PATIENCE) if seconds >= _LONG else seconds) * SLOWNESS
    end = time.monotonic() + seconds
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > end:
            msg = f"not within {seconds:g} s: {what} (last: {value!r})"
            raise AssertionError(msg)
        time.sleep(every)
