"""Restricts a process as systemd's ``MemoryDenyWriteExecute=yes`` does: written memory is never executable."""

from __future__ import annotations

import ctypes
import sys

_PR_SET_MDWE, _PR_MDWE_REFUSE_EXEC_GAIN = 65, 1  # prctl(2), Linux 6.3


def seal() -> bool:
    """Restrict this process and its children; return whether the kernel supports it. Usable as ``preexec_fn``."""
    if sys.platform != "linux":
        return False
    return ctypes.CDLL(None).prctl(_PR_SET_MDWE, _PR_MDWE_REFUSE_EXEC_GAIN, 0, 0, 0) == 0
