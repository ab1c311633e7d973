"""Workers are queried at most once a second, and readiness follows the daemon's status."""

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
                client.recv(1000)
                client.sendall(json.dumps(self.document).encode())

    def close(self) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join()


@pytest.fixture
def config(tmp_path: Path) -> Config:
    return Config(name="here", state=tmp_path)


@pytest.fixture
def daemon(config: Config, monkeypatch: pytest.MonkeyPatch) -> Iterator[Daemon]:
    monkeypatch.setattr(source, "_DAEMON_SECONDS", 20.0)  # its thread may not run for 0.5 s
    server = Daemon(config)
    yield server
    server.close()


def test_concurrent_callers_share_one_query(config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "FRESH_SECONDS", 60.0)  # a thread may begin late on a busy machine
    queries, proceed = [], threading.Event()

    def ask() -> list[WorkerAnswer]:
        queries.append(1)
        assert proceed.wait(10)
        return [WorkerAnswer("here", "ros1", {"pid": 1})]

    source_ = Source(config, ask)
    with ThreadPoolExecutor(8) as pool:
        snapshots = [pool.submit(source_.snapshot) for _ in range(8)]
        until(lambda: queries, "the query has started")
        proceed.set()
        assert len({id(future.result(10)) for future in snapshots}) == 1
    assert len(queries) == 1


def test_an_expired_snapshot_is_queried_again(config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "FRESH_SECONDS", 0.0)
    answers = iter([[WorkerAnswer("here", "ros1", {"n": 1})], [WorkerAnswer("here", "ros1", {"n": 2})]])
    source_ = Source(config, lambda: next(answers))
    assert [source_.snapshot().documents[0].document()["n"] for _ in range(2)] == [1, 2]


def test_documents_of_other_daemons_are_skipped(config: Config) -> None:
    answers = [
        WorkerAnswer("here", "ros1", {"worker": "other"}), WorkerAnswer("there", "ros1", {}),
        WorkerAnswer("here", "ros2", None), WorkerAnswer("here", "yarp", {}, "it failed"),
    ]  # fmt: skip
    documents = Source(config, lambda: answers).snapshot().documents
    assert [(document.daemon, document.worker) for document in documents] == [("here", "ros1")]


def test_the_daemon_is_reported_without_a_hub(config: Config, daemon: Daemon) -> None:
    def ask() -> list[WorkerAnswer]:
        raise HubError("no router")

    snapshot = Source(config, ask).snapshot()
    assert not snapshot.hub
    assert snapshot.daemon is not None
    assert snapshot.daemon.daemon == "here"


def test_readiness_lists_workers_that_are_not_up(
    config: Config, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_a_daemon_that_does_not_run_is_not_ready(config: Config) -> None:
    assert Readiness(config).reasons() == ["no daemon named 'here' answers"]
