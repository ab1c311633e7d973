"""``midspan service`` and ``midspan action`` on a real hub, with servers that are hub nodes."""

from __future__ import annotations

import os
import shlex
import signal
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from bridge.cli.graph.calls import type_and_values
from bridge.cli.output import CliError
from bridge.messages.registry import Registry
from bridge.modules.action_server import Goal
from tests.cli.conftest import Midspan, Outcome
from tests.peers.daemon.workers import FakeWorker
from tests.peers.hub.network import HubNetwork
from tests.peers.hub.node import HubNode
from tests.support.wait import until

BOOL, LOOKUP = "std_srvs/srv/SetBool", "tf2_msgs/action/LookupTransform"


class Robot(HubNode):
    """A node with a service and an action."""

    def __init__(self, network: HubNetwork, registry: Registry) -> None:
        super().__init__(network.settings("robot"), registry)
        self.goals: list[Goal] = []
        self.obeys = True
        self.node.server("/lamp", BOOL, self.switch)
        self.node.action_server("/lookup", LOOKUP, self.accept, self.cancel)

    def switch(self, request: dict[str, Any], answer: Any) -> None:
        if request["data"]:
            answer({"success": True, "message": "on"})

    def accept(self, goal: Goal) -> bool:
        self.goals.append(goal)
        if goal.goal["target_frame"] == "quick":
            for _ in range(3):
                goal.feedback({})
            goal.succeed({"transform": {"child_frame_id": "here"}})
        return bool(goal.goal["target_frame"] != "no")

    def cancel(self, goal: Goal) -> bool:
        if self.obeys:
            self.loop.post(goal.canceled)
        return True


@pytest.fixture
def robot(network: HubNetwork, registry: Registry) -> Iterator[Robot]:
    with Robot(network, registry) as fake_robot:
        yield fake_robot


@pytest.fixture
def deciding_worker(network: HubNetwork, closing: list[Any]) -> None:
    """A worker that has decided on a service, on a part of an action, and on a topic."""
    base = {"daemon": "robot1", "worker": "ros1", "direction": "in", "cure": "", "kind": "service"}
    private = {"topic": "/node/get_loggers", "hub_topic": "", "type": "roscpp/GetLoggers", "decision": "private"}
    action = {"topic": "/far/_action/send_goal", "hub_topic": "/far/_action/send_goal", "decision": "refused"}
    type_name = "my_msgs/action/Far_SendGoal"
    answer = [{**base, **private, "why": "a logger"}, {**base, **action, "type": type_name, "why": "unknown"}]
    topic = {**base, "kind": "topic", "topic": "/scan", "hub_topic": "/scan", "type": "a/msg/B", "decision": "bridged"}
    closing.append(FakeWorker(network, "ros1", explain=[*answer, {**topic, "why": ""}]))


def test_services_are_listed_without_the_parts_of_actions(
    midspan: Midspan, robot: Robot, deciding_worker: None
) -> None:
    assert midspan("service", "list").out.split() == ["/lamp", "/node/get_loggers"]
    lamp, logger = midspan("service", "list", "--json").json()
    assert (lamp["service"], lamp["types"], lamp["servers"], lamp["state"]) == ("/lamp", [BOOL], 1, "hub")
    assert (logger["state"], logger["types"], logger["from"]) == ("private", ["roscpp/srv/GetLoggers"], ["ros1"])
    assert "SetBool" in midspan("service", "list", "-v").out
    assert "/node/get_loggers" not in midspan("topic", "list").out


def test_actions_are_listed_whole(midspan: Midspan, robot: Robot, deciding_worker: None) -> None:
    assert midspan("action", "list").out.split() == ["/far", "/lookup"]
    far, lookup = midspan("action", "list", "--json").json()
    assert (far["types"], far["state"]) == (["my_msgs/action/Far"], "refused")
    assert (lookup["types"], lookup["servers"], lookup["state"]) == ([LOOKUP], 1, "hub")
    shown = midspan("action", "info", "lookup").out
    assert LOOKUP in shown
    assert "/robot" in shown
    assert "refused: unknown" in midspan("action", "info", "/far").out
    missing = midspan("action", "info", "/lokup")
    assert missing.code == 1
    assert "/lookup" in missing.err


def test_a_call_prints_the_reply(midspan: Midspan, robot: Robot) -> None:
    outcome = midspan("service", "call", "/lamp", "{data: true}")
    assert (outcome.code, outcome.out) == (0, "success: true\nmessage: 'on'\n")
    outcome = midspan("service", "call", "lamp", "std_srvs/SetBool", '{"data": true}', "--json")
    assert outcome.json() == {"success": True, "message": "on"}
    assert midspan("service", "info", "/lamp", "--json").json()["servers"][0]["node"] == "/robot"


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["/lamp", "{dta: true}"], "dta"),
        (["/lamp", "std_srvs/Trigger"], "is std_srvs/srv/SetBool on the hub"),
        (["/lamp", "{data: true}", "std_srvs/SetBool"], "is not a type"),
        (["/lamp", "{data: false}", "--timeout", "0.2"], "has not answered in 0.2 s"),
        (["/nowhere"], "/nowhere has no server"),
        (["/lamp", "[1]"], "must be a map"),
    ],
)
def test_call_errors_are_reported(
    midspan: Midspan, robot: Robot, monkeypatch: pytest.MonkeyPatch, words: list[str], error: str
) -> None:
    if words in (["/nowhere"], ["/lamp", "std_srvs/Trigger"]):  # the others wait only until they reach the server
        monkeypatch.setattr("bridge.client.services.WAIT_SECONDS", 1.0)
    outcome = midspan("service", "call", *words)
    assert outcome.code == 1
    assert error in outcome.err
    assert "--debug" not in outcome.err, "the error is written for users, not developers"


def test_goal_prints_feedback_and_result(midspan: Midspan, robot: Robot) -> None:
    outcome = midspan("action", "send", "/lookup", "{target_frame: quick}", "--json")
    *_, end = outcome.lines()
    assert outcome.code == 0
    assert end["status"] == "succeeded"
    assert end["result"]["transform"]["child_frame_id"] == "here"
    outcome = midspan("action", "send", "/lookup", LOOKUP, "{target_frame: quick}", "--no-feedback")
    assert outcome.out.startswith("succeeded\n")
    outcome = midspan("action", "send", "/lookup", "{target_frame: no}")
    assert outcome.code == 1
    assert "rejected" in outcome.err


def test_timeout_and_ctrl_c_cancel_the_goal(midspan: Midspan, robot: Robot) -> None:
    outcome = midspan("action", "send", "/lookup", "{target_frame: slow}", "--timeout", "0.3")
    assert (outcome.code, outcome.out.split()[0]) == (1, "canceled")
    assert "0.3 s have passed" in outcome.err

    def interrupt() -> None:
        until(lambda: len(robot.goals) == 2, "the server has both goals")
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    outcome = midspan("action", "send", "/lookup", "{target_frame: slow}")
    thread.join()
    assert (outcome.code, outcome.out.split()[0]) == (130, "canceled")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_cancels_the_goal(midspan: Midspan, robot: Robot, number: signal.Signals, code: int) -> None:
    outcome = send_and_signal(midspan, robot, number)
    assert (outcome.code, outcome.out.split()[0]) == (code, "canceled")
    assert outcome.err == f"midspan: {number.name}: the goal was canceled\n"


def test_a_goal_that_does_not_end_after_a_signal_is_reported(
    midspan: Midspan, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bridge.cli.graph.goal.CONFIRM_SECONDS", 0.5)
    robot.obeys = False
    outcome = send_and_signal(midspan, robot, signal.SIGTERM)
    assert (outcome.code, outcome.out.split()[0]) == (143, "unknown")
    assert outcome.err.startswith("midspan: SIGTERM: the goal has not ended within 0.5 s of its cancellation")


def test_a_second_signal_does_not_break_off_the_cancellation(midspan: Midspan, robot: Robot) -> None:
    """Both systemd and shells send SIGTERM and SIGHUP together."""
    outcome = send_and_signal(midspan, robot, signal.SIGTERM, signal.SIGHUP, signal.SIGTERM)
    assert outcome.code in (143, 129)  # Python handles pending signals in the order of their numbers
    assert outcome.err.endswith(": the goal was canceled\n")
    assert len(outcome.err.splitlines()) == 1


def test_an_ignored_hangup_stays_ignored(midspan: Midspan, robot: Robot) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        outcome = send_and_signal(midspan, robot, signal.SIGHUP, signal.SIGTERM)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert outcome.code == 143


def send_and_signal(midspan: Midspan, robot: Robot, *numbers: signal.Signals) -> Outcome:
    """Send a goal, and these signals to this process once the server has it.

    A signal that is sent after the command, because the thread was delayed, does nothing.
    """
    before = {number: signal.getsignal(number) for number in set(numbers)}
    for number in before:
        if before[number] != signal.SIG_IGN:
            signal.signal(number, lambda *_: None)

    def send() -> None:
        until(lambda: robot.goals, "the server has the goal")
        for number in numbers:
            os.kill(os.getpid(), number)

    thread = threading.Thread(target=send)
    thread.start()
    outcome = midspan("action", "send", "/lookup", "{target_frame: slow}")
    thread.join()
    for number, handler in before.items():
        signal.signal(number, handler)
    return outcome


def test_goal_ends_when_its_server_disappears(midspan: Midspan, robot: Robot) -> None:
    def close_server() -> None:
        until(lambda: robot.goals, "the server has the goal")
        robot.node.close()

    thread = threading.Thread(target=close_server)
    thread.start()
    outcome = midspan("action", "send", "/lookup", "{target_frame: slow}")
    thread.join()
    assert outcome.code == 1
    assert "left" in outcome.err or "no server" in outcome.err  # the server may leave before the result request


@pytest.mark.parametrize(
    ("words", "quoted"),
    [
        (["std_srvs/SetBool", "{data:", "true}"], "'{data: true}'"),
        (["{data:", "true}"], "'{data: true}'"),
        (["data:", "it's"], """'data: it'"'"'s'"""),
    ],
)
def test_values_of_several_words_are_refused_with_a_cure_that_works(words: list[str], quoted: str) -> None:
    with pytest.raises(CliError) as caught:
        type_and_values(words)
    assert str(caught.value) == f"too many words: expected NAME [TYPE] [VALUES]; quote the values: {quoted}"
    values = words if len(words) == 2 else words[1:]
    cured = [*words[: len(words) - len(values)], *shlex.split(quoted)]
    assert type_and_values(cured)[1] == " ".join(values)


def test_a_word_before_the_values_that_is_not_a_type_is_refused() -> None:
    with pytest.raises(CliError, match="'SetBool' is not a type"):
        type_and_values(["SetBool", "{data: true}"])
