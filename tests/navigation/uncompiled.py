"""Simulates a build in which one kernel is not compiled."""

from __future__ import annotations

import pytest

from bridge import kernels
from navigation.status import Compiled


def uncompiled(monkeypatch: pytest.MonkeyPatch) -> Compiled:
    """Return the state of a module that started with one kernel uncompiled."""
    monkeypatch.setattr(kernels, "state", lambda: kernels.KernelState(("navigation.algorithms.stopping",), ()))
    return Compiled()
