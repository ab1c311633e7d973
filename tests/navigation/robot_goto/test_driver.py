"""The driver drives a simulated robot without collisions."""

import math

import numpy as np
import pytest

from bridge.messages.scan import LaserScan
from navigation.constraints import Constraints
from navigation.pose import Pose
from navigation.robot_goto.driver import MAX_RETREAT, Driver
from navigation.status import Fault, PlannerStatus, State
from sim.base import BasePose
from sim.plan import Box, Person
from tests.peers.navigation.scene import Scene


def box(x, y, length=0.4, width=0.4, degrees=0.0):
    return Box(at=(x, y, degrees), size=(length, width, 1.0))


# goals


@pytest.mark.parametrize(
    ("plan", "x", "y", "robot"),
    [
        ("lab", 2.57, 1.19, "r1"),
        ("lab", 3.35, 3.17, "r1"),
        ("apartment", 4.4, 8.2, "r1"),
        pytest.param("lab", 3.35, 3.17, "ikart_v1", marks=pytest.mark.thorough),
    ],
)
def test_goals_are_reached_without_a_collision(plan, x, y, robot):
    scene = Scene(plan, robot)
    assert scene.goto(x, y, 30.0) is State.REACHED
    assert scene.pose.distance(Pose(x, y, 0.0)) < 0.08
    assert abs(math.remainder(scene.pose.theta - math.radians(30.0), math.tau)) < math.radians(3.0)
    assert not scene.touched
    assert max(c.speed for _, c in scene.commands) <= 0.3 + 1e-9
    assert scene.driver.status.fault is Fault.NONE


def test_with_blind_sectors_the_robot_turns_before_it_drives():
    scene = Scene("lab", laser="robot")
    assert scene.goto(2.57, 1.19) is State.REACHED
    assert not scene.touched
    turns = [c for _, c in scene.commands[:100] if c.omega and not c.speed]
    assert turns, "the robot's lasers do not see its sides, so it must turn first"


def test_a_goal_without_heading_is_reached_within_its_own_tolerance():
    scene = Scene()
    assert scene.goto(1.0, 0.2, 90.0, heading=False, tolerance_lin=0.3) is State.REACHED
    assert 0.2 < scene.pose.distance(Pose(1.0, 0.2, 0.0)) < 0.31
    assert scene.pose.theta < 0.5


def test_waypoints_and_new_goals_do_not_stop_the_robot():
    scene = Scene()
    scene.driver.goal(Pose(1.0, 0.0, math.nan), Constraints(through=True, tolerance_lin=0.1))
    scene.until(lambda: scene.driver.status.state is State.REACHED, 20)
    scene.run(0.1)  # the next goal arrives late
    assert scene.speed > 0.25
    scene.driver.goal(Pose(2.0, 0.1, math.nan))
    scene.run(0.5)
    assert scene.speed > 0.25
    scene.until(lambda: scene.driver.status.state.ended, 20)
    scene.run(0.5)
    assert scene.speed < 0.01
    assert scene.driver.silent


def test_the_robot_stops_past_a_waypoint_without_a_next_goal():
    scene = Scene()
    assert scene.goto(1.0, 0.0, through=True, tolerance_lin=0.1) is State.REACHED
    scene.run(1.5)
    assert scene.speed < 0.01
    assert scene.pose.x < 1.3


def test_a_goals_speed_limit_applies_up_to_the_robots():
    scene = Scene()
    scene.driver.goal(Pose(3.0, 0.0, math.nan), Constraints(max_lin_speed=0.1))
    scene.run(3.0)
    assert scene.speed == pytest.approx(0.1, abs=0.01)
    scene.driver.goal(Pose(3.0, 0.0, math.nan), Constraints(max_lin_speed=9.0))
    scene.run(3.0)
    assert scene.speed == pytest.approx(0.3, abs=0.01)


def test_a_goals_heading_holds_when_the_robot_has_stopped():
    scene = Scene()
    scene.driver.goal(Pose(-2.0, 0.0, math.nan))
    scene.until(lambda: abs(scene.pose.theta) > 1.0, 20)  # it turns at full speed
    heading = scene.pose.theta
    assert scene.goto(0.0, 0.0, math.degrees(heading), tolerance_lin=0.3, tolerance_ang=4.0) is State.REACHED
    scene.run(1.0)
    assert abs(math.remainder(scene.pose.theta - heading, math.tau)) < math.radians(4.0)


@pytest.mark.parametrize(("obstacle", "least", "most"), [(False, 0.0, 25.0), (True, 30.0, 60.0)])
def test_the_robot_arrives_with_the_heading_if_there_is_room_for_the_bend(obstacle, least, most):
    scene = Scene()
    if obstacle:
        scene.sim.world.spawn(box(1.2, -0.5, 1.0, 0.2), "box")  # in the bend
    scene.driver.goal(Pose(1.5, 0.0, math.radians(50.0)))
    scene.until(lambda: scene.pose.x > 1.44, 20)
    assert least <= 50.0 - math.degrees(scene.pose.theta) < most
    scene.until(lambda: scene.driver.status.state.ended, 10)
    assert scene.driver.status.state is State.REACHED
    assert not scene.touched


# obstacles


def test_obstacles_at_the_side_do_not_slow_the_robot():
    scene = Scene()
    for side in (-1.0, 1.0):
        scene.sim.world.spawn(box(2.0, 0.6 * side, 3.0, 0.2), f"wall {side}")
    scene.driver.goal(Pose(3.5, 0.0, math.nan))
    scene.until(lambda: scene.pose.x > 1.5, 20)
    assert scene.speed > 0.29
    assert scene.goto(3.5, 0.0) is State.REACHED
    assert not scene.touched


def test_the_robot_drives_out_of_a_dead_end():
    scene = Scene()
    for wall in (box(1.6, 0.0, 0.2, 1.6), box(1.1, 0.7, 1.0, 0.2), box(1.1, -0.7, 1.0, 0.2)):  # open toward the robot
        scene.sim.world.spawn(wall, f"wall {wall.at}")
    assert scene.goto(2.4, 0.0, seconds=90) is State.REACHED
    assert not scene.touched


@pytest.mark.parametrize("heading", [-2.9, -3.0])
def test_the_robot_leaves_an_obstacle_instead_of_creeping_past_it(heading):
    """With these headings of the grid, a line past the box is free on the grid but refused by the collision check."""
    scene = Scene("lab")
    scene.odometry = Pose(2.4, -2.8, heading)
    scene.sim.teleport(BasePose(4.93, 1.0, math.radians(40.0)))
    scene.run(0.3)
    begin = scene.now
    for x, y in ((5.58, 1.57), (6.83, 1.43)):
        assert scene.goto(x, y, through=True, tolerance_lin=0.1) is State.REACHED
    assert scene.now - begin < 11.0
    assert not scene.touched


def test_a_gap_that_is_free_on_the_grid_but_too_narrow_for_the_robot_blocks_the_path():
    scene = Scene()
    for side in (-1.0, 1.0):
        scene.sim.world.spawn(box(1.5, 1.53 * side, 0.1, 2.4), f"wall {side}")  # 2 * 1 cm more than the robot needs
    scene.driver.goal(Pose(3.0, 0.0, math.nan))
    scene.until(lambda: "too narrow" in scene.reasons, 30)
    begin = scene.now
    assert scene.driver.status.state is State.WAITING
    assert scene.driver.status.fault is Fault.BLOCKED
    scene.until(lambda: scene.driver.status.state.ended or scene.now > begin + 20.0, 30)
    still = sum(now > begin and command == (0.0, 0.0, 0.0) for now, command in scene.commands) * 0.01
    assert still < 2.0, "the robot must look for another way"
    assert not scene.touched


@pytest.mark.parametrize("robot", ["r1", pytest.param("ikart_v1", marks=pytest.mark.thorough)])
def test_the_robot_waits_for_or_avoids_a_crossing_person(robot):
    scene = Scene(robot=robot)
    scene.sim.world.spawn(Person(name="eve", at=(1.6, -3.4), path=((1.6, 6.0),), speed=0.8, loop=False), "eve")
    assert scene.goto(3.5, 0.0) is State.REACHED
    assert not scene.touched
    assert State.WAITING in [state for state, _ in scene.states]
    assert "person" in scene.reasons


def test_with_on_obstacle_wait_the_robot_waits_and_drives_on_slowly():
    scene = Scene()
    scene.sim.world.spawn(box(1.5, 0.0), "box")
    scene.driver.goal(Pose(3.0, 0.0, math.nan), Constraints(on_obstacle="wait"))
    scene.until(lambda: scene.driver.status.state is State.WAITING, 20)
    scene.run(3.0)
    assert scene.driver.status == PlannerStatus(State.WAITING, "an obstacle is on the path", Fault.BLOCKED)
    assert list(scene.driver.spoken) == ["Obstacles detected"]
    assert scene.speed < 0.01
    scene.sim.world.remove("box")
    scene.until(lambda: scene.driver.status.state is State.MOVING, 5)
    assert scene.driver.spoken[-1] == "Obstacles removed, thank you"
    begun = scene.now
    scene.until(lambda: scene.commands[-1][1].speed >= 0.29, 5)
    assert scene.now - begun > 0.7, "the robot must accelerate gradually, over about a second"
    scene.until(lambda: scene.driver.status.state.ended, 30)
    assert scene.driver.status.state is State.REACHED
    assert not scene.touched


def test_with_on_obstacle_wait_only_what_the_robot_would_touch_up_to_its_goal_counts():
    """Past a waypoint the path may turn, as around the frame of a door."""
    scene = Scene()
    scene.sim.world.spawn(box(0.59, 0.46), "frame")  # its corner is 0.37 m from the goal
    assert scene.goto(0.12, 0.0, on_obstacle="wait", heading=False, seconds=10.0) is State.REACHED
    assert not scene.touched
    scene.sim.world.spawn(box(0.7, -0.1), "box")  # 0.2 m from the next goal
    scene.driver.goal(Pose(0.3, 0.0, math.nan), Constraints(on_obstacle="wait"))
    scene.run(2.0)
    assert scene.driver.status == PlannerStatus(State.WAITING, "an obstacle is on the path", Fault.BLOCKED)


def test_a_wait_that_takes_too_long_fails_with_the_reason():
    scene = Scene(max_waiting_time=2.0)
    scene.sim.world.spawn(box(1.5, 0.0), "box")
    assert scene.goto(3.0, 0.0, on_obstacle="wait") is State.FAILING
    assert scene.driver.status.fault is Fault.BLOCKED
    assert "an obstacle" in scene.driver.status.reason
    assert "gave up after 2 s" in scene.driver.status.reason


@pytest.mark.parametrize("on_deadlock", ["abort", "pause"])
def test_missing_progress_is_a_deadlock(on_deadlock):
    scene = Scene(deadlock_time=3.0, on_deadlock=on_deadlock)
    scene.fail("slipping wheels")
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(3.5)
    state, reason, _ = scene.driver.status
    assert "deadlock: no progress for 3 s" in reason
    assert state is (State.ABORTED if on_deadlock == "abort" else State.PAUSED)
    scene.sim.stop(on=False)
    if on_deadlock == "pause":
        assert scene.driver.resume()
        scene.until(lambda: scene.driver.status.state.ended, 30)
        assert scene.driver.status.state is State.REACHED


# missing sensors and poses


@pytest.mark.parametrize("missing", ["laser", "frames"])
def test_an_early_goal_waits_for_sensors_and_pose(missing):
    scene = Scene()
    if missing == "laser":
        scene.edit = lambda _ranges: None
    else:
        scene.known = False
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(5.0)
    assert not any(any(command) for _, command in scene.commands)
    assert scene.driver.status.state is State.PREPARING
    scene.edit, scene.known = lambda ranges: ranges, True
    scene.until(lambda: scene.driver.status.state.ended, 30)
    assert scene.driver.status.state is State.REACHED


def test_an_early_goal_fails_with_advice_if_the_pose_stays_unknown():
    scene = Scene(max_waiting_time=3.0)
    scene.known = False
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.until(lambda: scene.driver.status.state.ended, 10)
    state, reason, fault = scene.driver.status
    assert (state, fault) == (State.FAILING, Fault.NOT_LOCALIZED)
    assert "send the goal again" in reason


def test_a_silent_laser_stops_the_robot_until_it_returns():
    scene = Scene()
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(3.0)
    scene.edit = lambda _ranges: None
    at = scene.pose
    scene.run(2.0)
    assert scene.speed < 0.01
    assert scene.pose.distance(at) < 0.35, "half a second, and the braking distance"
    state, reason, fault = scene.driver.status
    assert (state, fault) == (State.WAITING, Fault.NO_LASER)
    assert "the laser is silent" in reason
    scene.edit = lambda ranges: ranges
    scene.until(lambda: scene.driver.status.state.ended, 30)
    assert scene.driver.status.state is State.REACHED


@pytest.mark.parametrize(
    ("ranges", "cause", "known"),
    [
        (None, "the laser is silent", True),
        (None, "the laser is silent", False),
        (math.nan, "the laser is blind", False),
        (0.0, "the laser is blind", True),
    ],
)
def test_a_lost_laser_ends_the_goal_and_is_reported_as_the_cause(ranges, cause, known):
    """The laser is the cause also if localization, which needs the laser, is lost as well."""
    scene = Scene(max_waiting_time=3.0)
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(2.0)
    scene.edit = lambda scan: None if ranges is None else np.full_like(scan, ranges)
    scene.run(1.0)
    scene.known = known
    scene.run(0.1)
    state, reason, fault = scene.driver.status
    assert (state, fault) == (State.WAITING, Fault.NO_LASER)
    assert cause in reason
    scene.until(lambda: scene.driver.status.state.ended, 10)
    state, reason, fault = scene.driver.status
    assert (state, fault) == (State.FAILING, Fault.NO_LASER)
    assert cause in reason


def test_scans_without_a_transform_are_reported():
    scene = Scene()
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(2.0)
    scene.edit, scene.driver.unplaced = lambda _ranges: None, "no frame 'laser'"
    scene.run(2.0)
    reason = "the laser's pose is unknown: no frame 'laser'"
    assert scene.driver.status == PlannerStatus(State.WAITING, reason, Fault.NO_LASER)
    scene.known = False
    scene.run(0.1)
    assert scene.driver.status.fault is Fault.NOT_LOCALIZED
    scene.known, scene.edit = True, lambda ranges: ranges
    scene.run(0.5)
    assert scene.driver.status.state is State.MOVING


@pytest.mark.parametrize("fault", ["emergency stop", "frozen odometry"])
def test_a_base_that_does_not_follow_is_tried_again(fault):
    scene = Scene()
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(3.0)
    scene.fail(fault)
    begun = scene.pose
    scene.run(2.0)
    assert scene.driver.status.state is State.WAITING
    assert "does not follow" in scene.driver.status.reason
    assert scene.speed < 0.01
    assert scene.pose.distance(begun) < 0.55, "at most twice 0.2 m, and the braking distance"
    at = scene.pose
    scene.run(6.0)
    assert scene.pose.distance(at) < 0.25, "short tries, two seconds apart"
    scene.fail("")
    scene.until(lambda: scene.driver.status.state.ended, 40)
    assert scene.driver.status.state is State.REACHED


def test_a_base_that_never_follows_fails_the_goal():
    scene = Scene(max_waiting_time=6.0)
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(2.0)
    scene.fail("emergency stop")
    scene.until(lambda: scene.driver.status.state.ended, 20)
    assert scene.driver.status[::2] == (State.FAILING, Fault.BASE_STANDS)
    assert "does not follow" in scene.driver.status.reason


def test_a_lost_pose_stops_the_robot_until_it_is_known_again():
    scene = Scene()
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(3.0)
    scene.known = False
    scene.tick()
    assert scene.commands[-1][1] == (0.0, 0.0, 0.0)
    reason = "the robot's pose is unknown: no localizer"
    assert scene.driver.status == PlannerStatus(State.WAITING, reason, Fault.NOT_LOCALIZED)
    scene.known = True
    scene.until(lambda: scene.driver.status.state.ended, 30)
    assert scene.driver.status.state is State.REACHED


def test_space_without_valid_ranges_is_not_free():
    scene = Scene()
    scene.edit = lambda ranges: np.where(np.arange(len(ranges)) < 20, ranges, np.nan)  # only the rear is valid
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(20.0)
    assert scene.pose.distance(Pose(0.0, 0.0, 0.0)) < 0.02
    assert "cannot see" in scene.reasons
    scene.edit = lambda ranges: np.full_like(ranges, np.inf)  # no echo within the laser's range means free
    scene.until(lambda: scene.driver.status.state.ended, 30)
    assert scene.driver.status.state is State.REACHED


def test_the_robot_does_not_move_toward_a_side_it_has_not_seen():
    scene = Scene(robot="ikart_v1")
    angles = np.degrees(-math.pi + np.arange(720) * math.tau / 720)
    left = (angles > 45.0) & (angles < 135.0)
    scene.edit = lambda ranges: np.where(left, np.nan, ranges)
    scene.driver.approach(math.pi / 2, 0.2, 2.0)
    scene.run(2.0)
    assert abs(scene.pose.y) < 0.05
    scene.edit = lambda ranges: ranges
    scene.driver.approach(math.pi / 2, 0.2, 2.0)
    scene.run(2.5)
    assert scene.pose.y > 0.2


def test_obstacles_in_a_blind_sector_are_remembered():
    """A box that the laser saw earlier is in a blind sector when the robot approaches it."""
    scene = Scene(robot="ikart_v1")
    scene.sim.world.spawn(box(0.0, 0.9), "box")
    angles = np.degrees(-math.pi + np.arange(720) * math.tau / 720)
    left = (angles > 30.0) & (angles < 150.0)
    scene.run(0.5)
    scene.edit = lambda ranges: np.where(left, np.nan, ranges)
    scene.driver.approach(math.pi / 2, 0.3, 6.0)
    scene.run(6.0)
    assert not scene.touched
    assert 0.1 < scene.pose.y < 0.9 - 0.2 - 0.4, "up to the box, from memory"


@pytest.mark.parametrize("begun", [Pose(0.4, 0.0, 0.0), Pose(0.0, 0.0, 1.0)])
def test_an_odometry_reset_clears_the_grid(begun):
    driver, origin = Driver(), Pose(0.0, 0.0, 0.0)
    driver.scan(LaserScan(1_000_000_000, -math.pi, math.tau / 90, 0.1, 20.0, np.full(90, 1.0)), origin)
    driver.step(1.0, origin, origin)
    driver.step(1.05, origin, Pose(0.1, 0.0, 0.1))
    assert driver.grid.scanned == 1.0
    driver.step(1.05, origin, Pose(0.0, 0.0, 0.0))
    driver.step(1.05, origin, begun)
    assert driver.grid.scanned is None


# moves without a goal


def test_an_approach_ends_at_obstacles_and_backwards_after_two_seconds():
    scene = Scene()
    scene.sim.world.spawn(box(1.5, 0.0), "box")
    scene.driver.approach(0.0, 0.3, 10.0)
    scene.run(10.5)
    assert scene.driver.status.state is State.IDLE
    assert not scene.touched
    assert 1.3 - 0.3 - 0.1 < scene.pose.x < 1.3 - 0.3
    at = scene.pose.x
    scene.driver.approach(math.pi, 0.2, 10.0)
    scene.run(4.0)
    assert 0.2 < at - scene.pose.x < 0.2 * MAX_RETREAT + 0.05


def test_a_retreat_is_short_and_without_collisions():
    scene = Scene(enable_retreat=True, retreat_duration=2.0)
    scene.sim.world.spawn(box(-0.7, 0.0), "box")
    scene.run(0.3)
    scene.driver.goal(Pose(1.0, 0.0, math.nan))
    scene.run(1.5)
    assert scene.states[-1][0] is State.PREPARING
    assert -0.2 - 0.01 < scene.pose.x < -0.05
    scene.until(lambda: scene.driver.status.state.ended, 30)
    assert scene.driver.status.state is State.REACHED
    assert not scene.touched
    assert min(c.vx for _, c in scene.commands) >= -0.2
    backwards = [now for now, c in scene.commands if c.vx < 0.0]
    assert backwards[-1] - backwards[0] <= MAX_RETREAT


def test_a_retreat_lasts_at_most_two_seconds():
    scene = Scene(enable_retreat=True, retreat_duration=300.0)
    scene.run(0.3)
    scene.driver.goal(Pose(1.0, 0.0, math.nan))
    scene.run(5.0)
    backwards = [now for now, c in scene.commands if c.vx < 0.0]
    assert MAX_RETREAT - 0.1 < backwards[-1] - backwards[0] <= MAX_RETREAT
    assert scene.driver.status.state is State.MOVING


# pause, cancel and settings


def test_a_paused_goal_stops_the_robot_until_it_is_resumed():
    scene = Scene()
    assert not scene.driver.pause(1.0), "no goal to pause"
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(2.0)
    assert scene.driver.pause(1.0)
    scene.run(0.9)
    assert scene.driver.status.state is State.PAUSED
    assert scene.commands[-1][1].speed == 0.0
    scene.run(0.3)
    assert scene.driver.status.state is State.MOVING, "the pause is over"
    scene.driver.pause()
    scene.run(30.0)
    assert scene.driver.status.state is State.PAUSED
    assert scene.driver.resume()
    scene.until(lambda: scene.driver.status.state.ended, 30)
    assert scene.driver.status.state is State.REACHED


def test_a_cancel_stops_the_robot_and_invalid_goals_are_rejected():
    scene = Scene()
    scene.driver.goal(Pose(2.0, 0.0, math.nan))
    scene.run(2.0)
    scene.driver.cancel()
    scene.tick()
    assert scene.commands[-1][1] == (0.0, 0.0, 0.0)
    assert scene.driver.silent
    with pytest.raises(ValueError, match="finite"):
        scene.driver.goal(Pose(math.nan, 0.0, 0.0))


def test_settings_can_change_while_driving():
    scene = Scene()
    scene.driver.goal(Pose(3.0, 0.0, math.nan))
    scene.run(2.0)
    scene.driver.settings = scene.driver.settings.model_copy(update={"max_lin_speed": 0.15})
    scene.run(2.0)
    assert scene.speed == pytest.approx(0.15, abs=0.01)
