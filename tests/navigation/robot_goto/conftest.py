"""A running RobotGoto for the tests of its module."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.navigation.robot_goto.deployed import Goto, pose_of
from tests.support.wait import until


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Goto]:
    with Goto(tmp_path_factory.mktemp("goto"), keep_out_map="store") as goto:
        yield goto


@pytest.fixture
def place(running: Goto) -> Goto:
    """The idle RobotGoto, with its robot in the center of the room."""
    robot, module = running.robot, running.module
    robot.sees = robot.knows = True
    running.host.loop.call(lambda: module.stop_driving("the test begins"))
    running.host.loop.call(module.driver.reset)
    robot.loop.call(lambda: robot.stand(0.0, 0.0, 0.0))

    begun = module.now()

    def ready() -> bool:
        pose, scanned = pose_of(module), module.driver.grid.scanned
        stands = pose is not None and abs(pose.x) < 1e-6
        # the jump of the robot's pose clears the grid: wait for a later scan
        return stands and scanned is not None and scanned > begun + 0.3 and module.health().state == "running"

    until(ready, "the robot is in the center and its laser works", 30)
    robot.commands.clear()
    return running
