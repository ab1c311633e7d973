"""Memory of large messages is returned to the system when no more of them arrive."""

from __future__ import annotations

import pytest

from bridge import resources


def test_memory_is_given_back_once_large_messages_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    watched = resources.LargeMessages()
    watched.passed(1000)
    monkeypatch.setattr(resources, "_IDLE_SECONDS", 0.0)
    assert not watched.trim(), "small messages leave no memory to return"
    watched.passed(50_000_000)
    monkeypatch.setattr(resources, "_IDLE_SECONDS", 1000.0)
    assert not watched.trim(), "memory is kept, because the next large message may arrive soon"
    monkeypatch.setattr(resources, "_IDLE_SECONDS", 0.0)
    assert watched.trim()
    assert not watched.trim(), "memory is returned only once"
