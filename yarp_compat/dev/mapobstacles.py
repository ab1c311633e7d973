"""Obstacles made larger, so that who plans for a point plans for a robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev.mapflag import MapFlag


def enlarge(flags: NDArray[np.uint8], cells: int) -> None:
    """Make free cells enlarged obstacles where any other flag is within so many cells, diagonal steps counted as one.

    That is what as many passes over all eight neighbours come to, as YARP does it.

    Args:
        flags: of shape (height, width), changed in place.
        cells: how far, above 0.
    """
    near = (flags >= MapFlag.KEEP_OUT) & (flags <= MapFlag.UNKNOWN)
    near = _spread(_spread(near, cells).T, cells).T
    flags[near & (flags == MapFlag.FREE)] = MapFlag.ENLARGED_OBSTACLE


def _spread(marks: NDArray[np.bool_], cells: int) -> NDArray[np.bool_]:
    """Marks along rows, so many cells further both ways: by steps that double what there is."""
    cells = min(cells, marks.shape[1])
    done = 0
    while done < cells:
        step = min(done + done + 1, cells) - done
        wider = marks.copy()
        wider[:, step:] |= marks[:, :-step]
        wider[:, :-step] |= marks[:, step:]
        marks, done = wider, done + step
    return marks
