"""A hub for the command line, and the command line itself in this process."""

from __future__ import annotations

import contextlib
import itertools
import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from bridge.cli.main import main
from bridge.messages.registry import Registry
from tests.peers.daemon.workers import EngineWorker, FakeWorker, config_file
from tests.peers.hub.network import HubNetwork

_DOMAINS = itertools.count(1)


@dataclass
class Outcome:
    """The exit code and output of a command."""

    code: int
    out: str
    err: str

    def json(self) -> Any:
        return json.loads(self.out)

    def lines(self) -> list[Any]:
        return [json.loads(line) for line in self.out.splitlines()]


class Midspan:
    """The command ``midspan`` on the test's hub."""

    def __init__(self, config: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.config = config
        self._capsys = capsys

    def __call__(self, *args: str) -> Outcome:
        self._capsys.readouterr()
        code = main([*args, "--config", str(self.config)])
        captured = self._capsys.readouterr()
        return Outcome(code, captured.out, captured.err)


@contextlib.contextmanager
def alongside(script: Callable[[], object]) -> Iterator[None]:
    """Run a function while a command runs in the test's thread; errors of the function fail the test."""
    failed: list[BaseException] = []

    def run() -> None:
        try:
            script()
        except BaseException as err:
            failed.append(err)

    running = threading.Thread(target=run)
    running.start()
    try:
        yield
    finally:
        running.join()
    assert not failed, failed


@pytest.fixture(scope="session")
def router() -> Iterator[HubNetwork]:
    with HubNetwork() as network:
        yield network


@pytest.fixture
def network(router: HubNetwork) -> HubNetwork:
    """A router with the test's own domain."""
    router.domain = next(_DOMAINS) % 230 + 1
    return router


@pytest.fixture
def midspan(network: HubNetwork, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Midspan:
    return Midspan(config_file(tmp_path, network), capsys)


@pytest.fixture(scope="session")
def registry() -> Registry:
    return Registry()


@pytest.fixture
def closing() -> Iterator[list[FakeWorker | EngineWorker]]:
    """A list of workers, which are closed after the test."""
    workers: list[FakeWorker | EngineWorker] = []
    yield workers
    for worker in reversed(workers):
        worker.close()
