"""What RobotGoto keeps for one goal."""

import math

import pytest

from navigation.robot_goto.task import GoalProgress


@pytest.mark.parametrize(
    ("steps", "missing"),
    [
        (
            [(4.0, 4.0), (6.0, 4.0), (5.5, 3.5), (5.2, 3.0)],
            0.0,
        ),  # a wall appears: the path costs more than it did at first
        ([(4.0, 4.0), (3.5, 4.5), (3.0, 5.0)], 0.0),  # it drives around a wall
        ([(4.0, 4.0), (6.0, 3.0), (3.0, 6.0), (6.0, 3.0), (3.0, 6.0)], 20.0),  # back and forth
    ],
    ids=["a longer path", "around", "back and forth"],
)
def test_a_robot_makes_progress_if_its_path_or_its_distance_shrinks(steps, missing):
    progress, now = GoalProgress(), 0.0
    for left, away in steps:
        since = progress.missing(now, left, away, math.inf)
        now += 10.0
    assert since == missing


def test_progress_counts_anew_after_a_pause():
    progress = GoalProgress()
    progress.missing(0.0, 1.0, 1.0, math.inf)
    progress.since = None
    assert progress.missing(50.0, 3.0, 3.0, math.inf) == 0.0
    assert progress.missing(60.0, 2.0, 3.0, math.inf) == 0.0
