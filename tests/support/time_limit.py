"""Hold pytest-timeout's timer while a report is made: an error there ends the whole run with INTERNALERROR.

The report of a failed test reads source files, which takes seconds on a busy machine.
"""

from __future__ import annotations

import signal
from collections.abc import Generator
from typing import Any

import pytest

_LEAST_SECONDS = 10.0
"""Time for what follows the report outside of any test, before the teardown's own protection begins."""


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
