"""What zenoh's client of a location does where it does not hear all that the robot says."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from tests.examples.deployment import EXAMPLES
from tests.support.ports import free_port

Status = dict[str, Any]


def status(stamp: int, state: str) -> Status:
    return {"header": {"stamp": {"sec": stamp}}, "state": state, "reason": ""}


class Robot:
    """Answers at the keys of the examples: what it says once it was asked to go somewhere is the test's."""

    def __init__(self) -> None:
        self.place = f"tcp/127.0.0.1:{free_port()}"
        config = zenoh.Config()
        config.insert_json5("mode", '"router"')
        config.insert_json5("listen/endpoints", json.dumps([self.place]))
        self.session = zenoh.open(config)
        self.now: Status | None = status(1, "goal_reached")  # of the goal before
        self.goes: Callable[[], None] = lambda: None
        self.session.declare_queryable("robot/go_to", self._go)
        self.session.declare_queryable("robot/navigation", self._tell)

    def says(self, said: Status) -> None:
        self.now = said
        self.session.put("robot/navigation", json.dumps(said))

    def _go(self, query: zenoh.Query) -> None:
        with query:
            self.goes()
            query.reply(query.key_expr, json.dumps({"success": True, "message": "drives"}))

    def _tell(self, query: zenoh.Query) -> None:
        with query:
            if self.now is not None:
                query.reply(query.key_expr, json.dumps(self.now))


@pytest.fixture
def robot() -> Iterator[Robot]:
    made = Robot()
    yield made
    made.session.close()


@pytest.fixture
def example() -> Any:
    spec = importlib.util.spec_from_file_location("goto_location_zenoh", EXAMPLES / "goto_location_zenoh.py")
    assert spec is not None
    assert spec.loader is not None
    made: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    made.SILENCE = 0.3
    return made


@pytest.mark.parametrize(("end", "code"), [("goal_reached", 0), ("aborted", 1)])
def test_it_hears_the_end_alone(robot: Robot, example: Any, end: str, code: int) -> None:
    robot.goes = lambda: robot.says(status(2, end))
    assert example.main("kitchen", robot.place) == code


def test_it_hears_nothing_and_asks(robot: Robot, example: Any, capsys: pytest.CaptureFixture[str]) -> None:
    def goes() -> None:
        robot.says(status(1, "goal_reached"))  # it is told again how the goal before ended
        robot.now = status(2, "aborted")

    robot.goes = goes
    assert example.main("kitchen", robot.place) == 1
    assert capsys.readouterr().out.splitlines() == ["drives", "aborted "], "the end before is not its own"


def test_a_planner_that_is_waited_for_is_no_end(robot: Robot, example: Any) -> None:
    def goes() -> None:
        robot.says(status(2, "error"))
        robot.says(status(3, "moving"))
        robot.says(status(4, "goal_reached"))

    robot.goes = goes
    assert example.main("kitchen", robot.place) == 0


def test_the_robot_is_lost(robot: Robot, example: Any) -> None:
    robot.goes = lambda: setattr(robot, "now", None)
    with pytest.raises(SystemExit, match="not heard any more"):
        example.main("kitchen", robot.place)
