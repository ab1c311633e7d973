"""Queries of the daemon's log."""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.config.model import Config
from bridge.daemon.log_query import LOG, OWN, RecentLines, ask_log
from bridge.daemon.query import QueryServer
from tests.peers.daemon.daemon import Daemon
from tests.support.wait import until
from yarp_compat.selector_loop import SelectorLoop


def log(kept: RecentLines, text: str, level: int = logging.INFO, **more: object) -> None:
    record = logging.LogRecord("midspan", level, "", 0, text, None, None)
    record.__dict__.update(more)
    kept.handle(record)


def test_a_query_returns_the_lines_after_a_number() -> None:
    kept = RecentLines()
    log(kept, "one")
    log(kept, "two\nthree", logging.ERROR, worker="ros1")
    document = kept.after(1)
    assert document["last"] == 3
    assert [(line["n"], line["level"], line["worker"], line["text"]) for line in document["lines"]] == [
        (2, "error", "ros1", "two"),
        (3, "error", "ros1", "three"),
    ]
    assert kept.after(0)["lines"][0]["worker"] == OWN
    assert kept.after(3) == {"last": 3, "lines": []}


def test_lines_are_bounded() -> None:
    kept = RecentLines(most=10, most_bytes=1000)
    for number in range(50):
        log(kept, str(number))
    assert [line["text"] for line in kept.after(0)["lines"]] == [str(number) for number in range(40, 50)]
    for _ in range(20):
        log(kept, "x" * 300)
    assert len(kept.after(0)["lines"]) == 3
    log(kept, "y" * 100_000)
    assert len(kept.after(0)["lines"][-1]["text"]) < 10_000


def test_bounded_responses_together_have_all_lines() -> None:
    kept, received = RecentLines(), list[str]()
    for number in range(300):
        log(kept, f"{number} {'x' * 1000}")
    n = 0
    while lines := kept.after(n, 10_000)["lines"]:
        assert len(lines) < 12
        received += [line["text"].split()[0] for line in lines]
        n = lines[-1]["n"]
    assert received == [str(number) for number in range(300)]


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Config, RecentLines]]:
    loop, kept, closing = SelectorLoop(), RecentLines(), threading.Event()
    server = QueryServer(loop, tmp_path / "test.daemon.sock", {LOG: kept.respond})

    def run() -> None:
        while not closing.is_set():
            loop.step(0.2)

    thread = threading.Thread(target=run)
    thread.start()
    yield Config(name="test", state=tmp_path), kept
    closing.set()
    loop.wake()
    thread.join()
    server.close()
    loop.close()


def test_silent_and_invalid_clients_do_not_block_others(served: tuple[Config, RecentLines]) -> None:
    config, kept = served
    log(kept, "x" * 8000)
    for _ in range(30):
        log(kept, "y" * 3000)
    with contextlib.ExitStack() as stack:
        for number in range(20):
            silent = stack.enter_context(socket.socket(socket.AF_UNIX))
            silent.connect(str(config.state) + "/test.daemon.sock")
            if number % 2:
                silent.sendall(b"everything\n")
        document = until(lambda: ask_log(config, 0, 10.0), "a response arrives once a connection is free")
        assert document is not None
        assert document["last"] == 31
        assert document["lines"][0]["text"] == "x" * 8000


def test_without_a_daemon_there_is_no_response() -> None:
    assert ask_log(Config(name="nobody", state=Path("/nowhere")), 0) is None


@pytest.mark.thorough
def test_the_log_of_a_daemon_can_be_queried(daemon: Daemon) -> None:
    config = Config(name="test", state=daemon.folder / "state")
    daemon.order("ros1", "never")
    process = daemon.start()
    daemon.wait_ready(process)

    def texts() -> list[tuple[str, str]]:
        return [(line["worker"], line["text"]) for line in (ask_log(config, 0, 20.0) or {"lines": []})["lines"]]

    until(
        lambda: any("ros1 cannot work" in text for worker, text in texts() if worker == OWN),
        "the daemon's own line is in the log",
    )
    assert any(text.startswith("ready: ") for _, text in texts())
