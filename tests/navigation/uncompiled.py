"""A build that lacks a kernel."""

from __future__ import annotations

import pytest

from bridge import kernels
from navigation.status import Compiled


def uncompiled(monkeypatch: pytest.MonkeyPatch) -> Compiled:
    """What a module finds that starts where one kernel is not compiled."""
    monkeypatch.setattr(kernels, "state", lambda: kernels.KernelState(("navigation.some_kernel",), ()))
    return Compiled()
