"""`tests.support.processor_share`: limits in seconds on a machine that runs other programs too."""

from __future__ import annotations

import subprocess
import sys
import time
from types import SimpleNamespace

import psutil
import pytest

from tests.support import processor_share
from tests.support.processor_share import ProcessorShare, ProcessorShares

BUSY = "import time\nwhile time.process_time() < 0.5: pass"


@pytest.mark.parametrize(("others", "share"), [(0.0, 1.0), (1.0, 0.75), (3.0, 0.25), (9.0, 0.25)])
def test_share_is_what_other_programs_left(monkeypatch: pytest.MonkeyPatch, others: float, share: float) -> None:
    used, clock = iter([10.0, 10.0 + others]), iter([5.0, 7.0])
    monkeypatch.setattr(processor_share, "CPUS", 2)
    monkeypatch.setattr(processor_share, "_others", lambda: next(used))
    monkeypatch.setattr(processor_share, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    assert ProcessorShare().least() == share


def test_parts_of_the_time_have_their_own_share(monkeypatch: pytest.MonkeyPatch) -> None:
    used, clock = iter([0.0, 0.0, 1.0, 1.0, 1.0]), iter([0.0, 1.0, 2.0, 3.0, 3.5])
    monkeypatch.setattr(processor_share, "CPUS", 2)
    monkeypatch.setattr(processor_share, "_others", lambda: next(used))
    monkeypatch.setattr(processor_share, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    shares = ProcessorShares()
    for _ in range(3):
        shares._sample()
    assert shares.during(1.2, 1.8) == 0.5
    assert shares.during(0.2, 0.8) == 1.0, "the load came later"


def test_own_programs_are_not_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """They do not count, neither while they run nor after they have ended."""
    times = psutil.cpu_times()
    monkeypatch.setattr(psutil, "cpu_times", lambda: times)
    before = processor_share._others()
    with subprocess.Popen(
        [sys.executable, "-c", BUSY + "\nprint(flush=True)\ninput()"], stdin=-1, stdout=-1
    ) as program:
        assert program.stdout is not None
        program.stdout.readline()
        assert before - processor_share._others() > 0.4
        program.communicate(b"\n")
    assert before - processor_share._others() > 0.4
    begun = time.process_time()
    while time.process_time() - begun < 0.1:
        pass
    assert before - processor_share._others() > 0.5
