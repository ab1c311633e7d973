"""The robot drives on within seconds after the system clock was set back or forward."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import pytest

from tests.peers.daemon.midspan import MIDSPAN
from tests.peers.navigation.chain import Chain
from tests.support.process import Process
from tests.support.processor_share import ProcessorShare
from tests.support.shifted_clock import ShiftedClock
from tests.support.wait import until

SECONDS = 12.0
"""Seconds for the first meter after a jump; the drive takes 4 s if no people block the robot."""

REPORT = 10.0
"""Seconds until simulator and modules have reported the jump."""


class ShiftedChain(Chain):
    """A deployment whose daemon and workers use a clock that the test sets."""

    def __init__(self, folder: Path, **options: Any) -> None:
        super().__init__(folder, **options)
        self.clock = ShiftedClock(folder, 3600)

    def run(self) -> None:
        """Start the daemon in a new process, not a fork, because the shifted clock is loaded when a process starts."""
        self.daemon = Process([*MIDSPAN, "run", "--config", self.file], self.clock.environment)

    def until_it_drives(self, meters: float, seconds: float) -> None:
        """Wait until the robot has moved this far from its current pose."""
        begin = self.truth
        assert begin is not None
        moved = lambda: math.dist((self.truth.x, self.truth.y), (begin.x, begin.y)) > meters  # type: ignore[union-attr]  # noqa: E731
        until(moved, "the robot keeps driving", seconds)


@pytest.mark.alone
@pytest.mark.parametrize(
    "shifts",
    [
        pytest.param((3560,), id="40 s back"),
        pytest.param((0,), id="1 h back", marks=pytest.mark.thorough),
        pytest.param((4200, 4198), id="10 min forward, 2 s back", marks=pytest.mark.thorough),
    ],
)
def test_the_robot_keeps_driving_after_the_system_clock_was_set(tmp_path: Path, shifts: tuple[int, ...]) -> None:
    with ShiftedChain(tmp_path, sim={"people": False}) as chain:
        chain.start()
        request = chain.goto("kitchen")
        chain.until_moving()
        chain.until_it_drives(0.3, SECONDS)
        for shift in shifts:
            chain.clock.set(shift)
            share, set_at = ProcessorShare(), time.monotonic()
            until(
                lambda: chain.output().count("the system clock was set ") >= 2,
                "simulator and modules report the jump",
                REPORT,
            )
            chain.until_it_drives(1.0, SECONDS)
            assert time.monotonic() - set_at < (SECONDS + REPORT) / share.least()
            assert request.ended is None, request.reason
        if len(shifts) == 1 and shifts[0]:  # only in one case, because the drive takes 20 s
            until(lambda: request.ended, "the goal ends", 90)
            assert chain.distance_to("kitchen") < 0.3, request.reason
