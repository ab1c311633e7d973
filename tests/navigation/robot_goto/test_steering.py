"""The control laws for the speed."""

import math

import pytest

from navigation.constraints import Constraints
from navigation.pose import Pose
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_goto.steering import GoalLimits, behind, clip, drive, people_speed, side_slowdown

SETTINGS = RobotGotoSection()


def test_the_robot_can_stop_before_a_person_reaches_it():
    for gap in (0.3, 0.5, 1.0, 1.4):
        speed = people_speed(SETTINGS, gap)
        seconds = SETTINGS.reaction + speed / SETTINGS.max_lin_acc
        braking = speed * SETTINGS.reaction + speed**2 / (2 * SETTINGS.max_lin_acc)
        assert braking + 1.0 * seconds == pytest.approx(gap), "people walk at 1 m/s"
    assert people_speed(SETTINGS, 0.2) == people_speed(SETTINGS, -1.0) == 0.0
    assert people_speed(SETTINGS, math.inf) == math.inf


def test_speeds_are_clipped_and_zero_stays_zero():
    assert [clip(v, 0.1, 0.3) for v in (0.0, 0.05, -0.05, 0.2, 9.0, -9.0)] == [0.0, 0.1, -0.1, 0.2, 0.3, -0.3]


def test_the_robot_turns_in_place_if_the_goal_is_not_ahead():
    limits = GoalLimits.combine(SETTINGS, Constraints(on_obstacle="wait"))
    assert drive(SETTINGS, limits, 2.0, 1.5, 9.0, 1.0, through=False).vx == 0.0
    assert drive(SETTINGS, limits, 2.0, 0.1, 9.0, 1.0, through=False).vx == 0.3
    assert drive(SETTINGS, limits, 2.0, 0.1, 9.0, 0.5, through=False).vx == pytest.approx(0.15)
    assert drive(SETTINGS, limits, 0.1, 0.0, 9.0, 1.0, through=False).vx == pytest.approx(0.1)
    assert drive(SETTINGS, limits, 0.1, 0.0, 9.0, 1.0, through=True).vx == 0.3


def test_obstacles_at_the_side_slow_the_robot_with_avoidance_if_configured():
    settings = RobotGotoSection(speed_reduction_factor=0.5)
    assert side_slowdown(SETTINGS, 0.1) == 0.0
    assert side_slowdown(settings, 0.8) == side_slowdown(settings, math.inf) == 0.0
    assert side_slowdown(settings, 0.6) == pytest.approx(2.2 * 0.25 / 2)
    assert side_slowdown(settings, 0.1) == 0.5
    for on_obstacle, speed in (("around", 0.15), ("wait", 0.3)):
        limits = GoalLimits.combine(SETTINGS, Constraints(on_obstacle=on_obstacle))
        assert drive(settings, limits, 2.0, 0.0, 0.3, 1.0, through=False).vx == pytest.approx(speed)


def test_the_path_bends_to_the_heading_behind_a_goal_that_is_near():
    goal = Pose(2.0, 0.0, math.pi / 2)
    assert behind(goal, Pose(1.5, 0.0, 0.0)) == pytest.approx((2.0, -0.15))
    assert behind(goal, Pose(0.9, 0.0, 0.0)) is None, "too far away"
    assert behind(goal, Pose(2.2, 0.4, 0.0)) is None, "it faces the robot"
    assert behind(goal._replace(theta=math.nan), Pose(1.5, 0.0, 0.0)) is None


def test_goals_do_not_raise_the_robots_speed_limits():
    limits = GoalLimits.combine(SETTINGS, Constraints(max_lin_speed=9.0, max_ang_speed=999.0, min_lin_speed=5.0))
    assert (limits.max_lin, limits.max_ang, limits.min_lin) == (0.3, math.radians(30.0), 0.3)
