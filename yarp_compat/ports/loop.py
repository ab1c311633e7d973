"""The thread that all ports of a process share: it accepts connections, does handshakes, and sends to slow peers."""

from __future__ import annotations

import contextlib
import logging
import os
import threading

from yarp_compat.overriding import override
from yarp_compat.selector_loop import Callback, SelectorLoop

_log = logging.getLogger("yarp.ports")
_lock = threading.Lock()
_shared: PortLoop | None = None


class PortLoop(SelectorLoop):
    """A loop that runs on its own thread and logs the exceptions of callbacks."""

    def __init__(self) -> None:
        super().__init__()
        self._running = True
        self._over = False
        self.users = 0
        self._thread = threading.Thread(target=self._loop, name="yarp-loop", daemon=True)
        self._thread.start()

    @override
    def call_soon(self, callback: Callback) -> None:
        """Schedule a call on the thread; if the thread has ended, the caller runs it itself."""
        super().call_soon(callback)
        if self._over:
            self._make_calls()

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

    @property
    def is_own_thread(self) -> bool:
        """Whether the caller is this loop's thread."""
        return threading.current_thread() is self._thread

    def stop(self) -> None:
        """End the thread after the calls that are already scheduled."""

        def end() -> None:
            self._running = False

        self.call_soon(end)
        if not self.is_own_thread:
            self._thread.join()

    def _loop(self) -> None:
        while self._running:
            self.step()
        self._poll(0.0)  # connections closed since the last poll still have their sockets
        self._over = True
        self._make_calls()
        self.close()

    def _make_calls(self) -> None:
        with contextlib.suppress(IndexError):
            while True:
                self._run(self._calls.popleft())

    @override
    def _run(self, callback: Callback) -> None:
        try:
            callback()
        except Exception:
            _log.exception("a callback of the ports' shared thread failed")


def acquire() -> PortLoop:
    """Return the process's loop for a port that opens; the loop ends with the last port."""
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
