"""The common ticks of a process's threads."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge import ticks
from bridge.progress import BUSY_SECONDS, Progress


@given(
    start=st.floats(0.0, 1e6),
    now=st.floats(0.0, 1e6),
    period=st.sampled_from([0.1, 0.25, 0.5, 1.0]),
    offset=st.sampled_from([0.0, 0.5]),
)
def test_threads_wake_up_together_and_no_later_than_after_their_period(
    start: float, now: float, period: float, offset: float
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ticks, "_START", start)
        patch.setattr(ticks, "time", SimpleNamespace(monotonic=lambda: start + now))
        pause = ticks.until_tick(period, offset)
    assert 0.0 < pause <= period
    multiple = (now + pause - offset) / period
    assert multiple == pytest.approx(round(multiple), abs=1e-6)


def test_a_process_is_asked_for_its_step_less_often_while_it_is_idle() -> None:
    """Each step is still reported within twice the time for which steps are not reported."""
    progress = Progress()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bridge.progress.until_tick", lambda period, _: period)
        assert progress.pause == 2 * BUSY_SECONDS
        with progress.busy("starting"):
            assert progress.pause == BUSY_SECONDS
        assert progress.pause == 2 * BUSY_SECONDS
