"""Time limits of tests: longer on a slow machine, and not reached while a failure is reported.

pytest-timeout's timer must not fire during a report, because an error there ends the whole run with INTERNALERROR. The
report of a failed test reads source files, which takes seconds on a busy machine.
"""

from __future__ import annotations

import signal
from collections.abc import Generator
from typing import Any

import pytest

from tests.support.wait import SLOWNESS

_LEAST_SECONDS = 10.0
"""Seconds for what follows the report outside of any test, before the teardown's own protection begins."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Extend the limits of individual tests; the common limit is an option of pytest-timeout."""
    for item in items if SLOWNESS > 1 else ():
        mark = item.get_closest_marker("timeout")
        if mark is not None and mark.args:
            item.add_marker(pytest.mark.timeout(mark.args[0] * SLOWNESS), append=False)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport() -> Generator[None, Any, Any]:
    if not hasattr(signal, "setitimer"):
        return (yield)
    remaining, _ = signal.setitimer(signal.ITIMER_REAL, 0)
    try:
        return (yield)
    finally:
        if remaining:
            signal.setitimer(signal.ITIMER_REAL, max(remaining, _LEAST_SECONDS))
