"""Result codes of the history, and its limits."""

from __future__ import annotations

from typing import Final

NONE: Final = 0
TIMED: Final = 1
STATIC: Final = 2
"""Kinds of frames: without transforms, with timed ones, with static ones."""

DONE: Final = 0
LOOP: Final = 1
CONNECTIVITY: Final = 2
EXTRAPOLATION: Final = 3
"""Results of a lookup."""

EMPTY: Final = 0
SINGLE: Final = 1
FUTURE: Final = 2
PAST: Final = 3
"""Why there is no sample at a time: the frame has none, only one with another time, only older or only newer ones."""

NAN: Final = 1
DENORMALIZED: Final = 2
OLD: Final = 3
REPEATED: Final = 4
FULL: Final = 5
"""Results of an insertion, apart from `DONE`; `FULL`: nothing was inserted, because the ring has to grow first."""

MAX_DEPTH: Final = 1000
"""Largest number of frames in a chain; longer ones count as loops (tf2, buffer_core.h: MAX_GRAPH_DEPTH)."""

TOLERANCE: Final = 10e-3
"""Allowed deviation of the square of a rotation's length from 1 (tf2, buffer_core.cpp)."""

LAST_STAMP: Final = 1 << 62
"""Upper bound of stamps in ns (146 years); stamps are at least 0 and less than this."""
