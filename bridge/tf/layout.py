"""Numbers by which the history says what it answers, and its bounds."""

from __future__ import annotations

from typing import Final

NONE: Final = 0
TIMED: Final = 1
STATIC: Final = 2
"""Kinds of frames: without a transform yet, moving, fixed."""

DONE: Final = 0
LOOP: Final = 1
CONNECTIVITY: Final = 2
EXTRAPOLATION: Final = 3
"""Answers of a lookup."""

EMPTY: Final = 0
SINGLE: Final = 1
FUTURE: Final = 2
PAST: Final = 3
"""Why there is nothing at a time: no sample, one sample of another time, all are older, all are newer."""

NAN: Final = 1
DENORMALIZED: Final = 2
OLD: Final = 3
REPEATED: Final = 4
FULL: Final = 5
"""Answers of an insertion, beside `DONE`; `FULL`: nothing was done, the ring is to grow."""

MAX_DEPTH: Final = 1000
"""Frames of a chain: more are taken for a loop (tf2, buffer_core.h: MAX_GRAPH_DEPTH)."""

TOLERANCE: Final = 10e-3
"""How far the square of a rotation's length may be from 1 (tf2, buffer_core.cpp)."""

LAST_STAMP: Final = 1 << 62
"""Stamps are from 0 to before this one, in ns: 146 years."""
