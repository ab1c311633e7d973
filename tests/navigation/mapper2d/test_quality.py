"""Maps of the simulator's floors match their plans; `benchmarks/mapper.py` drives all of both floors."""

from __future__ import annotations

import pytest

from benchmarks.mapper import quality


@pytest.mark.parametrize(("plan", "seconds"), [("apartment", 12.0), ("lab", 12.0)])
def test_the_maps_walls_match_the_plan(plan: str, seconds: float) -> None:
    result, scans = quality(plan, seconds)
    assert len(scans) >= 10 * (seconds - 1.0)
    assert result.near == 1.0
    assert result.covered >= 0.95
