"""The growth rate of a figure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from statistics import median

_MOST = 200


def slope(points: Sequence[tuple[float, float]]) -> float:
    """Return the median slope of all pairs of points (Theil-Sen), which is robust against steps and outliers.

    Args:
        points: x and y; at most 200 of them, evenly spread, are used.

    Returns:
        The growth of y per unit of x, 0.0 for fewer than two points.
    """
    some = points[:: max(1, -(-len(points) // _MOST))]
    slopes = [(v2 - v1) / (p2 - p1) for (p1, v1), (p2, v2) in combinations(some, 2) if p1 != p2]
    return median(slopes) if slopes else 0.0
