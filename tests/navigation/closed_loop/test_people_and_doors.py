"""Changes during a drive: people who cross the path, and doors that are closed and opened again."""

from __future__ import annotations

import math

import pytest

from benchmarks.closedloop.drive import Loop
from benchmarks.closedloop.judge import Judge
from benchmarks.closedloop.robot import Robot
from benchmarks.closedloop.stack import Ours
from benchmarks.closedloop.worlds import World
from navigation.pose import Pose
from navigation.status import State
from sim import export
from sim.plan import Floor, Person, Plan

WALLS = (((0.0, 0.0), (7.0, 0.0), (7.0, 5.0), (0.0, 5.0), (0.0, 0.0)), ((3.5, 0.0), (3.5, 5.0)))
DOORS = (
    {"name": "near", "line": ((3.5, 0.6), (3.5, 1.8))},
    {"name": "far", "line": ((3.5, 3.2), (3.5, 4.4))},
)
START = (1.0, 1.2, 0.0)
GOAL = Pose(5.2, 1.2, 0.0)


def loop_in(**floor: object) -> Loop:
    """Return a robot in one of two rooms with two doors between them."""
    plan = Plan(name="rooms", floors={"rooms": Floor(**{"walls": WALLS, "start": START, **floor})})
    there = World("rooms", plan, export.grid(plan, "rooms"), ())
    robot = Robot(plan, "r1")
    loop = Loop(robot, Ours(robot, there), Judge(robot, ()))
    loop.settle()
    return loop


def drive_until(loop: Loop, x: float) -> None:
    """Start a drive to the goal, and return when the robot is at a place."""
    loop.stack.goal(GOAL)
    loop.stack.step()
    assert loop.run(40, lambda: loop.robot.truth.x > x), loop.stack.status


def arrive(loop: Loop, seconds: float) -> None:
    assert loop.run(seconds, lambda: loop.stack.status[0].ended), (loop.stack.status, loop.robot.truth)
    assert loop.stack.status[0] is State.REACHED, loop.stack.status
    assert loop.robot.truth.distance(GOAL) < 0.25
    assert loop.judge.contacts == 0, loop.judge.where


@pytest.mark.thorough
def test_a_door_that_closes_during_the_drive_is_avoided() -> None:
    loop = loop_in(doors=DOORS)
    drive_until(loop, 2.2)
    loop.robot.simulation.world.open("near", is_open=False)
    north = 0.0

    def ended() -> bool:
        nonlocal north
        north = max(north, loop.robot.truth.y)
        return loop.stack.status[0].ended

    loop.run(90, ended)
    assert north > 3.0  # through the other door
    arrive(loop, 1)


@pytest.mark.thorough
def test_with_all_doors_closed_the_robot_waits_until_one_opens() -> None:
    loop = loop_in(doors=DOORS[:1])
    drive_until(loop, 2.2)
    loop.robot.simulation.world.open("near", is_open=False)
    loop.run(15)
    assert loop.stack.status[0] is State.WAITING, loop.stack.status
    assert loop.robot.moving < 0.01
    loop.robot.simulation.world.open("near", is_open=True)
    arrive(loop, 60)


def test_a_person_who_crosses_the_path_is_not_touched() -> None:
    loop = loop_in(walls=WALLS[:1])
    drive_until(loop, 1.6)
    world = loop.robot.simulation.world
    world.spawn(Person(name="bob", at=(3.6, 4.5), path=((3.6, 0.5), (3.6, 4.5)), speed=0.7), "bob")
    bob, nearest = world.people["bob"], math.inf

    def ended() -> bool:
        nonlocal nearest
        truth = loop.robot.truth
        nearest = min(nearest, math.hypot(bob.x - truth.x, bob.y - truth.y))
        return loop.stack.status[0].ended

    loop.run(60, ended)
    assert nearest < 1.5  # the person came near the robot
    arrive(loop, 1)
