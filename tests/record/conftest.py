"""Fixtures shared by the tests of recording."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from bridge.record import worker


@pytest.fixture(autouse=True)
def priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep the normal priority in the tests' process: zenoh's threads persist, and later tests would inherit it."""
    monkeypatch.setattr(worker, "yielding", nullcontext)
