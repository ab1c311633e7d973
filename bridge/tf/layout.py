"""Where numbers stand in the buffer's arrays, and what the kernels answer.

``table``: int64, a row of `COLUMNS` for each frame, row 0 for no frame. ``keys``: int64, (stamp in ns, number of the
parent) of each sample. ``poses``: float64, (x, y, z, qx, qy, qz, qw) of each sample. A frame's samples are a ring in
``keys`` and ``poses``, from its oldest on.
"""

from __future__ import annotations

from typing import Final

START: Final = 0
"""Column: the first sample of the frame's ring."""
CAPACITY: Final = 1
"""Column: samples that the ring has room for, a power of two."""
FIRST: Final = 2
"""Column: the oldest sample's place in the ring."""
COUNT: Final = 3
"""Column: samples in the ring."""
KIND: Final = 4
"""Column: `NONE` until the frame's first transform."""
COLUMNS: Final = 5

NONE: Final = 0
TIMED: Final = 1
STATIC: Final = 2

KEY: Final = 2
POSE: Final = 7

DONE: Final = 0
LOOP: Final = 1
CONNECTIVITY: Final = 2
EXTRAPOLATION: Final = 3
"""Answers of a lookup."""

STAMP: Final = 0
"""Fact: the time of the answer."""
BOUND: Final = 1
"""Fact of an extrapolation that was refused: the time that is known next to the one asked for."""
TROUBLE: Final = 2
"""Fact of an extrapolation that was refused: why."""
FACTS: Final = 3

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
