"""RobotGoto stops: zero is repeated before its topics close, unless it did not command the base."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.client.velocity import STOP_SECONDS
from bridge.messages.actions import GoalState
from bridge.modules import worker as modules_worker
from navigation.constraints import Constraints
from tests.navigation.robot_goto.deployed import Goto
from tests.support.wait import until

STILL = (0.0, 0.0, 0.0)
SLOW = Constraints(max_lin_speed=0.1).to_text()


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Goto]:
    monkeypatch.setattr(modules_worker, "WIND_DOWN_SECONDS", 60.0)
    monkeypatch.setattr(modules_worker, "STOP_SECONDS", 60.0)
    with Goto(tmp_path) as goto:
        until(lambda: goto.module.health().state == "running", "the module works", 30)
        yield goto


def test_zero_is_repeated_when_the_module_stops(place: Goto) -> None:
    robot, zeros = place.robot, round(STOP_SECONDS / place.module._section.period)
    sent = robot.send(2.0, 0.0, 0.0, SLOW)
    until(lambda: robot.x > 0.05, "the robot drives", 30)
    place.worker.stop()
    status, result = sent.end()
    assert (status, result["error_msg"]) == (GoalState.ABORTED, "RobotGoto has stopped")
    until(lambda: len(robot.commands) > zeros and set(robot.commands[-zeros:]) == {STILL}, "zero is repeated", 20)


def test_a_goal_is_refused_while_the_module_stops(place: Goto) -> None:
    robot, module = place.robot, place.module
    robot.send(2.0, 0.0, 0.0, SLOW)
    until(lambda: robot.x > 0.05, "the robot drives", 30)
    place.host.loop.call(lambda: module.begin_stop(lambda: None))
    status, result = robot.send(1.0, 0.0).end()
    assert (status, result["error_msg"]) == (GoalState.ABORTED, "RobotGoto is stopping")
    until(lambda: robot.commands[-1] == STILL, "the robot is stopped", 20)


def test_a_module_that_does_not_drive_stops_without_a_command(place: Goto) -> None:
    place.worker.stop()
    assert place.robot.commands == []


def test_the_goal_ends_although_the_begin_of_the_stop_fails(place: Goto, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, module = place.robot, place.module
    abort, failed = module._abort, list[str]()

    def fail_once(reason: str, *more: Any) -> None:
        if not failed:
            failed.append(reason)
            raise RuntimeError("the test's error")
        abort(reason, *more)

    sent = robot.send(2.0, 0.0, 0.0, SLOW)
    until(lambda: robot.x > 0.05, "the robot drives", 30)
    monkeypatch.setattr(module, "_abort", fail_once)
    place.worker.stop()
    status, result = sent.end()
    assert (status, result["error_msg"]) == (GoalState.ABORTED, "RobotGoto has stopped")
    assert failed == ["RobotGoto has stopped"]
    until(lambda: robot.commands[-1] == STILL, "the robot is stopped", 20)
