"""A worker that fails with an expected error: the daemon gets the message, and the log has no traceback."""

from __future__ import annotations

import subprocess
import sys

import pytest

from bridge.config.model import Config
from bridge.daemon.control import Commands, Hangup
from bridge.daemon.protocol import Failed, Reloaded, Report, Stop
from bridge.daemon.worker_main import RunEnd, WorkerLoop
from bridge.hub import panics
from bridge.hub.errors import HubConfigError, HubError
from bridge.worker import Health, Worker, WorkerFailedError


class FailingWorker(Worker):
    """Raises an error at its start, or when it reports its health."""

    def __init__(self, error: Exception, *, at_start: bool) -> None:
        self._error, self._at_start = error, at_start
        self.stopped = False

    def start(self, config: Config) -> None:  # noqa: ARG002
        if self._at_start:
            raise self._error

    def reload(self, config: Config) -> bool:  # noqa: ARG002
        return True

    def health(self) -> Health:
        raise self._error

    def stop(self) -> None:
        self.stopped = True


def run(worker: Worker, reports: list[Report]) -> RunEnd:
    return WorkerLoop(worker, Commands(), reports.append).run(Config())


@pytest.mark.parametrize(
    ("error", "at_start", "end"),
    [
        (HubError("cannot join the hub: Unable to connect"), True, RunEnd.FAILED),
        (HubConfigError("unknown key 'mod'"), True, RunEnd.FAILED),
        (RuntimeError("no ROS 2 here"), True, RunEnd.CANNOT_WORK),
        (WorkerFailedError("there is a new address: restarting"), False, RunEnd.FAILED),
    ],
)
def test_a_plain_reason_is_reported(
    caplog: pytest.LogCaptureFixture, error: Exception, at_start: bool, end: RunEnd
) -> None:
    reports: list[Report] = []
    worker = FailingWorker(error, at_start=at_start)
    assert run(worker, reports) is end
    assert reports == [Failed(str(error))]
    assert worker.stopped
    (record,) = caplog.records
    assert str(error) in record.message
    assert record.exc_info is None


class IdleWorker(Worker):
    """Does nothing; a reload is a failure of the test."""

    def start(self, config: Config) -> None: ...

    def reload(self, config: Config) -> bool:  # noqa: ARG002
        pytest.fail("a configuration was applied")

    def health(self) -> Health:
        return Health("running", "idle")

    def stop(self) -> None: ...


@pytest.mark.parametrize("error", [RuntimeError("state folder /s: read-only"), OSError(36, "File name too long")])
def test_a_worker_keeps_its_configuration_if_it_cannot_load_the_new_one(error: Exception) -> None:
    def load() -> Config:
        raise error

    reports, commands = list[Report](), Commands()
    for command in (Hangup(), Stop("the test ends")):
        commands.put(command)
    assert WorkerLoop(IdleWorker(), commands, reports.append, load=load).run(Config()) is RunEnd.STOPPED
    assert Reloaded() in reports


HANGING = """
import os, threading
from bridge.config.model import Config
from bridge.daemon import worker_main
from bridge.daemon.control import Commands
from bridge.hub import panics
from bridge.worker import Health, Worker

class PanicException(BaseException): ...

class Poisoned:
    def is_closed(self): return False
    def declare_keyexpr(self, key): raise PanicException("called `Result::unwrap()` on an `Err` value: PoisonError")
    def undeclare(self, key): raise AssertionError

class Hanging(Worker):
    def start(self, config): panics.watched(Poisoned())
    def reload(self, config): return True
    def health(self): return Health("running", "1 route")
    def stop(self):
        print("stopping", flush=True)
        stopping.set()
        threading.Event().wait()

def exit_after_stopping(code):  # on a busy machine, the time may be over before the worker is told to stop
    stopping.wait()
    exit_now(code)

stopping, exit_now, os._exit = threading.Event(), os._exit, exit_after_stopping
worker_main._CHECK_INTERVAL, worker_main._FAILED_SECONDS = 1, 0.2
worker_main.WorkerLoop(Hanging(), Commands(), lambda report: print(report, flush=True)).run(Config())
"""


def test_a_process_in_which_zenoh_has_failed_ends_even_if_its_worker_does_not_stop() -> None:
    run = subprocess.run(
        [sys.executable, "-c", HANGING], capture_output=True, encoding="utf-8", timeout=60, check=False
    )
    assert run.returncode == 1, run.stderr
    assert run.stdout.splitlines() == [f"Failed(why={panics.FAILED!r})", "stopping"]


FAULTS = [(ValueError("a fault"), True), (ValueError("a fault"), False), (RecursionError("deep"), False)]


@pytest.mark.parametrize(("error", "at_start"), FAULTS)
def test_a_programming_error_keeps_its_traceback(error: Exception, at_start: bool) -> None:
    with pytest.raises(type(error)):
        run(FailingWorker(error, at_start=at_start), [])
