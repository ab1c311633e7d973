"""Workers are asked once a second at most, whoever asks, and readiness goes by the daemon's word."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from bridge import state_file
from bridge.config.model import Config
from bridge.hub.control import WorkerAnswer
from bridge.hub.errors import HubError
from bridge.metrics import source
from bridge.metrics.source import Readiness, Source
from tests.support.wait import until


class Daemon:
    """Answers on the daemon's socket with one document."""

    def __init__(self, config: Config) -> None:
        self.document: dict[str, Any] = {"daemon": config.name, "pid": 1, "workers": []}
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.bind(str(state_file.daemon_socket(config)))
        self._socket.listen()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while True:
            try:
                client, _ = self._socket.accept()
            except OSError:
                return
            with client:
                client.sendall(json.dumps(self.document).encode())

    def close(self) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join()


@pytest.fixture
def config(tmp_path: Path) -> Config:
    return Config(name="here", state=tmp_path)


@pytest.fixture
def daemon(config: Config) -> Iterator[Daemon]:
    made = Daemon(config)
    yield made
    made.close()


def test_many_who_ask_at_once_cause_one_question(config: Config) -> None:
    asked, go_on = [], threading.Event()

    def ask() -> list[WorkerAnswer]:
        asked.append(1)
        assert go_on.wait(10)
        return [WorkerAnswer("here", "ros1", {"pid": 1})]

    known = Source(config, ask)
    with ThreadPoolExecutor(8) as pool:
        pictures = [pool.submit(known.snapshot) for _ in range(8)]
        until(lambda: asked, "one asks")
        go_on.set()
        assert len({id(each.result(10)) for each in pictures}) == 1
    assert len(asked) == 1


def test_it_is_asked_again_once_the_answer_is_old(config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "FRESH_SECONDS", 0.0)
    answers = iter([[WorkerAnswer("here", "ros1", {"n": 1})], [WorkerAnswer("here", "ros1", {"n": 2})]])
    known = Source(config, lambda: next(answers))
    assert [known.snapshot().documents[0]["n"] for _ in range(2)] == [1, 2]


def test_what_is_no_document_of_this_daemon_is_left_out(config: Config) -> None:
    answers = [
        WorkerAnswer("here", "ros1", {"worker": "other"}), WorkerAnswer("there", "ros1", {}),
        WorkerAnswer("here", "ros2", None), WorkerAnswer("here", "yarp", {}, "it failed"),
    ]  # fmt: skip
    assert Source(config, lambda: answers).snapshot().documents == ({"worker": "ros1"},)


def test_without_a_hub_the_daemon_still_tells(config: Config, daemon: Daemon) -> None:
    def ask() -> list[WorkerAnswer]:
        raise HubError("no router")

    found = Source(config, ask).snapshot()
    assert not found.hub
    assert found.daemon["daemon"] == "here"


def test_readiness(config: Config, daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "READY_SECONDS", 0.0)
    ready = Readiness(config)
    assert ready.reasons() == []
    daemon.document["workers"] = [
        {"worker": "router", "phase": "running", "text": "x"},
        {"worker": "ros1", "phase": "restarting", "text": "signal 9"},
        {"worker": "ros2", "phase": "starting", "text": ""},
        {"worker": "yarp", "phase": "not available", "text": "no YARP"},
        {"worker": "sim", "phase": "off", "text": ""},
    ]
    assert ready.reasons() == ["ros1: restarting: signal 9", "ros2: starting"]


def test_without_a_daemon_it_is_not_ready(config: Config) -> None:
    assert Readiness(config).reasons() == ["no daemon of the name 'here' answers"]
