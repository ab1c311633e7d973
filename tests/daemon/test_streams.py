"""The streams of workers: on the loop, and with threads where selectors cannot wait for pipes."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from bridge.daemon import streams
from yarp_compat.selector_loop import SelectorLoop


@pytest.fixture(params=[True, False], ids=["selected", "threads"], autouse=True)
def _selects_pipes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "_SELECTS_PIPES", request.param)


@pytest.fixture
def loop() -> Iterator[SelectorLoop]:
    loop = SelectorLoop()
    yield loop
    loop.close()


def child(code: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-ISc", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)


def step_until_end(loop: SelectorLoop, parts: list[bytes]) -> bytes:
    end = time.monotonic() + 20.0
    while parts[-1:] != [b""]:
        loop.step(0.2)
        assert time.monotonic() < end, "the stream does not end"
    return b"".join(parts)


def test_data_and_the_end_arrive_on_the_loop(loop: SelectorLoop) -> None:
    parts: list[bytes] = []
    process = child("import os; os.write(1, b'one\\n'); os.write(1, b'x' * 1000000)")
    assert process.stdin is not None
    assert process.stdout is not None
    reader = streams.reader(loop, process.stdout, parts.append)
    assert step_until_end(loop, parts) == b"one\n" + b"x" * 1_000_000
    assert parts.count(b"") == 1
    assert process.wait(20.0) == 0
    reader.close()
    process.stdin.close()


def test_writing_does_not_wait_for_a_slow_process(loop: SelectorLoop) -> None:
    """The process is stopped meanwhile, so that a write that waits for it would not return."""
    process = child("import sys; print(len(sys.stdin.buffer.read(3000000)), flush=True)")
    assert process.stdin is not None
    assert process.stdout is not None
    parts: list[bytes] = []
    reader, writer = streams.reader(loop, process.stdout, parts.append), streams.writer(loop, process.stdin)
    process.send_signal(signal.SIGSTOP)
    for _ in range(10):
        writer.write(b"x" * 300_000)
    process.send_signal(signal.SIGCONT)
    assert step_until_end(loop, parts).strip() == b"3000000"
    writer.close()
    assert process.wait(20.0) == 0
    reader.close()


def test_the_last_output_of_an_exited_process_is_delivered(loop: SelectorLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "_LAST_SECONDS", 20.0)  # the thread that reads it may be starved
    process = child("import os; os.write(1, b'last')")
    assert process.stdin is not None
    assert process.stdout is not None
    parts: list[bytes] = []
    reader = streams.reader(loop, process.stdout, parts.append)
    assert process.wait(20.0) == 0
    reader.drain()
    assert b"".join(parts) == b"last"
    reader.close()
    process.stdin.close()
    loop.step(0.0)
    assert b"".join(parts) == b"last"


def test_writing_to_an_exited_process_is_harmless(loop: SelectorLoop) -> None:
    process = child("")
    assert process.stdin is not None
    assert process.stdout is not None
    process.wait(20.0)
    writer = streams.writer(loop, process.stdin)
    writer.write(b"config")
    writer.write(b"stop")
    loop.step(0.0)
    writer.close()
    process.stdout.close()
    assert process.returncode == 0
