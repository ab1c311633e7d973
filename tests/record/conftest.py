"""Fixtures shared by the tests of recording."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from bridge.record import worker


@pytest.fixture(autouse=True)
def priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not lower the priority of threads in the tests' process: zenoh's threads persist, also in later tests."""
    monkeypatch.setattr(worker, "low_priority", nullcontext)
