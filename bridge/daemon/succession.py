"""A service's worker that hands over to a new process of itself: its code is another by now, after an upgrade.

Upon SIGUSR2 it starts its own command line anew. The new process loads everything that it will run, only then ends the
old one, and goes on as soon as that has given back the lock. So what is missing meanwhile is missing for the time that
it takes to open it, not for a start of Python: zenoh's sessions try again after 1 s, and then after 2 s and 4 s.
A new process that cannot load changes nothing. To systemd the old one says who the main process is (sd_notify(3)).
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import TypeVar

HAND_OVER: signal.Signals | None = getattr(signal, "SIGUSR2", None)
_PREDECESSOR = "MIDSPAN_PREDECESSOR"
_SECONDS = 10.0
_LOOK = 0.01
T = TypeVar("T")


class Successor:
    """The new process, in the old one; there is none before the signal."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        if HAND_OVER is not None:
            signal.signal(HAND_OVER, lambda _number, _frame: self._start())

    @property
    def pid(self) -> int:
        """Its process, 0 where there is none (any more)."""
        process = self._process
        return process.pid if process is not None and process.poll() is None else 0

    def _start(self) -> None:
        if not self.pid:
            environ = {**os.environ, _PREDECESSOR: str(os.getpid())}
            environ.pop("WATCHDOG_PID", None)  # systemd's watchdog is for the one that takes over, too
            self._process = subprocess.Popen([sys.executable, *sys.orig_argv[1:]], env=environ)


def succeed(take: Callable[[], T]) -> T:
    """End the process that started this one to hand over, if any, and take what it gives back.

    ``take`` raises `RuntimeError` while another process holds it, as this does where that lasts for 10 s.
    """
    predecessor = os.environ.pop(_PREDECESSOR, "")
    if predecessor != str(os.getppid()):
        return take()
    os.kill(int(predecessor), signal.SIGTERM)
    end = time.monotonic() + _SECONDS
    while True:
        try:
            return take()
        except RuntimeError:
            if time.monotonic() > end:
                raise
        time.sleep(_LOOK)
