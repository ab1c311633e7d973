"""Detection of progress by processor time and disk reads."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import pytest

from bridge.daemon import worker_run
from bridge.daemon.worker_run import Progress, WorkerRun
from bridge.progress import Movement


def at_a_step(now: float, share: float, reads: bool) -> tuple[str, float, int]:
    return "importing", share * now, int(now) if reads else 0


@pytest.mark.parametrize(
    ("share", "reads", "moves"),
    [
        (1.0, False, True),
        (0.02, False, True),  # the process shares its core with fifty others
        (0.003, False, False),  # a wait that polls
        (0.0, False, False),
        (0.0, True, True),  # a slow disk
    ],
)
def test_computing_and_reading_are_progress(share: float, reads: bool, moves: bool) -> None:
    movement = Movement(0.0)
    for half in range(1, 241):
        movement.update(half / 2, *at_a_step(half / 2, share, reads))
    assert movement.still(120.0) == (0.0 if moves else 119.5)


def heartbeat(movement: Movement) -> None:
    movement.move(50.0)


def another_step(movement: Movement) -> None:
    movement.update(50.0, "another", 7.0)


@pytest.mark.parametrize("moves", [heartbeat, another_step])
def test_a_heartbeat_and_another_step_are_progress(moves: Callable[[Movement], None]) -> None:
    movement = Movement(0.0)
    movement.update(1.0, "one", 2.0)
    movement.update(2.0, "one", 7.0)
    assert movement.computed() == 5.0
    moves(movement)
    assert movement.still(51.0) == 1.0
    assert movement.computed() == 0.0


@pytest.mark.parametrize("reported", [True, False], ids=["report-waited", "no-report"])
def test_time_in_which_the_daemon_was_suspended_does_not_delay_the_detection_of_a_hang(
    monkeypatch: pytest.MonkeyPatch, *, reported: bool
) -> None:
    now = [100.0]
    monkeypatch.setattr(worker_run, "time", SimpleNamespace(monotonic=lambda: now[0]))
    run = WorkerRun()
    now[0] += 61.0
    if reported:
        run.on_heartbeat()  # it waited in the pipe, and is read before the time is forgiven
    run.forgive(60.0)
    assert run.still == (0.0 if reported else 1.0)
    assert run.progress(5.0) is Progress.NORMAL
    now[0] += 5.5
    assert run.progress(5.0) is Progress.LATE
