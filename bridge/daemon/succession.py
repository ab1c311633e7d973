"""A service's worker that hands over to a new process of itself: its code is another by now, after an upgrade.

Upon SIGUSR2 it starts its own command line anew. The new process loads everything that it will run, only then ends the
old one, and goes on as soon as that has given back the lock. So what is missing meanwhile is missing for the time that
it takes to open it, not for a start of Python: zenoh's sessions try again after 1 s, and then after 2 s and 4 s.
A new process that cannot load changes nothing. To systemd the old one says who the main process is (sd_notify(3)).
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

HAND_OVER: signal.Signals | None = getattr(signal, "SIGUSR2", None)
_PREDECESSOR = "MIDSPAN_PREDECESSOR"
_APART = "import os, sys; os.fork() or os.execv(sys.argv[1], sys.argv[1:])"
"""systemd waits at a stop for a main process that is its own child alone, and kills any other at once (version 252)."""

_SECONDS = 10.0
_LOOK = 0.01
T = TypeVar("T")


class Successor:
    """The new process, in the old one; there is none before the signal."""

    def __init__(self) -> None:
        self._told: int | None = None
        self._pid = 0
        if HAND_OVER is not None:
            signal.signal(HAND_OVER, lambda _number, _frame: self._start())

    @property
    def pid(self) -> int:
        """The process that is about to take over, 0 where there is none (any more)."""
        return 0 if self._loads() or not _lives(self._pid) else self._pid

    def _loads(self) -> bool:
        """Whether one has begun, and has not said yet that it has loaded."""
        if self._told is None:
            return False
        with contextlib.suppress(BlockingIOError):
            said = os.read(self._told, 16)
            os.close(self._told)
            self._told, self._pid = None, int(said or b"0")
        return self._told is not None

    def _start(self) -> None:
        if self._loads() or _lives(self._pid):
            return
        self._told, told = os.pipe()
        os.set_blocking(self._told, False)
        environ = {**os.environ, _PREDECESSOR: f"{os.getpid()}:{told}"}
        environ.pop("WATCHDOG_PID", None)  # systemd's watchdog is for the one that takes over, too
        command = [sys.executable, "-ISc", _APART, sys.executable, *sys.orig_argv[1:]]
        subprocess.run(command, env=environ, pass_fds=[told], check=False)
        os.close(told)


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return pid > 0


def succeed(take: Callable[[], T]) -> T:
    """End the process that started this one to hand over, if any, and take what it gives back.

    ``take`` raises `RuntimeError` while another process holds it, as this does where that lasts for 10 s.
    """
    predecessor, _, told = os.environ.pop(_PREDECESSOR, "").partition(":")
    if not predecessor:
        return take()
    os.write(int(told), b"%d" % os.getpid())
    os.close(int(told))
    os.kill(int(predecessor), signal.SIGTERM)
    end = time.monotonic() + _SECONDS
    while True:
        try:
            return take()
        except RuntimeError:
            if time.monotonic() > end:
                raise
        time.sleep(_LOOK)
