"""Clocks that a test sets."""

from __future__ import annotations

import time

import pytest


class Clock:
    """A monotonic clock whose time in seconds is ``now``. It replaces the module `time` in a tested module."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now


class ProcessClock:
    """The monotonic and the system clock of this process, which both show ``now``, in seconds."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1000.0
        monkeypatch.setattr(time, "monotonic", lambda: self.now)
        monkeypatch.setattr(time, "time_ns", lambda: int(self.now * 1e9))
        monkeypatch.setattr(time, "clock_gettime_ns", lambda _clock: int(self.now * 1e9))
