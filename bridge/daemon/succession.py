"""Handover of a service's worker to a new process with new code, after an upgrade.

On SIGUSR2 the worker starts its own command line again. The new process first loads all of its code, then stops the
old process, and continues as soon as the old process releases the lock. The interruption thus lasts only as long as
opening the endpoints, without a start of Python. This matters because sessions with zenoh's defaults reconnect after
1 s, then after 2 s and 4 s. If the new process cannot load, the old one continues. The old process reports the new main
process to systemd (sd_notify(3)).
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import TypeVar

import psutil

HAND_OVER: signal.Signals | None = getattr(signal, "SIGUSR2", None)
_PREDECESSOR = "MIDSPAN_PREDECESSOR"
_APART = "import os, sys; os.fork() or os.execv(sys.argv[1], sys.argv[1:])"
"""Makes the new process a child of systemd: on a stop, systemd (version 252) kills any other main process at once."""

_SECONDS = 10.0
_POLL_SECONDS = 0.01
T = TypeVar("T")


class Successor:
    """The new process, seen from the old one; it starts on the signal."""

    def __init__(self) -> None:
        self._loaded_pipe: int | None = None
        self._pid = 0
        if HAND_OVER is not None:
            signal.signal(HAND_OVER, lambda _number, _frame: self._start())

    @property
    def pid(self) -> int:
        """The process that is about to take over, 0 if there is none."""
        return 0 if self._is_loading() or not _is_alive(self._pid) else self._pid

    def _is_loading(self) -> bool:
        """Whether a new process has started, but has not reported yet that it has loaded its code."""
        if self._loaded_pipe is None:
            return False
        with contextlib.suppress(BlockingIOError):
            pid = os.read(self._loaded_pipe, 16)
            os.close(self._loaded_pipe)
            self._loaded_pipe, self._pid = None, int(pid or b"0")
        return self._loaded_pipe is not None

    def _start(self) -> None:
        if self._is_loading() or _is_alive(self._pid):
            return
        self._loaded_pipe, report_pipe = os.pipe()
        os.set_blocking(self._loaded_pipe, False)
        environ = {**os.environ, _PREDECESSOR: f"{os.getpid()}:{report_pipe}"}
        environ.pop("WATCHDOG_PID", None)  # systemd's watchdog is also for the new process
        command = [sys.executable, "-ISc", _APART, sys.executable, *sys.orig_argv[1:]]
        subprocess.run(command, env=environ, pass_fds=[report_pipe], check=False)
        os.close(report_pipe)


def _is_alive(pid: int) -> bool:
    return pid > 0 and psutil.pid_exists(pid)


def succeed(acquire: Callable[[], T]) -> T:
    """Stop the process that started this process for a handover, if any, and acquire what that process releases.

    ``acquire`` raises `RuntimeError` while another process holds the resource. If it still does so after 10 s, this
    function raises the same error.
    """
    predecessor, _, report_pipe = os.environ.pop(_PREDECESSOR, "").partition(":")
    if not predecessor:
        return acquire()
    try:
        os.write(int(report_pipe), b"%d" % os.getpid())
        os.kill(int(predecessor), signal.SIGTERM)
    except (BrokenPipeError, ProcessLookupError):
        pass  # the predecessor has exited meanwhile
    finally:
        os.close(int(report_pipe))
    end = time.monotonic() + _SECONDS
    while True:
        try:
            return acquire()
        except RuntimeError:
            if time.monotonic() > end:
                raise
        time.sleep(_POLL_SECONDS)
