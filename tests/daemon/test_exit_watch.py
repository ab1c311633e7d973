"""The daemon sleeps until a worker reports, exits or is late."""

from __future__ import annotations

import errno
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from bridge.daemon import worker_channel, worker_run
from bridge.daemon.exit_watch import ExitWatch
from bridge.daemon.protocol import Beat
from bridge.daemon.query import Phase
from bridge.daemon.readiness import ANNOUNCE_INTERVAL, STATUS_INTERVAL, Readiness
from bridge.daemon.worker_process import STEP, WorkerProcess
from bridge.daemon.worker_run import Timing
from bridge.daemon.workers import worker_kinds
from bridge.worker import Health
from tests.support.wait import until
from yarp_compat.selector_loop import SelectorLoop


class _Channel:
    """A channel without a process."""

    needs_polls = False


def test_the_daemon_sleeps_until_it_has_to_check_a_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    """A check four times a second would cost an idle daemon more than the heartbeats do."""
    now = SimpleNamespace(monotonic=lambda: 1000.0)
    monkeypatch.setattr(worker_run, "time", now)
    loop, channel = SelectorLoop(), _Channel()
    worker = WorkerProcess(loop, worker_kinds({})["ros1"], Timing(heartbeat=5.0))
    assert worker.pause == math.inf, "the worker is off"
    worker.channel, worker.state.state = channel, Phase.UP  # type: ignore[assignment]
    worker.on_report(Beat(1, Health("running", "")))
    assert worker.pause == 5.0
    now.monotonic = lambda: 1003.0
    assert worker.pause == 2.0
    now.monotonic = lambda: 1007.0
    assert worker.pause == STEP, "the worker is late"
    now.monotonic = lambda: 1000.0
    for state, polls in ((Phase.STARTING, False), (Phase.STOPPING, False), (Phase.UP, True)):
        worker.state.state, channel.needs_polls = state, polls
        assert worker.pause == STEP
    loop.close()


@pytest.mark.parametrize("system", ["reports exits", "too old", "Python built for an older system"])
def test_the_exit_of_a_process_ends_the_daemons_sleep(system: str, monkeypatch: pytest.MonkeyPatch) -> None:
    reported = system == "reports exits"
    if system == "too old":
        monkeypatch.setattr(os, "pidfd_open", lambda _: no_process_files(), raising=False)
    elif not reported:
        monkeypatch.delattr(os, "pidfd_open", raising=False)
    loop, exits = SelectorLoop(), list[None]()
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        watch = ExitWatch(loop, process.pid, lambda: exits.append(None))
        assert watch.active is (reported and sys.platform == "linux")
        if watch.active:
            process.kill()
            until(lambda: loop.step(20.0) or exits, "the exit is reported")
            assert not watch.active, "the loop does not report it again"
        process.kill()
    watch.close()
    loop.close()


def no_process_files() -> int:
    raise OSError(errno.ENOSYS, "this system is too old")


@pytest.mark.parametrize("in_memory", [True, False])
def test_a_child_can_be_given_a_file_without_a_name(in_memory: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not in_memory:
        monkeypatch.delattr(os, "memfd_create", raising=False)
    with worker_channel._unnamed_file() as file:
        file.write(b"first")
        file.seek(0)
        assert file.read() == b"first"


def test_the_daemon_checks_often_whether_it_is_ready(tmp_path: Path) -> None:
    readiness = Readiness(MagicMock(), lambda: "", lambda: tmp_path)
    readiness.begin()
    readiness.step(time.monotonic(), lambda: False)
    assert readiness.pause == ANNOUNCE_INTERVAL
    readiness.step(time.monotonic(), lambda: True)
    assert readiness.pause == STATUS_INTERVAL
    readiness.announce_again()
    assert readiness.pause == ANNOUNCE_INTERVAL
