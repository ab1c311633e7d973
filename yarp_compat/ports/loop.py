"""The thread that all ports of a process share: it accepts connections, does handshakes, and sends to slow peers."""

from __future__ import annotations

import logging
import os
import threading

from yarp_compat.selector_loop import Callback
from yarp_compat.threaded_loop import ThreadedLoop

_log = logging.getLogger("yarp.ports")
_lock = threading.Lock()
_shared: PortLoop | None = None


class PortLoop(ThreadedLoop):
    """The shared loop; ``users`` is the number of open ports."""

    def __init__(self) -> None:
        # a last step, because connections closed since the last poll still have their sockets
        super().__init__("yarp-loop", lambda: self.step(0.0), _log)
        self.users = 0
        self.start()

    def run(self, callback: Callback) -> None:
        """Run a callback on the thread and wait until it is done."""
        done = threading.Event()

        def call() -> None:
            try:
                callback()
            finally:
                done.set()

        self.call_soon(call)
        done.wait()


def acquire() -> PortLoop:
    """Return the process's loop for a port that opens; the loop ends when the last port closes."""
    global _shared
    with _lock:
        if _shared is None:
            _shared = PortLoop()
        _shared.users += 1
        return _shared


def release(loop: PortLoop) -> None:
    """Release the loop that `acquire` returned."""
    global _shared
    with _lock:
        loop.users -= 1
        last = loop.users == 0
        if last and _shared is loop:
            _shared = None
    if last:
        loop.stop()


def _forked() -> None:
    global _shared, _lock
    _lock = threading.Lock()
    _shared = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)
