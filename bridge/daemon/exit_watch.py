"""Notices the exit of a worker's process on the daemon's loop, without polling if the system reports exits."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable

from yarp_compat.selector_loop import SelectorLoop


class ExitWatch:
    """Calls back on the loop once a process has exited, until closed; needs Linux 5.3 and a Python built for it."""

    def __init__(self, loop: SelectorLoop, pid: int, on_exit: Callable[[], None]) -> None:
        self._loop, self._on_exit = loop, on_exit
        self._file = _process_file(pid)
        if self._file is not None:
            loop.on_readable(self._file, self._exited)

    @property
    def active(self) -> bool:
        """Whether the system will report the exit; otherwise the caller has to poll for it."""
        return self._file is not None

    def _exited(self) -> None:
        self.close()  # the descriptor stays readable
        self._on_exit()

    def close(self) -> None:
        """Stop watching. Safe to call twice."""
        file, self._file = self._file, None
        if file is not None:
            self._loop.unwatch(file)
            os.close(file)


def _process_file(pid: int) -> int | None:
    """Return a descriptor that is readable once the process has exited (pidfd_open(2)), None without one."""
    if sys.platform == "linux" and hasattr(os, "pidfd_open"):
        with contextlib.suppress(OSError):  # an earlier system, a sandbox, or no free descriptor
            return os.pidfd_open(pid)
    return None
