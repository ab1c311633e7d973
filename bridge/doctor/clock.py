"""The offset between two machines' clocks, from questions and answers: half of the shortest round trip is the error."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Offset:
    """How far another clock is ahead of ours.

    Attributes:
        seconds: positive where the other is ahead.
        error: the true offset is within plus or minus so many seconds of it.
    """

    seconds: float
    error: float


def measure(ask: Callable[[], int | None], times: int = 5) -> Offset | None:
    """Measure an offset.

    Args:
        ask: asks the other machine for its system time in nanoseconds; None where it does not tell.
        times: how often to ask; the quickest answer counts.

    Returns:
        None where no answer came.
    """
    best: Offset | None = None
    for _ in range(times):
        started, before = time.monotonic_ns(), time.time_ns()  # in this order a pause in between is in the round trip
        told = ask()
        round_trip = time.monotonic_ns() - started
        if told is None:
            continue
        offset = Offset((told - before - round_trip / 2) / 1e9, round_trip / 2e9)
        if best is None or offset.error < best.error:
            best = offset
    return best
