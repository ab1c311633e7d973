"""Each loss once, in one deployment: all messages flow again without intervention; none is stale, doubled or missing.

`benchmarks/recovery.py` repeats this many times, one worker at a time, and prints the durations.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import cast

import pytest

from benchmarks.losses import cases
from benchmarks.losses.field import WORKERS, Field
from benchmarks.losses.litter import litter
from benchmarks.losses.outcome import Outcome
from tests.support.wait import until

pytestmark = [pytest.mark.thorough, pytest.mark.alone]


class Fields:
    """A roscore, the daemon, and programs on each side that exchange messages; restarted after a failed test."""

    def __init__(self) -> None:
        self._field: Field | None = None

    @contextlib.contextmanager
    def one(self) -> Iterator[Field]:
        """Return the deployment of the previous test, or a new one if that test failed."""
        field = self._field = self._field or Field(patient=False)
        try:
            yield field
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        field, self._field = self._field, None
        if field is not None:
            field.close()


@pytest.fixture(scope="module")
def fields() -> Iterator[Fields]:
    fields = Fields()
    yield fields
    fields.close()


LOSSES: dict[str, Callable[[Field], Outcome]] = {
    "roscore with parameters and simulated time": cases.simulated_roscore,
    "ROS 1 node": lambda field: cases.program(field, "ros1"),
    "DDS participant": lambda field: cases.program(field, "ros2", forget=False),
    "router killed": lambda field: cases.worker_killed(field, "router"),
    "ros1 killed": lambda field: cases.worker_killed(field, "ros1"),
    "ros2 killed": lambda field: cases.worker_killed(field, "ros2"),
    "router and ros1 stopped for 2 s": lambda field: cases.worker_stopped(field, "router", "ros1", seconds=2.0),
    "ros2 stopped for longer than its lease": lambda field: cases.worker_stopped(field, "ros2", seconds=3.0),
    "all stopped for 10 s": lambda field: cases.worker_stopped(field, *WORKERS, seconds=10.0),
}


@pytest.mark.parametrize("loss", LOSSES)
def test_all_messages_flow_again_after_a_loss(fields: Fields, loss: str) -> None:
    with fields.one() as field:
        outcome = LOSSES[loss](field)
        assert outcome.good, f"{outcome}\n{field.words()}"


def test_a_listener_that_does_not_run_for_a_second_has_no_old_time(monkeypatch: pytest.MonkeyPatch) -> None:
    arrivals = iter([{}, {("ros2", "/clock"): [(0.0, 3.0, 0.0)]}, {("hub", "/clock"): [(0.0, 4.0, 0.0)]}])
    field = SimpleNamespace(sounds=lambda _since: next(arrivals), until=until, command=lambda *_, **__: None)
    monkeypatch.setattr(cases, "roscore", lambda _field, **_: Outcome())
    assert cases.simulated_roscore(cast("Field", field)).good


def test_repeatedly_killed_workers_leave_no_more_than_one_does(fields: Fields) -> None:
    with fields.one() as field:
        files, _ = litter(field, kills=2, ways=["the workers"])
        assert files.ours <= files.peer, f"{files}\n{field.words()}"


def test_the_successor_of_a_killed_daemon_does_not_wait_for_leases(fields: Fields) -> None:
    """The killed daemon's leases last 20 s. benchmarks/recovery.py requires that the successor is active within 3 s."""
    with fields.one() as field:
        outcome = cases.daemon(field)
        assert outcome.good, f"{outcome}\n{field.words()}"
        assert outcome.seconds < 15.0, f"{outcome}\n{field.words()}"
