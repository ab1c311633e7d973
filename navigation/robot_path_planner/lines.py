"""Lines over places of a map."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.shortcut import sees
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground

Places = NDArray[np.float64]
"""(n, 2) x and y, metres."""


def blocked(ground: Ground, closed: NDArray[np.bool_], places: Places) -> bool:
    """Whether a line over places, (n, 2) metres, comes through closed cells; those that it begins in do not count."""
    columns, rows = ground.grid.cells_at(sampled(places, ground.grid.resolution / 2)).T
    fits = (rows >= 0) & (rows < closed.shape[0]) & (columns >= 0) & (columns < closed.shape[1])
    found = closed[rows[fits], columns[fits]]
    free = np.flatnonzero(~found)
    return bool(len(free)) and bool(found[free[0] :].any())


def sampled(places: Places, step: float) -> Places:
    """Places along a line, no further apart than a step."""
    made = [places[:1]]
    for one, other in pairwise(places):
        count = max(math.ceil(math.dist(one, other) / step), 1)
        made.append(one + (other - one) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(made)


def is_straight(ground: Ground, one: Pose, other: Pose) -> bool:
    """Whether nothing lies between; one that stands where it should not is on its way out."""
    here, there = ground.cell(one.x, one.y), ground.cell(other.x, other.y)
    return here is None or there is None or not ground.open[here] or sees(ground.open, here, there)


def length(places: Places) -> float:
    """Metres of a line."""
    return float(np.hypot(*np.diff(places, axis=0).T).sum())


def cut(places: Places, metres: float) -> Places:
    """The first metres of a line."""
    steps = np.hypot(*np.diff(places, axis=0).T)
    whole = np.concatenate(([0.0], np.cumsum(steps)))
    if whole[-1] <= metres:
        return places
    number = int(np.searchsorted(whole, metres))
    share = (metres - whole[number - 1]) / steps[number - 1]
    end = places[number - 1] + share * (places[number] - places[number - 1])
    return np.concatenate((places[:number], [end]))
