"""The guard without a driver."""

import math

import numpy as np
import pytest

from bridge.messages.scan import LaserScan
from navigation.pose import Pose
from navigation.robot_goto.guard import FollowCheck, Guard
from navigation.robot_goto.local_grid import LocalGrid
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_goto.steering import STILL, DriveCommand

SETTINGS, ORIGIN = RobotGotoSection(), Pose(0.0, 0.0, 0.0)
FORWARD = DriveCommand(0.3)


@pytest.fixture
def guard():
    """A robot with walls 0.8 m from its center in all directions."""
    grid = LocalGrid(10.0, SETTINGS.robot_radius, 0.0)
    grid.scan(LaserScan(1_000_000_000, -math.pi, math.tau / 720, 0.1, 20.0, np.full(720, 0.8)), ORIGIN)
    return Guard(grid)


def test_the_velocity_estimate_follows_commands_within_the_acceleration_limits(guard):
    for _ in range(50):
        guard.follow(SETTINGS, DriveCommand(0.3, 0.0, 1.0), 0.01)
    assert guard.velocity == pytest.approx([0.15, 0.0, 0.5 * math.radians(SETTINGS.max_ang_acc)], abs=0.01)


def test_the_allowed_speed_depends_on_the_current_speed(guard):
    assert guard.allowed(SETTINGS, 1.0, ORIGIN, FORWARD) == FORWARD
    assert not guard.unseen
    for tick in range(30):  # another program drives the base at 0.6 m/s
        guard.measure(SETTINGS, 1.0 + 0.01 * tick, Pose(0.006 * tick, 0.0, 0.0))
    assert guard.velocity[:2] == pytest.approx([0.6, 0.0])
    assert guard.allowed(SETTINGS, 1.0, ORIGIN, FORWARD).vx == 0.0


def test_odometry_noise_and_jumps_do_not_count_as_speed(guard):
    rng = np.random.default_rng(1)
    for tick in range(100):
        x, y = rng.normal(0.0, 0.003, 2)
        guard.measure(SETTINGS, 1.0 + 0.01 * tick, Pose(x, y, 0.0))
    guard.measure(SETTINGS, 2.0, Pose(3.0, 0.0, 0.0))
    assert not guard.velocity.any()


def test_turning_and_stopping_are_always_allowed(guard):
    near = Pose(0.49, 0.0, 0.0)
    assert guard.allowed(SETTINGS, 1.0, near, DriveCommand(0.3, 0.0, 0.5)) == (0.0, 0.0, 0.5)
    assert guard.allowed(SETTINGS, 1.0, near, STILL) == STILL
    assert guard.allowed(SETTINGS, 1.0, near, DriveCommand(-0.2)).vx == -0.2


def test_a_seen_obstacle_that_slows_a_command_counts_for_a_second(guard):
    guard.allowed(SETTINGS, 1.0, ORIGIN, FORWARD)
    assert not guard.slows(1.0)
    guard.allowed(SETTINGS, 1.1, Pose(0.49, 0.0, 0.0), DriveCommand(omega=0.5))
    assert not guard.slows(1.1), "a turn is never slowed"
    guard.allowed(SETTINGS, 1.2, Pose(0.49, 0.0, 0.0), FORWARD)
    assert guard.slows(1.2)
    assert guard.slows(2.1)
    assert not guard.slows(2.3)


def test_cells_are_unseen_after_the_memory_time(guard):
    guard.allowed(SETTINGS, 1.0, ORIGIN, FORWARD)
    assert not guard.unseen
    assert guard.allowed(SETTINGS, 30.0, Pose(0.1, 0.0, 0.0), FORWARD).vx < 0.1
    assert guard.unseen


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.5), (0.1, 0.0, 0.0)], ids=["turns", "drives"])
@pytest.mark.parametrize(("follows", "fault"), [(True, False), (False, True)])
def test_a_base_that_moves_back_as_commanded_follows(velocity, follows, fault):
    check, pose = FollowCheck(), ORIGIN
    for step, sign in enumerate([1] * 10 + [-1] * 12):  # 0.5 rad or 0.1 m, and back
        pose = pose @ Pose(*(0.1 * sign * follows * value for value in velocity))
        check.add(0.1 * step, 0.1, sign * np.array(velocity), pose)
    assert check.since is None
    for step in range(30):
        check.add(2.2 + 0.1 * step, 0.1, np.array((0.1, 0.0, 0.0)), pose @ Pose(0.01 * step * follows, 0.0, 0.0))
    assert (check.since is not None) == fault
