"""The guard, by itself."""

import math

import numpy as np
import pytest

from bridge.config.sections.planners import RobotGotoSection
from bridge.messages.scan import Turn
from navigation.pose import Pose
from navigation.robot_goto.guard import Guard
from navigation.robot_goto.local_grid import LocalGrid
from navigation.robot_goto.steering import STILL, DriveCommand

SETTINGS, ORIGIN = RobotGotoSection(), Pose(0.0, 0.0, 0.0)
FORWARD = DriveCommand(0.3)


@pytest.fixture
def guard():
    """A robot with walls 0.8 m from its middle all round."""
    grid = LocalGrid(10.0, SETTINGS.robot_radius, 0.0)
    grid.scan(Turn(1_000_000_000, -math.pi, math.tau / 720, 0.1, 20.0, np.full(720, 0.8)), ORIGIN)
    return Guard(grid)


def test_it_follows_what_was_commanded_as_fast_as_the_base_can(guard):
    for _ in range(50):
        guard.follow(SETTINGS, DriveCommand(0.3, 0.0, 1.0), 0.01)
    assert guard.has == pytest.approx([0.15, 0.0, 0.5 * math.radians(SETTINGS.max_ang_acc)], abs=0.01)


def test_what_is_allowed_depends_on_the_speed_that_it_has(guard):
    assert guard.allowed(SETTINGS, 1.0, ORIGIN, FORWARD) == FORWARD
    assert not guard.unseen
    for tick in range(30):  # somebody else drives it, at 0.6 m/s
        guard.measure(SETTINGS, 1.0 + 0.01 * tick, Pose(0.006 * tick, 0.0, 0.0))
    assert guard.has[:2] == pytest.approx([0.6, 0.0])
    assert guard.allowed(SETTINGS, 1.0, ORIGIN, FORWARD).vx == 0.0


def test_noise_of_the_odometry_and_its_jumps_are_no_speed(guard):
    rng = np.random.default_rng(1)
    for tick in range(100):
        x, y = rng.normal(0.0, 0.003, 2)
        guard.measure(SETTINGS, 1.0 + 0.01 * tick, Pose(x, y, 0.0))
    guard.measure(SETTINGS, 2.0, Pose(3.0, 0.0, 0.0))
    assert not guard.has.any()


def test_turning_is_always_allowed_and_standing_needs_no_leave(guard):
    near = Pose(0.49, 0.0, 0.0)
    assert guard.allowed(SETTINGS, 1.0, near, DriveCommand(0.3, 0.0, 0.5)) == (0.0, 0.0, 0.5)
    assert guard.allowed(SETTINGS, 1.0, near, STILL) == STILL
    assert guard.allowed(SETTINGS, 1.0, near, DriveCommand(-0.2)).vx == -0.2


def test_after_its_memory_is_over_all_is_unseen(guard):
    guard.allowed(SETTINGS, 1.0, ORIGIN, FORWARD)
    assert not guard.unseen
    assert guard.allowed(SETTINGS, 30.0, Pose(0.1, 0.0, 0.0), FORWARD).vx < 0.1
    assert guard.unseen
