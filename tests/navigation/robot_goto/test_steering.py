"""The laws of speed."""

import math

import pytest

from bridge.config.sections.planners import RobotGotoSection
from navigation.constraints import Constraints
from navigation.robot_goto.steering import GoalLimits, beside, clipped, drive, people_speed

SETTINGS = RobotGotoSection()


def test_from_the_speed_beside_people_it_stands_before_they_are_there():
    for gap in (0.3, 0.5, 1.0, 1.4):
        speed = people_speed(SETTINGS, gap)
        seconds = SETTINGS.reaction + speed / SETTINGS.max_lin_acc
        way = speed * SETTINGS.reaction + speed**2 / (2 * SETTINGS.max_lin_acc)
        assert way + 1.0 * seconds == pytest.approx(gap), "they walk a metre a second"
    assert people_speed(SETTINGS, 0.2) == people_speed(SETTINGS, -1.0) == 0.0
    assert people_speed(SETTINGS, math.inf) == math.inf


def test_speeds_are_cut_to_their_least_and_most_and_none_stays_none():
    assert [clipped(v, 0.1, 0.3) for v in (0.0, 0.05, -0.05, 0.2, 9.0, -9.0)] == [0.0, 0.1, -0.1, 0.2, 0.3, -0.3]


def test_far_from_its_way_it_turns_on_the_spot():
    limits = GoalLimits.of(SETTINGS, Constraints(on_obstacle="wait"))
    assert drive(SETTINGS, limits, 2.0, 1.5, 9.0, 1.0, through=False).vx == 0.0
    assert drive(SETTINGS, limits, 2.0, 0.1, 9.0, 1.0, through=False).vx == 0.3
    assert drive(SETTINGS, limits, 2.0, 0.1, 9.0, 0.5, through=False).vx == pytest.approx(0.15)
    assert drive(SETTINGS, limits, 0.1, 0.0, 9.0, 1.0, through=False).vx == pytest.approx(0.06)
    assert drive(SETTINGS, limits, 0.1, 0.0, 9.0, 1.0, through=True).vx == 0.3


def test_beside_obstacles_it_slows_and_with_avoidance_alone():
    assert beside(SETTINGS, 0.8) == beside(SETTINGS, math.inf) == 0.0
    assert beside(SETTINGS, 0.6) == pytest.approx(2.2 * 0.25 / 2)
    assert beside(SETTINGS, 0.1) == 0.5
    for asked, speed in (("around", 0.15), ("wait", 0.3)):
        limits = GoalLimits.of(SETTINGS, Constraints(on_obstacle=asked))
        assert drive(SETTINGS, limits, 2.0, 0.0, 0.3, 1.0, through=False).vx == pytest.approx(speed)


def test_no_goal_makes_it_faster_than_the_robot_may_be():
    limits = GoalLimits.of(SETTINGS, Constraints(max_lin_speed=9.0, max_ang_speed=999.0, min_lin_speed=5.0))
    assert (limits.max_lin, limits.max_ang, limits.min_lin) == (0.3, math.radians(30.0), 0.3)
