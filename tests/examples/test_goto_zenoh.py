"""The zenoh example with lost, repeated and missing status messages."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from tests.peers.daemon.examples import EXAMPLES
from tests.support.ports import free_port
from tests.support.zenoh_router import open_router

Status = dict[str, Any]


def status(stamp: int, state: str) -> Status:
    return {"header": {"stamp": {"sec": stamp}}, "state": state, "reason": ""}


class Robot:
    """Serves the examples' keys; `goes`, which the test sets, runs when a goal arrives."""

    def __init__(self) -> None:
        self.place = f"tcp/127.0.0.1:{free_port()}"
        config = zenoh.Config()
        config.insert_json5("mode", '"router"')
        config.insert_json5("listen/endpoints", json.dumps([self.place]))
        self.session = open_router(config)
        self.now: Status | None = status(1, "goal_reached")  # the status of the previous goal
        self.goes: Callable[[], None] = lambda: None
        self.session.declare_queryable("robot/go_to", self._go)
        self.session.declare_queryable("robot/navigation", self._serve_status)

    def publish(self, status: Status) -> None:
        self.now = status
        self.session.put("robot/navigation", json.dumps(status))

    def _go(self, query: zenoh.Query) -> None:
        with query:
            self.goes()
            query.reply(query.key_expr, json.dumps({"success": True, "message": "drives"}))

    def _serve_status(self, query: zenoh.Query) -> None:
        with query:
            if self.now is not None:
                query.reply(query.key_expr, json.dumps(self.now))


@pytest.fixture
def robot() -> Iterator[Robot]:
    fake_robot = Robot()
    yield fake_robot
    fake_robot.session.close()


@pytest.fixture
def example() -> Any:
    spec = importlib.util.spec_from_file_location("goto_location_zenoh", EXAMPLES / "goto_location_zenoh.py")
    assert spec is not None
    assert spec.loader is not None
    module: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.SILENCE = 0.3
    return module


@pytest.mark.parametrize(("end", "code"), [("goal_reached", 0), ("aborted", 1)])
def test_the_example_ends_if_the_first_status_is_the_end_of_the_drive(
    robot: Robot, example: Any, end: str, code: int
) -> None:
    robot.goes = lambda: robot.publish(status(2, end))
    assert example.main("kitchen", robot.place) == code


def test_the_example_queries_the_status_if_no_update_arrives(
    robot: Robot, example: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    def goes() -> None:
        robot.publish(status(1, "goal_reached"))  # the end of the previous goal, repeated
        robot.now = status(2, "aborted")

    robot.goes = goes
    assert example.main("kitchen", robot.place) == 1
    assert capsys.readouterr().out.splitlines() == ["drives", "aborted "], "the end of the previous goal is ignored"


def test_the_example_continues_after_a_temporary_planner_error(robot: Robot, example: Any) -> None:
    def goes() -> None:
        robot.publish(status(2, "error"))
        robot.publish(status(3, "moving"))
        robot.publish(status(4, "goal_reached"))

    robot.goes = goes
    assert example.main("kitchen", robot.place) == 0


def test_the_example_fails_if_no_status_is_available(robot: Robot, example: Any) -> None:
    robot.goes = lambda: setattr(robot, "now", None)
    with pytest.raises(SystemExit, match="no navigation status"):
        example.main("kitchen", robot.place)
