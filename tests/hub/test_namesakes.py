"""Two joined machines whose daemons have the same name."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from bridge.cli.inspection.namesakes import distinct
from bridge.config.model import Config
from bridge.hub import namesakes
from bridge.hub.control import WorkerAnswer
from bridge.hub.router import RouterWorker
from bridge.hub.session import Hub, HubSettings
from tests.support.ports import free_port
from tests.support.wait import until


class Machine:
    """A router, and a worker ``ros1`` that answers ``status``."""

    def __init__(self, name: str, number: int, **opened: list[str]) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        hub = {"listen": self.endpoint, "open": {**opened, "insecure": True}}
        self.router = RouterWorker()
        self.router.start(Config.model_validate({"name": name, "hub": hub}))
        self.hub = Hub.open(HubSettings(router=self.endpoint, node="midspan_ros1", worker="ros1", daemon=name))
        self.hub.serve("status", lambda _params: {"number": number})

    def answers(self) -> list[WorkerAnswer]:
        return self.hub.ask("status", {})

    def warning(self) -> str:
        """Return the router's warning in its status document."""
        self.router.health()
        (document,) = [a.value for a in self.answers() if a.worker == "router" and a.value["listen"] == self.endpoint]
        return "; ".join(document["warnings"])

    def close(self) -> None:
        self.hub.close()
        self.router.stop()


@pytest.fixture
def stack(monkeypatch: pytest.MonkeyPatch) -> Iterator[ExitStack]:
    monkeypatch.setattr(namesakes, "_EVERY", 0.0)
    with ExitStack() as stack:
        yield stack


def joined(stack: ExitStack, *names: str) -> tuple[Machine, Machine]:
    """Return two machines, each of which sees the workers of both."""
    place = f"tcp/127.0.0.1:{free_port()}"
    first = Machine(names[0], 1, listen=[place])
    stack.callback(first.close)
    second = Machine(names[1], 2, connect=[place])
    stack.callback(second.close)
    for machine in (first, second):
        until(lambda machine=machine: len(machine.answers()) == 4, "both machines are joined")
    return first, second


def test_a_second_machine_of_the_name_is_reported_and_kept_apart(
    stack: ExitStack, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = joined(stack, "robot1", "robot1")
    for machine in (first, second):
        warning = until(machine.warning, "the router warns")
        assert "also has a daemon named 'robot1'" in warning
        assert "set another 'name'" in warning
        machine.warning()
    lines = [record for record in caplog.records if record.name == "bridge.hub.namesakes"]
    assert [line.levelno for line in lines] == [logging.WARNING] * 2, "one line of each router"
    for machine, number in ((first, 1), (second, 2)):
        found = distinct(machine.answers(), machine.hub.zid)
        assert sorted(a.worker for a in found if a.daemon == "robot1") == ["ros1", "router"]
        (own,) = [a.value["number"] for a in found if a.worker == "ros1" and a.daemon == "robot1"]
        assert own == number
        (name,) = {a.daemon for a in found} - {"robot1"}
        assert name.startswith("robot1 (router ")
    second.close()
    until(lambda: not first.warning(), "the warning ends")


def test_machines_with_different_names_are_not_reported(stack: ExitStack) -> None:
    first, second = joined(stack, "robot1", "robot2")
    assert (first.warning(), second.warning()) == ("", "")
    answers = first.answers()
    assert distinct(answers, first.hub.zid) == answers


def test_another_machine_sees_both_apart() -> None:
    answers = [
        WorkerAnswer("robot1", "router", {"zid": zid, "members": [f"{zid}1"]}, session=zid) for zid in ("aaaa", "bbbb")
    ] + [WorkerAnswer("robot1", "ros1", {}, session="bbbb1"), WorkerAnswer("robot1", "old", {}, session="cccc")]
    names = [answer.daemon for answer in distinct(answers, "dddd")]
    assert names == ["robot1 (router aaaa)", "robot1 (router bbbb)", "robot1 (router bbbb)", "robot1"]


@pytest.mark.parametrize("value", [None, [], {}, {"zid": 7}, {"zid": "a", "members": 3}])
def test_invalid_answers_are_passed_on(value: object) -> None:
    answers = [WorkerAnswer("robot1", "router", value), WorkerAnswer("robot1", "router", {"zid": "b"})]
    assert [answer.value for answer in distinct(answers, "")] == [value, {"zid": "b"}]
