"""What systemd's ``MemoryDenyWriteExecute=yes`` does to a process: memory that was written is never run."""

from __future__ import annotations

import ctypes
import sys

_PR_SET_MDWE, _PR_MDWE_REFUSE_EXEC_GAIN = 65, 1  # prctl(2), Linux 6.3


def seal() -> bool:
    """Seal this process and what it starts; whether the kernel can. For ``preexec_fn`` too."""
    if sys.platform != "linux":
        return False
    return ctypes.CDLL(None).prctl(_PR_SET_MDWE, _PR_MDWE_REFUSE_EXEC_GAIN, 0, 0, 0) == 0
