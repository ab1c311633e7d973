"""What pages show of a drive, especially during a pause."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Event
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.hub.node import Hub
from bridge.hub.wire.qos import LATCHED, Qos
from bridge.messages.actions import names, types
from bridge.modules.loop import EventLoop
from bridge.web.verbs.robot import NAMED, TRIGGER, RobotVerbs
from navigation.gateway.telemetry import PATH
from navigation.messages import NAVIGATE
from navigation.status import NO_GOAL, STATUS, PlannerStatus, State, status_message
from tests.peers.browser.page import TestPage
from tests.peers.hub.node import HubNode
from tests.peers.navigation.gateway import pose
from tests.support.wait import until
from tests.web.conftest import Desk

GOAL, OTHER = bytes([1] * 16), bytes([2] * 16)
STRAIGHT, DETOUR = [0.0, 0.0, 4.0, 0.0], [0.0, 0.0, 0.0, 3.0, 4.0, 0.0]


class Planner(HubNode):
    """The gateway's status, and a planner's path and feedback."""

    def __init__(self, settings: Any) -> None:
        super().__init__(settings)
        self._action = names(Config().navigation.at("nav2"))
        self.on(self._open)

    def _open(self) -> None:
        self._status = self.node.publisher("/navigation/status", STATUS, LATCHED)
        self._path = self.node.publisher("/plan", PATH, LATCHED)
        self._feedback = self.node.publisher(self._action.feedback, types(NAVIGATE).feedback, Qos(depth=1))

    def state(self, state: State, goal: bytes = GOAL) -> None:
        message = status_message({}, PlannerStatus(state), goal_id=goal, goal=pose(4.0))
        self.on(lambda: self._status.publish(message))

    def path(self, points: list[float]) -> None:
        poses = [pose(*xy) for xy in zip(points[::2], points[1::2], strict=True)]
        self.on(lambda: self._path.publish({"header": {"frame_id": "map"}, "poses": poses}))

    def distance(self, left: float) -> None:
        self.on(lambda: self._feedback.publish({"feedback": {"distance_remaining": left}}))

    def drive(self, page: TestPage) -> None:
        """Drive on a straight path; return when the page shows the path."""
        self.state(State.MOVING)
        page.value("driving", lambda value: value and value["state"] == "moving")
        self.path(STRAIGHT)
        page.value("path", lambda value: value and value["points"] == STRAIGHT)

        def reported() -> bool:
            self.distance(3.24)
            page.read()
            return bool(page.values["driving"]["value"]["distance"])

        page.until(reported, "the distance is shown")


@pytest.fixture
def planner(desk: Desk) -> Iterator[Planner]:
    planner_ = Planner(desk.hubs.settings("planner"))
    yield planner_
    planner_.close()


@pytest.fixture
def page(desk: Desk) -> Iterator[TestPage]:
    with TestPage(desk.port) as page_:
        page_.watch("driving", "path")
        yield page_


def shown(page: TestPage, state: str) -> tuple[float | None, list[float]]:
    """Return distance and path, once the page shows the state, and has then received the reply to a ping."""
    page.value("driving", lambda value: value["state"] == state)
    assert page.call("ping")["ok"]
    return page.values["driving"]["value"]["distance"], page.values["path"]["value"]["points"]


@pytest.mark.parametrize("cleared", ["before the pause", "after the pause", "never"])
def test_a_pause_keeps_distance_and_path(planner: Planner, page: TestPage, cleared: str) -> None:
    planner.drive(page)

    def clear() -> None:
        """Clear the path and the distance, as planners do when their goal is canceled for a pause."""
        planner.path([])
        planner.distance(0.0)

    if cleared == "before the pause":
        clear()
        assert shown(page, "moving") == (3.2, STRAIGHT), "nothing changes until the robot stands"
    planner.state(State.PAUSED)
    page.value("driving", lambda value: value["state"] == "paused")
    if cleared == "after the pause":
        clear()
    assert shown(page, "paused") == (3.2, STRAIGHT)
    assert page.values["driving"]["value"]["goal"]["x"] == 4.0
    planner.state(State.MOVING)
    assert shown(page, "moving") == (3.2, STRAIGHT)
    planner.path(DETOUR)
    page.value("path", lambda value: value["points"] == DETOUR)


def test_a_page_that_opens_during_a_pause_shows_distance_and_path(desk: Desk, planner: Planner) -> None:
    with TestPage(desk.port) as first:
        first.watch("driving", "path")
        planner.drive(first)
        planner.path([])
        planner.state(State.PAUSED)
        first.value("driving", lambda value: value["state"] == "paused")
    for _ in range(2):
        with TestPage(desk.port) as page:
            page.watch("driving", "path")
            page.value("path")
            assert shown(page, "paused") == (3.2, STRAIGHT)
    planner.state(State.IDLE, NO_GOAL)
    with TestPage(desk.port) as page:
        page.watch("driving", "path")
        page.value("path", lambda value: not value["points"])  # the page may have opened before the state arrived
        assert shown(page, "idle") == (None, [])


@pytest.mark.parametrize(
    ("state", "goal"), [(State.IDLE, NO_GOAL), (State.ABORTED, GOAL), (State.MOVING, OTHER), (State.PAUSED, OTHER)]
)
def test_a_new_state_or_goal_after_a_pause_clears_the_distance(
    planner: Planner, page: TestPage, state: State, goal: bytes
) -> None:
    planner.drive(page)
    planner.state(State.PAUSED)
    assert shown(page, "paused") == (3.2, STRAIGHT)
    planner.state(state, goal)
    page.value("driving", lambda value: value["distance"] is None)
    page.value("path", lambda value: not value["points"] or not state.ended, "the path follows the state")
    distance, points = shown(page, state.value)
    assert distance is None
    assert points == ([] if state.ended else STRAIGHT), (
        "after a new goal, the old path is shown until the planner replaces it"
    )


def test_manual_driving_during_a_pause_makes_the_distance_unknown(
    planner: Planner, page: TestPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bridge.web.verbs.hold.HOLD_SECONDS", 60.0)  # otherwise a busy console may ignore a late hold
    planner.drive(page)
    planner.state(State.PAUSED)
    assert shown(page, "paused") == (3.2, STRAIGHT)
    page.send(op="hold", x=0.1, y=0.0, turn=0.0)
    page.value("driving", lambda value: value["distance"] is None)
    assert shown(page, "paused") == (None, STRAIGHT)


def test_a_planner_that_another_client_chose_is_shown(desk: Desk, planner: Planner, page: TestPage) -> None:
    """Also one that was chosen before a restart of the console."""
    gateway = Hub.open(desk.hubs.settings("gateway", worker="gateway", daemon="here"))
    gateway.serve("status", lambda _: {"planner": "robot_path_planner"})
    planner.state(State.MOVING)
    try:
        page.value("driving", lambda value: value and value["planner"] == "robot_path_planner", "its planner is shown")
        assert page.values["driving"]["value"]["state"] == "moving"
    finally:
        gateway.close()


@pytest.mark.parametrize(
    ("verb", "service", "args", "late"),
    [("goto_place", "go_to", {"name": "hall"}, False), ("resume", "resume", {}, False), ("pause", "pause", {}, True)],
)
def test_only_a_stop_is_executed_after_the_page_was_told_that_it_failed(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, verb: str, service: str, args: dict[str, Any], late: bool
) -> None:
    monkeypatch.setattr("bridge.web.verbs.robot.ANSWER_SECONDS", 0.3)
    monkeypatch.setattr(RobotVerbs._trigger, "__defaults__", (0.3,))
    executed, busy, go_on = list[str](), Event(), Event()

    def serve(_request: Any, answer: Any) -> None:
        executed.append(verb)
        answer({"success": True, "message": ""})

    def hang() -> None:
        busy.set()
        go_on.wait()

    with HubNode(desk.hubs.settings("gateway")) as gateway, TestPage(desk.port) as page:
        server = gateway.on(lambda: gateway.node.server(f"/navigation/{service}", NAMED if args else TRIGGER, serve))
        until(lambda: desk.console.host.node.hub.graph.servers(server.topic), "the service is known")
        gateway.loop.post(hang)
        assert busy.wait(10)

        def unanswered() -> bool:
            """Return whether the call got no answer; at first, it may not reach the server, or reach it too late."""
            reply = page.call(verb, **args)
            return "has not answered in 0.3 s" in reply["error"] and (late or server.counters.messages > 0)

        try:
            until(unanswered, "the call gets no answer")
            until(lambda: server.waiting == int(late), "the server has an abandoned request no longer")
        finally:
            go_on.set()
        gateway.on(lambda: None)
        assert executed == [verb] * late


@pytest.mark.parametrize(
    ("verb", "service", "args", "count"), [("goto_place", "go_to", {"name": "hall"}, 1), ("stop", "stop", {}, 2)]
)
def test_only_a_stop_is_executed_later_if_the_console_is_busy(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, verb: str, service: str, args: dict[str, Any], count: int
) -> None:
    executed, busy, go_on = list[str](), Event(), Event()

    def serve(_request: Any, answer: Any) -> None:
        executed.append(verb)
        answer({"success": True, "message": ""})

    def hang() -> None:
        busy.set()
        go_on.wait(40)

    with HubNode(desk.hubs.settings("gateway")) as gateway, TestPage(desk.port) as page:
        gateway.on(lambda: gateway.node.server(f"/navigation/{service}", NAMED if args else TRIGGER, serve))
        until(lambda: page.call(verb, **args)["ok"], "the console reaches the service")
        executed.clear()
        desk.console.host.loop.post(hang)
        assert busy.wait(10)
        try:
            with monkeypatch.context() as patched:
                patched.setattr(EventLoop.call, "__defaults__", (0.3,))
                assert "has not answered for 0.3 s" in page.call(verb, **args)["error"]
        finally:
            go_on.set()
        assert page.call(verb, **args)["ok"]
        assert executed == [verb] * count
