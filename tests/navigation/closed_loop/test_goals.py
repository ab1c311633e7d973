"""Random goals with Midspan's planner and localizer are reached without contact and without entering keep-out cells.

Each world gets two goals; benchmarks/goals.py drives both bases to hundreds of goals.
"""

from __future__ import annotations

import itertools

import pytest

from benchmarks.closedloop.drive import Loop
from benchmarks.closedloop.judge import Judge
from benchmarks.closedloop.robot import CAMERA, Robot
from benchmarks.closedloop.stack import Ours
from benchmarks.closedloop.targets import Targets
from benchmarks.closedloop.worlds import world

NEAR = 2.2
"""Length limit of the path to a goal, meters."""

BASES = ("r1", "ikart_v1")
WORLDS = ("apartment", "office", "lab", "hall", "tables", "two_storeys/ground", "two_storeys/upper")
FEW = {("apartment", "r1")}
"""The case of a normal run; the others would show nothing more about a machine."""

GOALS = 2
"""Goals in each world; the second one starts where the first drive ended."""

WORLDS_OF_BOTH = {"two_storeys/ground"}
"""Worlds for the second base, which has another size and other wheels."""

CASES = [
    pytest.param(name, base, marks=() if (name, base) in FEW else pytest.mark.thorough)
    for name, base in itertools.product(WORLDS, BASES)
    if base == BASES[0] or name in WORLDS_OF_BOTH
]


@pytest.mark.parametrize(("name", "base"), CASES)
def test_random_goals_are_reached_without_a_contact(name: str, base: str) -> None:
    there = world(name)
    robot = Robot(there.plan, base, seed=3, camera=CAMERA if there.hides else None)
    judge = Judge(robot, (*there.keep_out, *there.drops))
    loop = Loop(robot, Ours(robot, there), judge)
    loop.settle()
    for goal, way in itertools.islice(Targets(there, robot, seed=3, farthest=NEAR), GOALS):
        drive = loop.drive(goal, way)
        assert drive.reached, (goal, drive)
        assert drive.lost < 0.15
        assert 0.0 <= drive.stood < 0.5 * drive.seconds
    assert judge.contacts == 0, judge.where
    assert judge.entered == 0, judge.where
