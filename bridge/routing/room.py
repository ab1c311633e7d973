"""What this process has left of what the machine gives: file descriptors, and room in the state folder."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

from bridge.config import state

FULL = 0.8
"""Share of the descriptors in use from which it is told."""

RAISE = "raise the limit of open files: LimitNOFILE= in the systemd unit, or 'ulimit -n 65536' before midspan run"
"""The cure."""

OUT = frozenset({errno.EMFILE, errno.ENFILE})
"""What the system says when no descriptor is left, for this process or for the machine."""


def warnings(folder: Path) -> list[str]:
    """What is short, each with its cure."""
    return [text for text in (descriptors(), state.trouble(folder)) if text]


def has_descriptor() -> bool:
    """Whether this process can open one more file."""
    try:
        os.close(os.open(os.devnull, os.O_RDONLY))
    except OSError as err:
        return err.errno not in OUT
    return True


def descriptors() -> str:
    """How many descriptors are in use where that is nearly all, with what helps; "" where there is room."""
    if sys.platform == "win32":
        return ""
    import resource

    soft, _hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        # Linux tells the number since 6.2, elsewhere they are counted: thousands, and no path is wanted
        used = Path("/dev/fd").stat().st_size if sys.platform == "linux" else 0
        used = used or len(os.listdir("/dev/fd"))  # noqa: PTH208
    except OSError as err:
        if err.errno not in OUT:
            return ""
        used = soft
    if soft == resource.RLIM_INFINITY or used < FULL * soft:
        return ""
    return f"{used} of {soft} file descriptors are in use; without one, new topics and programs are refused; {RAISE}"
