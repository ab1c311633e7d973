"""A build without one kernel."""

from __future__ import annotations

import pytest

from bridge import kernels
from navigation.status import Compiled


def uncompiled(monkeypatch: pytest.MonkeyPatch) -> Compiled:
    """Return the state of a module that started without one compiled kernel."""
    monkeypatch.setattr(kernels, "state", lambda: kernels.KernelState(("navigation.algorithms.stopping",), ()))
    return Compiled()
