"""How fast a figure grows."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from statistics import median

_MOST = 200


def slope(points: Sequence[tuple[float, float]]) -> float:
    """The median slope of all pairs of points (Theil and Sen's): a step or an outlier does not make a trend.

    Args:
        points: place and value; at most 200, spread evenly, are looked at.

    Returns:
        The value's growth for each unit of the place, 0.0 for fewer than two points.
    """
    some = points[:: max(1, -(-len(points) // _MOST))]
    slopes = [(v2 - v1) / (p2 - p1) for (p1, v1), (p2, v2) in combinations(some, 2) if p1 != p2]
    return median(slopes) if slopes else 0.0
