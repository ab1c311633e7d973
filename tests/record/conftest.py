"""What the tests of recording share."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from bridge.record import worker


@pytest.fixture(autouse=True)
def priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """A recorder in the tests' process yields to nobody: zenoh's threads stay, and all later tests would, too."""
    monkeypatch.setattr(worker, "yielding", nullcontext)
