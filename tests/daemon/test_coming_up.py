"""Worker start-up: busy workers get more time, hanging ones are killed, and a single core starts one at a time."""

from __future__ import annotations

import os
import signal
import time
from typing import Any

import pytest

from bridge.config.model import Config
from bridge.daemon.query import Phase, ask_daemon
from bridge.daemon.supervisor import STOP_SECONDS, Supervisor
from bridge.daemon.worker_process import WorkerProcess
from bridge.daemon.worker_run import Timing
from bridge.daemon.workers import worker_kinds
from bridge.progress import Busy
from tests.peers.daemon.daemon import Daemon, alive
from tests.support.wait import until
from yarp_compat.selector_loop import SelectorLoop

pytestmark = pytest.mark.thorough

MANY = 8


def worker_status(daemon: Daemon, name: str) -> dict[str, Any]:
    """Return the daemon's status of a worker; it is empty if the daemon does not run."""
    status = ask_daemon(Config(name="test", state=daemon.folder / "state"), 20.0)
    return {} if status is None else next(report.document() for report in status.workers if report.worker == name)


def test_a_worker_that_computes_during_start_up_is_not_killed(daemon: Daemon) -> None:
    daemon.order("ros1", "compute-at-start")
    process = daemon.quick(MANY, start=1.5)
    until(lambda: worker_status(daemon, "ros1").get("text") == "computing on purpose", "the worker computes")
    started = daemon.pids("ros1")  # on a busy machine an earlier process may wait for 1.5 s before it computes
    begun = time.monotonic()
    until(lambda: time.monotonic() > begun + 3, "the worker computes for longer than the start limit")
    until(lambda: worker_status(daemon, "ros1").get("phase") == "starting", "the worker is still starting")
    status = daemon.midspan("status", "--config", str(daemon.file))
    assert status.popen.wait(40) == 1, "the fake workers have no hub"
    assert "ros1     starting computing on purpose (" in status.output()
    daemon.order("ros1")
    daemon.expect_output(process, "ros1: running")
    assert daemon.pids("ros1") == started


def test_a_worker_that_hangs_during_start_up_is_killed_and_the_next_gets_more_time(daemon: Daemon) -> None:
    daemon.order("ros1", "hang-at-start")
    process = daemon.quick(MANY, start=1.0)
    daemon.expect_output(process, "ros1 made no progress for 1 s while starting (starting); the next limit is 2 s")
    daemon.expect_output(process, "fakes.py")  # the stack shows the file in which it hangs
    daemon.expect_output(process, "ros1 made no progress for 2 s while starting (starting); the next limit is 4 s")
    daemon.order("ros1")
    daemon.expect_output(process, "ros1: running")


def test_a_worker_that_computes_instead_of_reporting_is_not_killed(daemon: Daemon) -> None:
    process = daemon.quick(MANY, heartbeat=2.0)
    first = daemon.wait_started("ros1")
    daemon.expect_output(process, "ros1: running")
    daemon.order("ros1", "compute")
    until(lambda: daemon.events("ros1", "computes"), "the worker begins to compute")
    begun = time.monotonic()
    until(lambda: time.monotonic() > begun + 4, "the worker computes for longer than the heartbeat limit")
    daemon.order("ros1")
    until(lambda: daemon.events("ros1", "computed"), f"the worker reports its state:\n{process.output()}")
    assert daemon.pids("ros1") == [first], process.output()


class _Unconnected:
    """A channel without a process."""

    pid, owner, needs_polls = 0, "daemon", False

    def poll(self) -> None:
        pass

    def detach(self) -> None:
        pass


@pytest.mark.parametrize(("seconds", "phase"), [(499.0, Phase.UP), (501.0, Phase.PAUSED)])
def test_a_worker_in_an_endless_loop_is_killed(seconds: float, phase: Phase, caplog: pytest.LogCaptureFixture) -> None:
    loop = SelectorLoop()
    worker = WorkerProcess(loop, worker_kinds({})["ros1"], Timing(heartbeat=50.0))
    worker.channel, worker.state.state = _Unconnected(), Phase.UP  # type: ignore[assignment]
    for used in (0.0, seconds):
        worker.on_report(Busy("reporting its state", used, 0))
        worker.tick()
    assert worker.phase is phase
    assert ("ros1 is in an endless loop: reporting its state has computed for 501 s" in caplog.text) is (
        phase is Phase.PAUSED
    )
    loop.close()


def test_a_single_core_starts_workers_one_after_the_other(daemon: Daemon) -> None:
    daemon.order("ros1", "compute-at-start")
    process = daemon.quick(1, patience=60.0)  # a starved worker does not count as one that hangs
    until(
        lambda: worker_status(daemon, "ros2").get("text") == "waiting for ros1 to start", "the second worker is queued"
    )
    assert worker_status(daemon, "ros2")["phase"] == "queued"
    assert not daemon.pids("ros2")
    assert "router: running" in process.output().partition("ros1 started")[0]
    daemon.order("ros1")
    daemon.expect_output(process, "ros2: running")
    assert "ros1: running" in process.output().partition("ros2 started")[0]


def test_a_restarted_worker_is_queued_too(daemon: Daemon) -> None:
    process = daemon.quick(1, patience=60.0)
    daemon.expect_output(process, "ready: ")
    daemon.order("ros2", "compute-at-start")
    os.kill(daemon.wait_started("ros2"), signal.SIGKILL)
    daemon.wait_started("ros2", 2)
    os.kill(daemon.wait_started("ros1"), signal.SIGKILL)
    until(lambda: worker_status(daemon, "ros1").get("text") == "waiting for ros2 to start", "the worker is queued")
    daemon.order("ros2")
    assert alive(daemon.wait_started("ros1", 2))


def test_a_hanging_worker_does_not_delay_the_others(daemon: Daemon) -> None:
    daemon.order("ros1", "hang-at-start")
    process = daemon.quick(1, patience=0.5)
    daemon.expect_output(process, "ros2: running")
    assert worker_status(daemon, "ros1")["phase"] == "starting"


def test_several_cores_start_several_workers_at_once(daemon: Daemon) -> None:
    daemon.order("ros1", "compute-at-start")
    daemon.order("ros2", "compute-at-start")
    daemon.quick(3)
    daemon.wait_started("ros1")
    daemon.wait_started("ros2")
    assert {worker_status(daemon, worker)["phase"] for worker in ("ros1", "ros2")} == {"starting"}


def test_only_a_running_worker_is_reported_as_running(daemon: Daemon) -> None:
    daemon.order("ros1", "wait")
    process = daemon.start()
    daemon.expect_output(process, "ros1: waiting (ros1 fine)")
    daemon.wait_ready(process)
    assert "ros1: running" not in process.output()
    daemon.order("ros1")
    daemon.expect_output(process, "ros1: running (ros1 fine)")
    assert process.output().count("ros1: waiting") == 1


class _Slow:
    """A worker whose killed process exits only after `STOP_SECONDS`."""

    name, pid, is_service, phase = "slow", 1, False, Phase.STOPPING

    def __init__(self, clock: list[float]) -> None:
        self._clock = clock
        self.idle = False
        self.kind = type("Kind", (), {"outlives": False})

    def stop(self, why: str, seconds: float) -> None:
        pass

    def kill(self) -> None:
        pass

    def tick(self) -> None:
        self.idle = self._clock[0] > STOP_SECONDS + 0.2

    def release(self) -> None:
        raise AssertionError


def test_a_process_that_exits_late_is_not_reported_as_surviving_sigkill(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    clock = [0.0]

    def step(seconds: float) -> None:
        clock[0] += seconds

    supervisor = Supervisor(daemon.file, environ=daemon.env)
    monkeypatch.setattr("bridge.daemon.supervisor.time", type("Time", (), {"monotonic": lambda: clock[0]}))
    monkeypatch.setattr(supervisor, "workers", [_Slow(clock)])
    monkeypatch.setattr(supervisor.loop, "step", step)
    supervisor._end()
    assert "even after SIGKILL" not in caplog.text
    supervisor.loop.close()
