"""A patrol with the test's own gateway, on a real hub."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from bridge.config.sections.navigation import ACTION, THROUGH_POSES
from bridge.hub.wire.qos import LATCHED
from bridge.modules.action_server import Goal
from bridge.modules.services import Answer
from bridge.web.verbs import patrol
from navigation.messages import NAVIGATE, THROUGH
from navigation.status import NO_GOAL, STATUS, PlannerStatus, State, status_message
from tests.peers.browser.page import TestPage
from tests.peers.hub.node import HubNode
from tests.peers.navigation.gateway import pose
from tests.support.wait import until
from tests.web.conftest import Desk

PLACES = {"a": 1.0, "b": 2.0, "c": 3.0}


class FakeGateway(HubNode):
    """A gateway that executes only the newest goal, and publishes the goal's status."""

    def __init__(self, settings: Any) -> None:
        super().__init__(settings)
        self.goals: list[Goal] = []
        self.now: Goal | None = None
        self.at_once = 0  # largest number of goals that were active at once
        self.on(self._open)

    def _open(self) -> None:
        self._status = self.node.publisher("/navigation/status", STATUS, LATCHED)
        self.node.action_server(ACTION, NAVIGATE, self._on_goal, self._cancel)
        self.node.action_server(THROUGH_POSES, THROUGH, self._on_goal, self._cancel)
        self.node.server("/navigation/get_location", "midspan_msgs/srv/GetLocation", self._find)
        for name in ("pause", "resume", "stop"):
            self.node.server(f"/navigation/{name}", "std_srvs/srv/Trigger", getattr(self, f"_{name}"))
        self.publish_status(State.IDLE)

    def publish_status(self, state: State, goal_id: bytes = NO_GOAL) -> None:
        self._status.publish(status_message({"sec": 0, "nanosec": 0}, PlannerStatus(state), goal_id=goal_id))

    def _on_goal(self, goal: Goal) -> bool:
        self.at_once = max(self.at_once, 1 + (self.now is not None))
        if self.now is not None:
            self.now.canceled({"error_msg": "another client sent a goal, which replaced it"})
        self.now = goal
        self.goals.append(goal)
        goal.execute()
        self.publish_status(State.MOVING, goal.id)
        return True

    def _cancel(self, goal: Goal) -> bool:
        self.loop.post(lambda: self._stop({}, lambda _reply: None) if goal is self.now else None)
        return True

    def _find(self, request: dict[str, Any], answer: Answer) -> None:
        place = PLACES.get(request["name"])
        if place is None:
            answer({"success": False, "message": f"unknown location or area {request['name']!r}"})
        else:
            answer({"success": True, "message": "", "pose": pose(place)})

    def _pause(self, _request: Any, answer: Answer) -> None:
        if self.now is None:
            answer({"success": False, "message": "nothing to pause"})
            return
        self.publish_status(State.PAUSED, self.now.id)
        answer({"success": True, "message": ""})

    def _resume(self, _request: Any, answer: Answer) -> None:
        assert self.now is not None
        self.publish_status(State.MOVING, self.now.id)
        answer({"success": True, "message": ""})

    def _stop(self, _request: Any, answer: Answer) -> None:
        goal, self.now = self.now, None
        if goal is not None:
            goal.canceled({"error_msg": "it was stopped"})
        self.publish_status(State.IDLE)
        answer({"success": True, "message": "stands"})

    def goal_x(self, count: int) -> float:
        """Wait for the goal with this number, and return its x."""
        (x,) = self.goal_xs(count)
        return x

    def goal_xs(self, count: int) -> list[float]:
        """Wait for the goal with this number, and return the x of its places."""
        until(lambda: len(self.goals) >= count, f"goal {count} is sent", 30)
        goal = self.goals[count - 1].goal
        return [float(place["pose"]["position"]["x"]) for place in goal.get("poses") or [goal["pose"]]]

    def pass_places(self, left: int) -> None:
        """Report how many of the goal's places are left."""

        def report() -> None:
            assert self.now is not None
            self.now.feedback({"number_of_poses_remaining": left})

        self.on(report)

    def reach(self) -> None:
        def done() -> None:
            goal, self.now = self.now, None
            assert goal is not None
            goal.succeed({})
            self.publish_status(State.REACHED)

        self.on(done)

    def give_up(self, why: str) -> None:
        def done() -> None:
            goal, self.now = self.now, None
            assert goal is not None
            goal.abort({"error_code": 20006, "error_msg": why})
            self.publish_status(State.ABORTED)

        self.on(done)


@pytest.fixture
def gateway(desk: Desk) -> Iterator[FakeGateway]:
    gateway_ = FakeGateway(desk.hubs.settings("gateway"))
    yield gateway_
    gateway_.close()


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Extend the time limit for the gateway's reply: on a busy machine it may take over 5 s, which ends a patrol."""
    monkeypatch.setattr(patrol, "ANSWER_SECONDS", 40.0)


@pytest.fixture
def page(desk: Desk, gateway: FakeGateway) -> Iterator[TestPage]:
    with TestPage(desk.port) as page_:
        page_.watch("driving", "patrol")
        page_.value("driving", lambda value: value and value["state"] == "idle")
        graph = desk.console.host.node.hub.graph
        page_.until(lambda: graph.servers(f"{ACTION}/_action/send_goal"), "the gateway is discovered")
        page_.until(
            lambda: graph.servers(f"{THROUGH_POSES}/_action/get_result"), "the gateway's other action is discovered"
        )
        page_.until(lambda: graph.servers("/navigation/stop"), "all services of the gateway are discovered")
        yield page_
    assert gateway.at_once <= 1


def begin(page: TestPage, *places: str, wait: float = 1.0) -> None:
    reply = page.call("patrol", places=list(places), wait=wait)
    assert reply["ok"], reply


def state(page: TestPage, wanted: str) -> dict[str, Any]:
    patrol: dict[str, Any] = page.value("patrol", lambda value: value and value["state"] == wanted, f"it {wanted}")
    return patrol


def ended(page: TestPage, why: str) -> None:
    """Wait for a patrol that ended for this reason; the page may still show the end of an earlier patrol."""
    page.value("patrol", lambda value: (value["state"], value["why"]) == ("ended", why), f"it ended: {why}")


def test_a_patrol_drives_to_places_in_turn(page: TestPage, gateway: FakeGateway) -> None:
    page.until(lambda: page.values.get("patrol", {}).get("why") == "no patrol yet", "the state is reported")
    begin(page, "a", "b", "a", "c")
    for count, place in enumerate(("a", "b", "a", "c", "a", "b"), 1):
        if count > 1:  # the last place is not reached: the page might see only the drive to the next one
            gateway.reach()
        assert gateway.goal_x(count) == PLACES[place]
    patrol = page.value("patrol", lambda value: (value["round"], value["at"]) == (2, 1))
    assert patrol["places"] == ["a", "b", "a", "c"]


def test_a_patrol_without_stops_sends_all_places_in_one_goal(
    page: TestPage, gateway: FakeGateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(patrol, "SHORTEST", 5.0)  # so that a busy console sends the state between two goals
    begin(page, "a", "b", "c", wait=0.0)
    places = [1.0, 2.0, 3.0]
    assert gateway.goal_xs(1) == places * 6
    for left, at in ((18, (1, 0)), (17, (1, 1)), (14, (2, 1)), (2, (6, 1))):
        gateway.pass_places(left)
        page.value("patrol", lambda value, at=at: (value["round"], value["at"]) == at)
    gateway.pass_places(0)  # as a planner does before its first plan
    gateway.reach()
    shown = state(page, "waits")
    assert (shown["round"], shown["at"]) == (6, 2)
    assert gateway.goal_xs(2) == places * 6
    shown = state(page, "drives")
    assert (shown["round"], shown["at"], shown["wait"]) == (7, 0, 0.0)


def test_a_patrol_without_stops_continues_at_the_place_where_it_was_paused(
    page: TestPage, gateway: FakeGateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(patrol, "SHORTEST", 60.0)  # so that the pause arrives before the next goal is sent
    begin(page, *("abc" * 4), wait=0.0)
    assert gateway.goal_xs(1) == [1.0, 2.0, 3.0] * 4
    gateway.reach()
    state(page, "waits")
    assert page.call("pause")["ok"]
    state(page, "held")
    assert page.call("resume")["ok"]
    assert gateway.goal_xs(2) == [3.0, *[1.0, 2.0, 3.0] * 3, 1.0, 2.0]


def test_the_end_of_a_patrol_without_stops_names_the_place(page: TestPage, gateway: FakeGateway) -> None:
    begin(page, "a", "b", wait=0.0)
    gateway.goal_xs(1)
    gateway.pass_places(19)
    page.value("patrol", lambda value: value["at"] == 1)
    gateway.give_up("no path leads there")
    assert state(page, "ended")["why"] == "driving to b: no path leads there"
    begin(page, "a", "gone", wait=0.0)
    ended(page, "unknown location or area 'gone'")
    assert len(gateway.goals) == 1


def test_a_patrol_continues_without_its_page(desk: Desk, page: TestPage, gateway: FakeGateway) -> None:
    with TestPage(desk.port) as other:
        begin(other, "a", "b")
        gateway.goal_x(1)
    gateway.reach()
    assert gateway.goal_x(2) == PLACES["b"]
    assert "a patrol is active" in page.call("patrol", places=["c", "a"])["error"]


@pytest.mark.parametrize("how", ["console", "elsewhere"])
@pytest.mark.parametrize("where", ["driving", "at a place", "between places"])
def test_a_stop_ends_the_patrol(desk: Desk, page: TestPage, gateway: FakeGateway, how: str, where: str) -> None:
    begin(page, "a", "b", wait=0.0 if where == "between places" else 60.0)
    gateway.goal_xs(1)
    page.value("driving", lambda value: value["state"] == "moving")
    if where == "at a place":
        gateway.reach()
        state(page, "waits")
        page.value("driving", lambda value: value["state"] == "goal_reached")
    if how == "console":
        assert page.call("stop")["ok"]
    else:
        desk.far.call("/navigation/stop", "std_srvs/Trigger").result(20)
    assert "stopped" in state(page, "ended")["why"]
    begin(page, "c", "a")
    assert gateway.goal_x(2) == PLACES["c"], "the previous patrol has no effect"


@pytest.mark.parametrize("where", ["driving", "at a place", "between places"])
def test_another_clients_goal_ends_the_patrol(desk: Desk, page: TestPage, gateway: FakeGateway, where: str) -> None:
    begin(page, "a", "b", wait=0.0 if where == "between places" else 60.0)
    gateway.goal_xs(1)
    page.value("driving", lambda value: value["state"] == "moving")
    if where == "at a place":
        gateway.reach()
        state(page, "waits")
    other = HubNode(desk.hubs.settings("other"))
    try:
        client = other.on(lambda: other.node.action_client(ACTION, NAVIGATE))
        until(lambda: client.ready, "the gateway is discovered", 20)
        # except at a place, the gateway replaces the patrol's goal, and would count two goals at once
        gateway.at_once = 0 if where == "at a place" else -1
        other.on(lambda: client.send({"pose": pose(9.0)}, lambda *_: None))
        assert gateway.goal_x(2) == 9.0
        assert "sent a goal" in state(page, "ended")["why"]
    finally:
        gateway.at_once = 0
        other.close()


def test_an_unreachable_place_ends_the_patrol(page: TestPage, gateway: FakeGateway) -> None:
    begin(page, "a", "b")
    gateway.goal_x(1)
    gateway.give_up("no path leads there")
    assert state(page, "ended")["why"] == "driving to a: no path leads there"
    begin(page, "a", "gone")
    gateway.goal_x(2)
    gateway.reach()
    ended(page, "unknown location or area 'gone'")


@pytest.mark.parametrize("where", ["driving", "at a place", "between places"])
def test_a_patrol_is_paused_and_resumed(page: TestPage, gateway: FakeGateway, where: str) -> None:
    # at a place, the pause must arrive before the next goal is sent
    begin(page, "a", "b", wait={"between places": 0.0, "at a place": 60.0}.get(where, 1.0))
    gateway.goal_xs(1)
    page.value("driving", lambda value: value["state"] == "moving")
    if where == "at a place":
        gateway.reach()
        state(page, "waits")
    assert page.call("pause")["ok"]
    state(page, "held")
    assert page.call("resume")["ok"]
    state(page, "drives")
    if where != "at a place":
        gateway.reach()
    gateway.goal_xs(2)


def test_manual_driving_is_refused_during_a_patrol(
    page: TestPage, gateway: FakeGateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bridge.web.verbs.hold.HOLD_SECONDS", 60.0)  # otherwise a busy console may ignore a late hold
    begin(page, "a", "b", wait=60.0)
    gateway.goal_x(1)
    gateway.reach()
    state(page, "waits")
    page.value("driving", lambda value: value["state"] == "goal_reached")
    page.send(op="hold", x=0.1, y=0.0, turn=0.0)
    page.until(page.errors, "the reason is reported")
    assert page.errors() == ["a patrol is active; pause or stop it first"]


def test_a_missing_gateway_is_reported(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patrol, "ANSWER_SECONDS", 0.3)
    with TestPage(desk.port) as page:
        page.watch("patrol")
        begin(page, "a", "b")
        assert "/navigation/get_location" in state(page, "ended")["why"]


@pytest.mark.parametrize(
    ("args", "why"),
    [
        ({"places": ["a"]}, "places must be 2 to 50 names"),
        ({"places": ["a"] * 51}, "places must be 2 to 50 names"),
        ({"places": ["a", 1]}, "places must be a name"),
        ({"places": ["a", "b"], "wait": 0.5}, "wait must be a number of seconds, 0 for no stop or between 1 and 3,600"),
        ({"places": ["a", "b"], "wait": False}, "wait must be a number of seconds"),
        ({"places": ["a", "b"], "wait": 1e300}, "between 1 and 3,600, not 1e+300"),
        ({"places": ["a", "b"], "wait": "2"}, "wait must be a number of seconds"),
    ],
)
def test_invalid_patrols_are_refused(desk: Desk, args: dict[str, Any], why: str) -> None:
    with TestPage(desk.port) as page:
        assert why in page.call("patrol", **args)["error"]
