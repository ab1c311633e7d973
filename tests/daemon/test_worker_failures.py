"""A worker that fails for a plain reason: the daemon gets the reason, and the log has no traceback."""

from __future__ import annotations

import pytest

from bridge.config.model import Config
from bridge.daemon.control import Commands
from bridge.daemon.protocol import Failed, Report
from bridge.daemon.worker_main import RunEnd, WorkerLoop
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


FAULTS = [(ValueError("a fault"), True), (ValueError("a fault"), False), (RecursionError("deep"), False)]


@pytest.mark.parametrize(("error", "at_start"), FAULTS)
def test_a_programming_error_keeps_its_traceback(error: Exception, at_start: bool) -> None:
    with pytest.raises(type(error)):
        run(FailingWorker(error, at_start=at_start), [])
