"""What a failed test leaves open does not fail later tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.inner_run import run_tests

TESTS = """
import gc
import socket

class Socket(socket.socket): ...

def test_failing():
    left = Socket()
    left.own = left  # only the garbage collector frees it
    assert left is None

def test_next(): gc.collect()
def test_last(): gc.collect()
"""


@pytest.mark.parametrize(
    ("options", "outcome"), [(["-p", "tests.support.release"], "1 failed, 2 passed"), ([], "2 failed, 1 passed")]
)
def test_later_tests_pass(tmp_path: Path, options: list[str], outcome: str) -> None:
    (tmp_path / "test_leak.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\nfilterwarnings = error\n")
    assert outcome in run_tests(tmp_path, *options).stdout
