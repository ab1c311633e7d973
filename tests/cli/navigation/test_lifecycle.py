"""Lifecycle verbs of ``midspan nav``: refusals and errors. `tests/interop/test_nav2_servers.py` has real servers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bridge.cli.navigation.lifecycle import MANAGE
from bridge.client.navigation import STATUS, STATUS_TOPIC
from bridge.hub.wire.qos import LATCHED
from bridge.modules.services import Answer
from tests.cli.conftest import Midspan
from tests.peers.daemon.workers import FakeWorker, config_file
from tests.peers.hub.network import HubNetwork
from tests.peers.hub.node import HubNode

LOCALIZATION, NAVIGATION = "/lifecycle_manager_localization", "/lifecycle_manager_navigation"


class Managers(HubNode):
    """Lifecycle managers that record each command; commands of those in ``fails`` fail."""

    def __init__(self, network: HubNetwork, *names: str) -> None:
        super().__init__(network.settings("managers"))
        self.commands: list[tuple[str, int]] = []
        self.fails: set[str] = set()
        for name in names:

            def answer(request: Any, reply: Answer, name: str = name) -> None:
                self.commands.append((name, request["command"]))
                reply({"success": name not in self.fails})

            self.on(lambda name=name, answer=answer: self.node.server(f"{name}/manage_nodes", MANAGE, answer))


@pytest.fixture
def midspan(network: HubNetwork, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Midspan:
    return Midspan(config_file(tmp_path, network, navigation={"planner": "nav2"}), capsys)


@pytest.fixture
def managers(network: HubNetwork) -> Iterator[Managers]:
    with Managers(network, LOCALIZATION, NAVIGATION) as managers:
        yield managers


def test_localization_starts_first_and_ends_last(midspan: Midspan, managers: Managers) -> None:
    assert midspan("nav", "startup").code == 0
    assert midspan("nav", "shutdown").code == 0
    assert managers.commands == [(LOCALIZATION, 0), (NAVIGATION, 0), (NAVIGATION, 4), (LOCALIZATION, 4)]


def test_navigation_is_not_started_after_a_failure_of_localization(midspan: Midspan, managers: Managers) -> None:
    managers.fails.add(LOCALIZATION)
    outcome = midspan("nav", "startup")
    assert (outcome.code, f"{LOCALIZATION}: startup failed" in outcome.err) == (1, True), outcome
    assert managers.commands == [(LOCALIZATION, 0)]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("goals", 1),
        ("goals_of_others", 2),
        ("navigation", "moving"),
        ("navigation", "preparing_before_move"),
        ("navigation", ""),
    ],
)
def test_a_goal_has_to_be_stopped_first(
    network: HubNetwork, midspan: Midspan, managers: Managers, closing: list[Any], key: str, value: Any
) -> None:
    closing.append(
        FakeWorker(network, "gateway", status=lambda _params: {"planner": "nav2", "navigation": "idle", key: value})
    )
    for verb in ("startup", "shutdown"):
        outcome = midspan("nav", verb)
        assert (outcome.code, "may be moving: stop it first ('midspan nav stop')" in outcome.err) == (1, True), outcome
    assert managers.commands == []


@pytest.mark.parametrize("state", ["idle", "thinking", "aborted"])
def test_an_idle_or_unavailable_planner_is_commanded(
    network: HubNetwork, midspan: Midspan, managers: Managers, closing: list[Any], state: str
) -> None:
    closing.append(FakeWorker(network, "gateway", status=lambda _params: {"planner": "nav2", "navigation": state}))
    assert midspan("nav", "reset").code == 0
    assert managers.commands == [(NAVIGATION, 3), (LOCALIZATION, 3)]


def test_a_gateway_that_does_not_answer_does_not_count_as_idle(
    network: HubNetwork, midspan: Midspan, managers: Managers
) -> None:
    managers.on(lambda: managers.node.publisher(STATUS_TOPIC, STATUS, LATCHED))
    outcome = midspan("nav", "reset")
    assert (outcome.code, "gateway" in outcome.err, managers.commands) == (1, True, []), outcome


def test_missing_managers_are_reported(network: HubNetwork, midspan: Midspan, closing: list[Any]) -> None:
    outcome = midspan("nav", "startup")
    assert outcome.code == 1
    assert f"no lifecycle manager is on the hub: {LOCALIZATION}/manage_nodes or {NAVIGATION}/" in outcome.err
    closing.append(FakeWorker(network, "gateway", status=lambda _params: {"planner": "robot_goto"}))
    assert "robot_goto has no lifecycle managers: choose a planner such as nav2" in midspan("nav", "startup").err
