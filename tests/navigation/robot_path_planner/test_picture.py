"""Goals from clicks and drags in yarpview."""

from __future__ import annotations

import math
from typing import Any

import pytest

from navigation.robot_path_planner.ground import Ground
from navigation.robot_path_planner.ports import goal_of_click
from tests.peers.navigation.floors import floor


@pytest.fixture(scope="module")
def ground() -> Ground:
    """100 by 100 cells of 0.05 m."""
    return Ground(floor(), 0.2)


@pytest.mark.parametrize(
    ("values", "goal"),
    [
        ([80, 60], (4.025, 1.975, math.nan)),
        ([80, 60, 80, 60], (4.025, 1.975, math.nan)),
        ([80, 60, 80, 40], (4.025, 1.975, math.pi / 2)),
        ([80, 60, 60.0, 60], (4.025, 1.975, math.pi)),
    ],
)
def test_a_click_sets_the_position_and_a_drag_the_heading(ground: Ground, values: list[float], goal: Any) -> None:
    assert goal_of_click(ground, values)[:3] == pytest.approx(goal, nan_ok=True)


@pytest.mark.parametrize("values", [[], [1], [1, 2, 3], ["a", "b"], [True, 1], [math.nan, 1], [1, [2]]])
def test_invalid_clicks_are_rejected(ground: Ground, values: list[Any]) -> None:
    with pytest.raises(ValueError, match="is neither"):
        goal_of_click(ground, values)


def test_clicks_without_a_map_are_rejected() -> None:
    with pytest.raises(ValueError, match="no map"):
        goal_of_click(None, [1, 2])
