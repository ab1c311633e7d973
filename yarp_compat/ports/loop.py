"""The thread that all ports of a process share: it accepts connections, does handshakes, and sends to slow peers."""

from __future__ import annotations

import logging
import os
import threading
from functools import partial

from yarp_compat.selector_loop import Callback
from yarp_compat.threaded_loop import ThreadedLoop

_log = logging.getLogger("yarp.ports")
_lock = threading.Lock()
_shared: PortLoop | None = None


_CHECK_PERIOD = 0.5


class PortLoop(ThreadedLoop):
    """The shared loop; ``users`` is the number of open ports."""

    def __init__(self) -> None:
        # a last step, because connections closed since the last poll still have their sockets
        super().__init__("yarp-loop", lambda: self.step(0.0), _log)
        self.users = 0
        self._checks: set[Callback] = set()
        self._checking = False
        self.start()

    def add_check(self, check: Callback) -> None:
        """Call ``check`` twice a second, together with all others, until `remove_check`; it must not block."""
        self.call_soon(partial(self._add_check, check))

    def remove_check(self, check: Callback) -> None:
        """Stop calling ``check``; it may still be called once."""
        self.call_soon(partial(self._checks.discard, check))

    def _add_check(self, check: Callback) -> None:
        self._checks.add(check)
        if not self._checking:
            self._checking = True
            self.call_later(_CHECK_PERIOD, self._check_all)

    def _check_all(self) -> None:
        for check in tuple(self._checks):
            self._run(check)
        self._checking = bool(self._checks)
        if self._checking:
            self.call_later(_CHECK_PERIOD, self._check_all)

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
