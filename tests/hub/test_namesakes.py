"""Two daemons with the same name: on two joined machines, or on one router."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.hub import namesakes
from bridge.hub.control import WorkerAnswer
from bridge.hub.daemons import DaemonIdentity, identity_of, read_identity
from bridge.hub.namesakes import DaemonNames, own_answers
from bridge.hub.node import Hub
from bridge.hub.router import RouterWorker
from bridge.hub.session import HubSettings
from bridge.hub.zenoh_config import MAX_PAYLOAD, make_config, router_tree
from tests.support.ports import free_port
from tests.support.wait import until
from tests.support.zenoh_router import open_router


def distinct(answers: list[WorkerAnswer], own_session: str) -> list[WorkerAnswer]:
    return DaemonNames(answers, own_session).apply(answers)


class Machine:
    """A router, and a worker ``ros1`` that answers ``status``."""

    def __init__(self, name: str, number: int, domain: int = 0, **opened: list[str]) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        hub = {"listen": self.endpoint, "domain": domain, "open": {**opened, "insecure": True}}
        self.router = RouterWorker()
        self.router.start(Config.model_validate({"name": name, "hub": hub}))
        self.hub = Hub.open(
            HubSettings(router=self.endpoint, node="midspan_ros1", worker="ros1", daemon=name, domain=domain)
        )
        self.hub.serve("status", lambda _params: {"number": number})

    def answers(self, seconds: float = 2.0) -> list[WorkerAnswer]:
        return self.hub.ask("status", {}, timeout=seconds)

    def warning(self) -> str:
        """Return the router's warning in its status document."""
        self.router.health()
        (document,) = until(self._documents, "the router reports its status")  # the session may not be linked yet
        return "; ".join(document["warnings"])

    def _documents(self) -> list[dict[str, Any]]:
        return [a.value for a in self.answers() if a.worker == "router" and a.value["listen"] == self.endpoint]

    def close(self) -> None:
        self.hub.close()
        self.router.stop()


@pytest.fixture
def stack(monkeypatch: pytest.MonkeyPatch) -> Iterator[ExitStack]:
    monkeypatch.setattr(namesakes, "_EVERY", 0.0)
    for limit in ("namesakes._ANSWER_SECONDS", "namesakes._WHO_SECONDS", "router._ANSWER_SECONDS"):
        monkeypatch.setattr(f"bridge.hub.{limit}", 20.0)  # no matter how slow the machine is
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
        until(lambda machine=machine: len(machine.answers()) == 4, "both machines have joined")
    return first, second


def test_machines_with_the_same_name_are_reported_and_distinguished(
    stack: ExitStack, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = joined(stack, "robot1", "robot1")
    for machine in (first, second):
        warning = until(machine.warning, "the router warns")
        assert "another daemon on this hub is also named 'robot1'" in warning
        assert "set another 'name'" in warning
        machine.warning()
    lines = [record for record in caplog.records if record.name == "bridge.hub.namesakes"]
    assert [line.levelno for line in lines] == [logging.WARNING] * 2, "each router logs one line"
    for machine, number in ((first, 1), (second, 2)):
        answers = distinct(machine.answers(40.0), machine.hub.zid)
        assert sorted(a.worker for a in answers if a.daemon == "robot1") == ["ros1", "router"]
        (own_number,) = [a.value["number"] for a in answers if a.worker == "ros1" and a.daemon == "robot1"]
        assert own_number == number
        (name,) = {a.daemon for a in answers} - {"robot1"}
        assert name.startswith("robot1 (router ")
    second.close()
    until(lambda: not first.warning(), "the warning ends")


def test_machines_with_different_names_are_not_reported(stack: ExitStack) -> None:
    first, second = joined(stack, "robot1", "robot2")
    assert (first.warning(), second.warning()) == ("", "")
    answers = first.answers(40.0)
    assert distinct(answers, first.hub.zid) == answers


def test_machines_with_the_same_name_in_different_domains_are_not_reported(stack: ExitStack) -> None:
    place = f"tcp/127.0.0.1:{free_port()}"
    first = Machine("robot1", 1, listen=[place])
    stack.callback(first.close)
    second = Machine("robot1", 2, domain=1, connect=[place])
    stack.callback(second.close)
    other = Machine("robot1", 3, domain=1, connect=[place])
    stack.callback(other.close)
    until(second.warning, "the machines of one domain have joined")
    assert first.warning() == ""


def test_third_machine_distinguishes_both() -> None:
    answers = [
        WorkerAnswer("robot1", "router", {"zid": zid, "members": [f"{zid}1"]}, session=zid) for zid in ("aaaa", "bbbb")
    ] + [WorkerAnswer("robot1", "ros1", {}, session="bbbb1"), WorkerAnswer("robot1", "old", {}, session="cccc")]
    names = [answer.daemon for answer in distinct(answers, "dddd")]
    assert names == ["robot1 (router aaaa)", "robot1 (router bbbb)", "robot1 (router bbbb)", "robot1"]


@pytest.mark.parametrize("value", [None, [], {}, {"zid": 7}, {"zid": "a", "members": 3}])
def test_invalid_answers_are_passed_on(value: object) -> None:
    answers = [WorkerAnswer("robot1", "router", value), WorkerAnswer("robot1", "router", {"zid": "b"})]
    assert [answer.value for answer in distinct(answers, "")] == [value, {"zid": "b"}]


class Daemon:
    """A daemon with a router, whose endpoint may be shared, and a worker ``ros1`` that answers ``status``."""

    def __init__(self, stack: ExitStack, endpoint: str, folder: Path, number: int, name: str = "robot1") -> None:
        folder.mkdir(exist_ok=True)
        self.config = Config.model_validate({"name": name, "state": folder, "hub": {"listen": endpoint}})
        identity = identity_of(self.config)
        assert identity is not None
        self.identity = identity
        self.router = RouterWorker()
        self.router.start(self.config)
        stack.callback(self.router.stop)
        settings = HubSettings(router=endpoint, node="midspan_ros1", worker="ros1", daemon=name, identity=identity)
        self.hub = Hub.open(settings)
        stack.callback(self.hub.close)
        self.hub.serve("status", lambda _params: {"number": number})

    def warning(self) -> str:
        """Return the router's warning: in standby, its state's text, otherwise from its status document."""
        text = self.router.health().text
        documents = [a.value for a in self.hub.ask("status", {}, worker="router", timeout=20.0)]
        return "; ".join([text, *(warning for document in documents for warning in document["warnings"])])

    def numbers(self) -> dict[str, int]:
        """Return the numbers that the workers ``ros1`` report, by the distinct names of their daemons."""
        answers = self.hub.ask("status", {}, timeout=20.0)
        names = DaemonNames(answers, self.hub.zid, [self.identity.instance])
        return {answer.daemon: answer.value["number"] for answer in names.apply(answers) if answer.worker == "ros1"}


@pytest.mark.parametrize("router", ["Midspan's", "another"])
def test_daemons_with_the_same_name_at_one_router_are_reported(
    router: str, stack: ExitStack, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    if router == "another":
        foreign = open_router(make_config(router_tree([endpoint], max_payload=MAX_PAYLOAD), None))
        stack.callback(foreign.close)
    first = Daemon(stack, endpoint, tmp_path / "a", 1)
    with ExitStack() as inner:
        second = Daemon(inner, endpoint, tmp_path / "b", 2)
        for daemon, other in ((first, second), (second, first)):
            text = until(lambda d=daemon: "named 'robot1'" in (w := d.warning()) and w, "the router warns")
            assert "another daemon on this hub is also named 'robot1'" in text
            assert "set another 'name'" in text
            assert daemon is second or other.identity.place in text
            numbers = until(lambda d=daemon: len(n := d.numbers()) == 2 and n, "both workers respond")
            own_number, other_number = {first: (1, 2), second: (2, 1)}[daemon]
            assert numbers == {"robot1": own_number, f"robot1 ({other.identity.place})": other_number}
            answers = daemon.hub.ask("status", {}, daemon="robot1", timeout=40.0)
            mine = own_answers(answers, daemon.hub.zid, daemon.identity)
            assert [answer.value["number"] for answer in mine if answer.worker == "ros1"] == [own_number]
        levels = [record.levelno for record in caplog.records if record.name == "bridge.hub.namesakes"]
        assert levels == [logging.WARNING] * 2, "each router logs one line"
    until(lambda: "robot1'" not in first.warning(), "the warning ends")


def test_daemons_with_different_names_are_not_reported(stack: ExitStack, tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    first = Daemon(stack, endpoint, tmp_path / "a", 1)
    second = Daemon(stack, endpoint, tmp_path / "a", 2, name="robot2")
    for daemon, number in ((first, 1), (second, 2)):
        until(lambda d=daemon: len(d.numbers()) == 2, "both workers respond")
        assert "another daemon" not in daemon.warning()
        assert daemon.numbers()[daemon.config.name] == number


def test_workers_without_an_identity_keep_their_name() -> None:
    a, b = (DaemonIdentity(letter, "pc", f"/{letter}") for letter in "ab")
    answers = [
        WorkerAnswer("robot1", "ros1", {}, session=session_id, identity=identity)
        for session_id, identity in (("1", a), ("2", b), ("3", None))
    ]
    names = DaemonNames(answers, "9")
    assert [answer.daemon for answer in names.apply(answers)] == [
        "robot1 (state folder /a on pc)", "robot1 (state folder /b on pc)", "robot1",
    ]  # fmt: skip
    assert names.several() == {"robot1": ["state folder /a on pc", "state folder /b on pc"]}
    assert own_answers(answers, "9", b) == answers[1:]


@pytest.mark.parametrize("value", [None, [], {}, {"instance": 1, "machine": "", "folder": ""}, {"instance": "a"}])
def test_an_invalid_identity_is_none(value: object) -> None:
    assert read_identity(value) is None
