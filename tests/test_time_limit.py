"""A time limit that ends while a failure is being reported does not end the run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]

CONFTEST = """
import time
import pytest

@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_makereport(item, call):
    end = time.monotonic() + 1.5
    while call.when == "call" and time.monotonic() < end:  # a busy machine
        pass
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
        pass

def test_next(): ...
"""


def test_time_limit_that_ends_during_a_report(tmp_path: Path) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = timeout")
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_it.py").write_text(TESTS)
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:randomly", "-p", "tests.support.time_limit"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_ADDOPTS": ""},
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert "2 failed, 1 passed" in run.stdout, run.stdout + run.stderr
    assert "Timeout" in run.stdout
    assert run.returncode == 1
