"""Every transition of RobotGoto: in the table, and made by the driver in a scene without a simulator."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bridge.messages.scan import LaserScan
from bridge.state_machine import Machine
from navigation.constraints import Constraints
from navigation.pose import Pose
from navigation.robot_goto.driver import Driver
from navigation.robot_goto.machine import DRIVER, DriverEvent, DriverState
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_goto.steering import STILL
from navigation.status import State

PAIRS = [(state, event) for state in DriverState for event in DriverEvent]
ROWS = [(state, event) for state, row in DRIVER.items() for event in row]
S, E = DriverState, DriverEvent


def ids(value: DriverState | DriverEvent) -> str:
    return value.name.lower()


@pytest.mark.parametrize(("state", "event"), PAIRS, ids=ids)
def test_each_event_leads_to_the_state_given_by_the_table(state: DriverState, event: DriverEvent) -> None:
    machine: Machine[DriverState, DriverEvent] = Machine(DRIVER, state)
    following = DRIVER[state].get(event, state)
    assert machine.on(event) == (following is not state)
    assert machine.state is following


def test_each_state_is_reachable() -> None:
    reached, pending = {S.IDLE}, [S.IDLE]
    while pending:
        following = set(DRIVER[pending.pop()].values()) - reached
        reached |= following
        pending.extend(following)
    assert reached == set(S)


def test_a_robot_with_a_goal_is_never_published_as_ended() -> None:
    with_goal = {S.PREPARING, S.DRIVING, S.WAITING, S.PAUSED}
    assert {state for state in S if not state.published.ended} == with_goal | {S.APPROACHING}
    assert {state for state in S if E.PAUSE in DRIVER[state]} == with_goal


class RecordingMachine(Machine[DriverState, DriverEvent]):
    """The driver's machine, which records its transitions: state, event, next state."""

    def __init__(self) -> None:
        super().__init__(DRIVER, S.IDLE)
        self.transitions: list[tuple[DriverState, DriverEvent, DriverState]] = []

    def on(self, event: DriverEvent) -> bool:
        before = self.state
        changed = super().on(event)
        self.transitions.append((before, event, self.state))
        return changed


class Robot:
    """A driver in an empty hall, with a base that follows its commands exactly.

    Attributes:
        known: whether the pose on the map is known.
        follows: whether the base moves.
        slips: whether only the odometry moves, not the robot.
        offset: the odometry frame's pose on the map.
        wall: meters to a wall in front of the robot.
        laser_on: whether the laser sends scans.
    """

    def __init__(self, **settings: Any) -> None:
        section = {"max_waiting_time": 2.5, "deadlock_time": 3.0, "laser_timeout": 0.5, **settings}
        self.driver = Driver(RobotGotoSection().model_copy(update=section))
        self.machine = self.driver.machine = RecordingMachine()
        self.known = self.follows = True
        self.slips = False
        self.offset = self.odometry = Pose(0.0, 0.0, 0.0)
        self.wall = math.inf
        self.now = 1.0
        self.laser_on = True

    def step(self, seconds: float = 0.1) -> None:
        for _ in range(round(seconds / 0.1)):
            self.now += 0.1
            ranges = np.full(360, 4.0)
            ranges[170:190] = min(4.0, self.wall)
            if self.laser_on:
                scan = LaserScan(round(self.now * 1e9), -math.pi, math.tau / 360, 0.1, 20.0, ranges)
                self.driver.scan(scan, self.odometry)
            pose = self.offset @ self.odometry
            command = self.driver.step(self.now, pose if self.known else None, self.odometry)
            if self.follows:
                self.odometry = self.odometry @ Pose(command.vx * 0.1, command.vy * 0.1, command.omega * 0.1)
            if self.slips:
                self.offset = pose @ self.odometry.inverse

    def goal(self, x: float = 3.0, **constraints: Any) -> None:
        self.driver.goal(Pose(x, 0.0, math.nan), Constraints(**constraints))

    def localize(self, x: float) -> None:
        """Correct the pose on the map: the robot is x meters from the origin."""
        self.offset = Pose(x, 0.0, 0.0) @ self.odometry.inverse


def idle(robot: Robot) -> None:
    assert robot.machine.state is S.IDLE


def approaching(robot: Robot) -> None:
    robot.driver.approach(0.0, 0.1, 1.0)


def preparing(robot: Robot, **constraints: Any) -> None:
    robot.known = False
    robot.goal(**constraints)
    robot.step()


def driving(robot: Robot, **constraints: Any) -> None:
    robot.goal(**constraints)
    robot.step(0.5)


def waiting(robot: Robot, **constraints: Any) -> None:
    driving(robot, **constraints)
    robot.known = False
    robot.step()


def paused(robot: Robot) -> None:
    driving(robot)
    robot.driver.pause()


def passing(robot: Robot) -> None:
    robot.goal(0.02, through=True, tolerance_lin=0.1)
    robot.step()


def reached(robot: Robot) -> None:
    robot.goal(0.0)
    robot.step()


def aborted(robot: Robot) -> None:
    robot.laser_on = False
    approaching(robot)
    robot.step()
    robot.laser_on = True


def failed(robot: Robot) -> None:
    preparing(robot)
    robot.step(3.0)
    robot.known = True


STATES: dict[DriverState, Callable[[Robot], None]] = {
    S.IDLE: idle,
    S.APPROACHING: approaching,
    S.PREPARING: preparing,
    S.DRIVING: driving,
    S.WAITING: waiting,
    S.PAUSED: paused,
    S.PASSING: passing,
    S.REACHED: reached,
    S.ABORTED: aborted,
    S.FAILED: failed,
}
"""How to bring the robot into each state."""


def back_off(robot: Robot) -> None:
    assert robot.driver.command == STILL
    robot.driver.settings = robot.driver.settings.model_copy(update={"enable_retreat": True})
    robot.goal()


def go(robot: Robot) -> None:
    robot.known = True
    robot.step()


def lose_pose(robot: Robot) -> None:
    robot.known = False
    robot.step()


def lose_pose_before_driving(robot: Robot) -> None:
    robot.goal()
    lose_pose(robot)


def meet_wall(robot: Robot) -> None:
    robot.known, robot.wall = True, 0.5
    robot.step()


def arrive(robot: Robot) -> None:
    robot.localize(3.0)
    go(robot)


def pass_waypoint(robot: Robot) -> None:
    robot.goal(through=True)
    lose_pose(robot)
    arrive(robot)


def pass_waypoint_after_a_wait(robot: Robot) -> None:
    robot.known = True
    waiting(robot, through=True)
    arrive(robot)


def drive_on_to_a_waypoint(robot: Robot) -> None:
    driving(robot, through=True)
    arrive(robot)


def wait_long(robot: Robot) -> None:
    robot.step(3.0)


def stop_following(robot: Robot) -> None:
    robot.follows = False
    robot.step(6.0)


def slip(robot: Robot) -> None:
    robot.slips = True
    robot.step(4.0)


def lose_laser(robot: Robot) -> None:
    robot.laser_on = False
    robot.step()


EVENTS: dict[DriverEvent, Callable[[Robot], Any]] = {
    E.GOAL: Robot.goal,
    E.BACK_OFF: back_off,
    E.APPROACH: approaching,
    E.CANCEL: lambda robot: robot.driver.cancel(),
    E.PAUSE: lambda robot: robot.driver.pause(),
    E.RESUME: lambda robot: robot.driver.resume(),
    E.NOT_READY: lose_pose,
    E.WAIT: lose_pose,
    E.GO: go,
    E.WAYPOINT: pass_waypoint,
    E.REACH: arrive,
    E.FINISH: lambda robot: robot.step(2.0),
    E.ABORT: slip,
    E.GIVE_UP: wait_long,
}
"""How to cause each event."""

SPECIAL: dict[tuple[DriverState, DriverEvent], Callable[[Robot], None]] = {
    (S.PREPARING, E.WAIT): meet_wall,
    (S.DRIVING, E.NOT_READY): lose_pose_before_driving,
    (S.DRIVING, E.WAYPOINT): drive_on_to_a_waypoint,
    (S.WAITING, E.WAYPOINT): pass_waypoint_after_a_wait,
    (S.DRIVING, E.GIVE_UP): stop_following,
    (S.APPROACHING, E.ABORT): lose_laser,
}
"""The same for transitions whose cause in `EVENTS` does not work."""


@pytest.mark.parametrize(("state", "event"), ROWS, ids=ids)
def test_the_driver_makes_each_transition(state: DriverState, event: DriverEvent) -> None:
    robot = Robot()
    STATES[state](robot)
    assert robot.machine.state is state
    SPECIAL.get((state, event), EVENTS[event])(robot)
    assert (state, event, DRIVER[state][event]) in robot.machine.transitions
    assert all(event in DRIVER[state] for state, event, _ in robot.machine.transitions)
    assert robot.driver.status.state is robot.machine.state.published


@pytest.mark.parametrize("state", [state for state in S if E.PAUSE not in DRIVER[state]], ids=ids)
def test_a_pause_or_resume_without_a_goal_changes_nothing(state: DriverState) -> None:
    robot = Robot()
    STATES[state](robot)
    status, transitions = robot.driver.status, len(robot.machine.transitions)
    assert not robot.driver.pause(1.0)
    assert not robot.driver.resume()
    assert (robot.driver.status, len(robot.machine.transitions)) == (status, transitions)


@pytest.mark.parametrize("state", [S.PREPARING, S.DRIVING, S.WAITING], ids=ids)
def test_only_a_pause_is_resumed(state: DriverState) -> None:
    robot = Robot()
    STATES[state](robot)
    assert not robot.driver.resume()
    assert robot.machine.state is state


@pytest.mark.parametrize("cause", [lose_pose, lose_laser, meet_wall], ids=lambda cause: str(cause.__name__))
def test_a_robot_that_cannot_drive_on_is_commanded_to_stand(cause: Callable[[Robot], None]) -> None:
    robot = Robot(laser_timeout=0.05)
    driving(robot, on_obstacle="wait")
    assert robot.driver.command.speed > 0.0
    cause(robot)
    assert robot.driver.command == STILL
    assert robot.driver.status.state is State.WAITING
    assert not robot.driver.silent, "zero velocity is published while there is a goal"


def test_a_stall_of_this_process_does_not_count_as_waiting_or_as_a_deadlock() -> None:
    robot = Robot()
    waiting(robot)
    robot.now += 10.0
    robot.step()
    assert robot.machine.state is S.WAITING
    robot.known = True
    robot.step()
    assert robot.machine.state is S.DRIVING
