"""Clicks of yarpview on the picture of the map, as goals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground


def goal_of_click(ground: Ground | None, values: Sequence[Any]) -> Pose:
    """The goal of a click or drag on the picture of the map.

    Args:
        ground: the map; None where there is none.
        values: ``x y``, or ``x0 y0 x1 y1`` where the robot is to head on from the first pixel to the second; with 0, 0
            the upper left one.

    Raises:
        ValueError: it is none, or there is no map.
    """
    if ground is None:
        raise ValueError("there is no map to click on")
    numbers = [float(value) for value in values if isinstance(value, (int, float)) and not isinstance(value, bool)]
    if len(numbers) != len(values) or len(numbers) not in (2, 4) or not all(map(math.isfinite, numbers)):
        raise ValueError(f"a click is x y, a drag x0 y0 x1 y1: {list(values)!r:.100} is neither")
    x, y = (float(each) for each in ground.grid.centers_of(numbers[:2]))
    if len(numbers) == 2 or numbers[:2] == numbers[2:]:
        return Pose(x, y, math.nan)
    to_x, to_y = (float(each) for each in ground.grid.centers_of(numbers[2:]))
    return Pose(x, y, math.atan2(to_y - y, to_x - x))
