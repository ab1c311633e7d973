"""The state of one goal of RobotGoto: its progress, and a robot that is held."""

import math

import pytest

from navigation.pose import Pose
from navigation.robot_goto.task import GoalProgress, Hold


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


def test_progress_is_measured_again_after_a_pause():
    progress = GoalProgress()
    progress.missing(0.0, 1.0, 1.0, math.inf)
    progress.since = None
    assert progress.missing(50.0, 3.0, 3.0, math.inf) == 0.0
    assert progress.missing(60.0, 2.0, 3.0, math.inf) == 0.0


HERE = Pose(1.0, 2.0, 0.0)


def held(hold, begin, seconds, pose=HERE, *, refused=True):
    """Add steps of 0.1 s; return the times at which the robot has been held for too long."""
    times = [begin + 0.1 * number for number in range(round(10 * seconds) + 1)]
    return [now for now in times if hold.add(now, pose, refused=refused)]


def test_a_robot_is_held_after_a_second_in_which_the_check_refuses_each_command():
    hold = Hold()
    assert held(hold, 0.0, 0.9) == []
    assert hold.narrow(0.9) is None
    held(hold, 1.0, 0.5, refused=False)
    assert held(hold, 1.6, 0.9) == []
    assert held(hold, 2.6, 0.0) == [2.6]
    assert hold.narrow(2.7) == HERE
    assert hold.narrow(23.0) is None


def test_a_robot_that_is_held_again_at_the_same_place_has_waited_since_the_first_time():
    hold = Hold()
    assert held(hold, 10.0, 1.0)
    assert hold.since == 10.0
    held(hold, 11.1, 28.0, refused=False)
    assert held(hold, 40.0, 1.1, HERE._replace(x=1.2))
    assert hold.since == 10.0
    held(hold, 41.2, 38.0, refused=False)
    assert held(hold, 80.0, 1.1, HERE._replace(x=2.0))
    assert hold.since == 80.0
    assert hold.narrow(82.0) == HERE._replace(x=2.0)


def test_a_robot_that_left_and_returned_has_not_waited_meanwhile():
    hold = Hold()
    assert held(hold, 10.0, 1.0)
    held(hold, 11.1, 60.0, HERE._replace(x=5.0), refused=False)
    assert held(hold, 80.0, 1.1)
    assert hold.since == 80.0
