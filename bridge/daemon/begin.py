"""The first moment of a supervised worker's process: it tells what it is at before it imports anything heavy.

Its own thread reports twice a second, for as long as the main thread is busy with one thing: it starts, takes up a new
configuration, or has not said for a while how it is. Imports next to nothing, for that reason.
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

from bridge.progress import BUSY_SECONDS, Busy, working

TELL_STACKS: signal.Signals | None = getattr(signal, "SIGUSR1", None)


def tell_stacks_on_signal() -> None:
    """Answer the signal. It works without Python's lock, so also where that lock is what all threads wait for."""
    if TELL_STACKS is not None:
        faulthandler.register(TELL_STACKS, all_threads=True)


FIRST_WORDS = "loading Python's libraries"
_CLOSE_SECONDS = 1.0


def busy_line(busy: Busy) -> bytes:
    """The report's line in the protocol (`bridge.daemon.protocol`, which is heavy)."""
    return json.dumps({"busy": busy.text, "used": busy.used, "read": busy.read}).encode() + b"\n"


class Heart:
    """Where the reports go, and the thread that sends them.

    Takes the standard output for itself: whatever else in this process writes there reaches stderr, and programs that
    the worker starts do not inherit it.
    """

    def __init__(self) -> None:
        self._output = os.dup(1)
        os.dup2(2, 1)
        sys.stdout = sys.stderr
        self._lock = threading.Lock()
        self._send: Callable[[Busy], None] = lambda busy: self.write(busy_line(busy))
        self._send(Busy(FIRST_WORDS, 0.0, 0))
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heart", daemon=True)
        self._thread.start()

    def write(self, line: bytes) -> None:
        """Write one line to the daemon; one that is gone is noticed elsewhere."""
        with self._lock:
            try:
                while line:
                    line = line[os.write(self._output, line) :]
            except OSError:
                return

    def send_to(self, send: Callable[[Busy], None]) -> None:
        """Send the reports there from now on."""
        self._send = send

    def close(self) -> None:
        """End the thread: Python 3.11 may crash as it ends where a daemon thread wakes meanwhile."""
        self._over.set()
        self._thread.join(_CLOSE_SECONDS)

    def _run(self) -> None:
        while not self._over.wait(BUSY_SECONDS):
            busy = working.now()
            if busy is not None:
                self._send(busy)


@functools.cache
def begin() -> Heart:
    """Begin to tell the daemon on the standard output; the process's one `Heart`. Call from the main thread."""
    tell_stacks_on_signal()
    working.begin(FIRST_WORDS)
    return Heart()
