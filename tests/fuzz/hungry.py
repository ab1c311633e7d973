"""A parser that breaks every promise, for tests of the fuzzing engine; separate, because the targets load slowly."""

from __future__ import annotations

import os
import signal


def hungry(data: bytes) -> None:
    """Break every promise of a parser, depending on the input."""
    if data.startswith(b"m"):
        bytearray(100 << 20)
    if data.startswith(b"s"):
        sum(range(5_000_000))
    if data.startswith(b"w"):
        raise KeyError(data)
    if data.startswith(b"boom"):
        os.kill(os.getpid(), signal.SIGSEGV)
    if b"i" in data:
        raise ValueError
