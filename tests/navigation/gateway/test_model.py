"""Random sequences of faults and requests with a simulated planner and base: no report may contradict the base.

A failed run prints its events; `world.run` with the same seed repeats the run.
"""

from __future__ import annotations

import pytest

from tests.peers.navigation import world

FOUND = (9, 26, 32, 104, 327, 330, 335, 544, 3037, 3115, 3574, 4470, 4532, 6042, 6171, 6660, 7170, 7688)
"""Seeds that once found a fault, or a gap in the model."""

BLOCK = 100
"""Runs per test; they take about 8 s on one core."""


@pytest.mark.parametrize("seed", FOUND)
def test_reports_never_contradict_the_base_in_recorded_seeds(seed: int) -> None:
    assert world.run(seed).gateway is not None


def test_no_report_contradicts_the_base() -> None:
    runs = [world.run(seed) for seed in range(BLOCK)]
    assert len({run.planner for run in runs}) == 2
    assert sum(len(run.answers) for run in runs) > BLOCK // 2, "stops and pauses were answered"


@pytest.mark.thorough
@pytest.mark.parametrize("first", range(BLOCK, 4 * BLOCK, BLOCK))
def test_no_report_contradicts_the_base_in_three_hundred_runs(first: int) -> None:
    assert all(world.run(seed).gateway is not None for seed in range(first, first + BLOCK))
