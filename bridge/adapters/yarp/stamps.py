"""Envelopes: a count and a time, as ``yarp::os::Stamp`` writes them into text."""

from __future__ import annotations

import re
import time
from decimal import Decimal

_STAMP = re.compile(r"\s*-?\d{1,12}\s+(\d{1,12}(?:\.\d{1,30})?(?:[eE][+-]?\d{1,2})?)\s*")
_DAY_NS = 86_400_000_000_000


def envelope(count: int, stamp_ns: int | None) -> str:
    """The envelope of a message with this time, "" of one that has none."""
    if stamp_ns is None or stamp_ns <= 0:
        return ""
    return f"{count} {stamp_ns // 1_000_000_000}.{stamp_ns % 1_000_000_000:09d}"


def stamp(text: str) -> int | None:
    """The time in an envelope in nanoseconds, None where it has none."""
    found = _STAMP.fullmatch(text)
    if found is None:
        return None
    time_ns = int(Decimal(found[1]).scaleb(9).to_integral_value())
    return time_ns if 0 < time_ns < 1 << 62 else None


def on_system_clock(stamp_ns: int | None) -> int | None:
    """The time, where it is one of the system's clock and not of a simulation's or a machine's since its start."""
    return stamp_ns if stamp_ns is not None and abs(time.time_ns() - stamp_ns) < _DAY_NS else None
