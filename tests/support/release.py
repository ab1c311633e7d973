"""Frees what a failed test left open, so that no later test fails because of it.

The traceback of a failed test keeps its files, sockets and sessions until another test fails. When they are collected,
their warnings are errors of the test that runs at that moment.
"""

from __future__ import annotations

import gc
import sys
import warnings

import pytest

_failed: set[str] = set()


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.failed:
        _failed.add(report.nodeid)


def pytest_runtest_logfinish(nodeid: str) -> None:
    """Collect a failed test's objects without warnings."""
    if nodeid not in _failed:
        return
    _failed.discard(nodeid)
    for name in ("last_exc", "last_type", "last_value", "last_traceback"):
        sys.__dict__.pop(name, None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()
