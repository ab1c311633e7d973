"""Reports the current step of a supervised worker's process, even before it imports anything heavy.

While the main thread is busy (starting, applying a new configuration, or overdue with its health), a separate thread
reports twice a second. This module imports very little so that the reports start early.
"""

from __future__ import annotations

import faulthandler
import functools
import json
import os
import signal
import sys
import threading
from collections.abc import Callable

from bridge.progress import Busy, working

DUMP_STACKS: signal.Signals | None = getattr(signal, "SIGUSR1", None)


def dump_stacks_on_signal() -> None:
    """Dump the stacks of all threads on `DUMP_STACKS`; works without the GIL, so even if all threads wait for it."""
    if DUMP_STACKS is not None:
        faulthandler.register(DUMP_STACKS, all_threads=True)


FIRST_STEP = "loading Python's libraries"
_CLOSE_SECONDS = 1.0


def busy_line(busy: Busy) -> bytes:
    """Encode a ``busy`` report without importing `bridge.daemon.protocol`, which loads many modules."""
    return json.dumps({"busy": busy.text, "used": busy.used, "read": busy.read}).encode() + b"\n"


class Heartbeat:
    """The thread that sends the reports of the current step.

    It reserves standard output for reports: other output of this process goes to stderr, and programs that the worker
    starts do not inherit the pipe.
    """

    def __init__(self) -> None:
        self._output = os.dup(1)
        os.dup2(2, 1)
        sys.stdout = sys.stderr
        self._lock = threading.Lock()
        self._send: Callable[[Busy], None] = lambda busy: self.write(busy_line(busy))
        self._send(Busy(FIRST_STEP, 0.0, 0))
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)
        self._thread.start()

    def write(self, line: bytes) -> None:
        """Write one line to the daemon. Errors are ignored: the reading thread detects a daemon that has exited."""
        with self._lock:
            try:
                while line:
                    line = line[os.write(self._output, line) :]
            except OSError:
                return

    def send_to(self, send: Callable[[Busy], None]) -> None:
        """Send all further reports with this function."""
        self._send = send

    def close(self) -> None:
        """Stop the thread, because Python 3.11 may crash on exit if a daemon thread runs at that time."""
        self._over.set()
        self._thread.join(_CLOSE_SECONDS)

    def _run(self) -> None:
        while not self._over.wait(working.pause):
            busy = working.now()
            if busy is not None:
                self._send(busy)


@functools.cache
def start_heartbeat() -> Heartbeat:
    """Start reporting on standard output; return the process's only `Heartbeat`. Call from the main thread."""
    dump_stacks_on_signal()
    working.begin(FIRST_STEP)
    return Heartbeat()
