"""Time limits: one that expires during the report of a failure does not abort the run; a slow machine extends all."""

from __future__ import annotations

import subprocess
from pathlib import Path

from tests.support.inner_run import run_tests

CONFTEST = """
import time
import pytest

@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_makereport(item, call):
    end = time.monotonic() + 1.5
    while call.when == "call" and time.monotonic() < end:  # a busy machine
        time.sleep(0.01)
    return (yield)
"""

TESTS = """
import time
import pytest

@pytest.mark.timeout(1)
def test_late(): assert 1 == 2

@pytest.mark.timeout(1)
def test_hanging():
    while True:
        time.sleep(0.01)

def test_next(): ...
"""


LIMITED = """
import pytest
from tests.support.wait import until

@pytest.mark.timeout(2)
def test_limits(request, monkeypatch):
    assert request.node.get_closest_marker("timeout").args == (20,)
    monkeypatch.setattr("time.monotonic", iter((0.0, 49.9, 50.1)).__next__)
    with pytest.raises(AssertionError, match="not within 50 s: never"):
        until(lambda: False, "never", 5)
"""


def run_limited(folder: Path, **environ: str) -> subprocess.CompletedProcess[str]:
    """Run the tests of a folder with the plugin."""
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = timeout")
    return run_tests(folder, "-p", "tests.support.time_limit", **environ)


def test_a_limit_that_expires_during_a_report_does_not_abort_the_run(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_it.py").write_text(TESTS)
    run = run_limited(tmp_path)
    assert "2 failed, 1 passed" in run.stdout, run.stdout + run.stderr
    assert "Timeout" in run.stdout
    assert run.returncode == 1


def test_limits_are_longer_on_a_slow_machine(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(LIMITED)
    run = run_limited(tmp_path, MIDSPAN_TEST_SLOWNESS="10")
    assert run.returncode == 0, run.stdout + run.stderr
