"""The thread that all ports of a process share: it accepts connections, does handshakes, and sends to slow peers."""

from __future__ import annotations

import contextlib
import functools
import heapq
import itertools
import logging
import os
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

_log = logging.getLogger("yarp.ports")
_lock = threading.Lock()
_shared: PortLoop | None = None


@dataclass(slots=True, order=True)
class LoopTimer:
    """A callback due at a time of the monotonic clock."""

    at: float
    order: int
    callback: Callable[[], None] | None = field(compare=False)


def _nothing() -> None:
    pass


class PortLoop:
    """A thread for sockets, timers and calls, which must not block. Only this thread may `watch` and `ignore`."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._wake_in, self._wake_out = socket.socketpair()
        self._wake_in.setblocking(False)
        self._wake_out.setblocking(False)
        self._calls: deque[Callable[[], None]] = deque()
        self._timers: list[LoopTimer] = []
        self._cancelled = 0
        self._order = itertools.count()
        self._running = True
        self._over = False
        self.users = 0
        self._thread = threading.Thread(target=self._run, name="yarp-loop", daemon=True)
        self._thread.start()

    def call(self, callback: Callable[[], None]) -> None:
        """Schedule a call on the thread; if the thread has ended, the caller runs it itself."""
        self._calls.append(callback)
        if self._over:
            self._make_calls()
        with contextlib.suppress(OSError):
            self._wake_out.send(b"\0")

    def run(self, callback: Callable[[], None]) -> None:
        """Run a callback on the thread and wait until it is done."""
        done = threading.Event()

        def call() -> None:
            try:
                callback()
            finally:
                done.set()

        self.call(call)
        done.wait()

    def call_later(self, seconds: float, callback: Callable[[], None]) -> LoopTimer:
        """Schedule a call after a delay; only from this loop's thread."""
        timer = LoopTimer(time.monotonic() + seconds, next(self._order), callback)
        heapq.heappush(self._timers, timer)
        return timer

    def cancel(self, timer: LoopTimer) -> None:
        """Cancel a timer; only from this loop's thread."""
        timer.callback = None
        self._cancelled += 1
        if self._cancelled > len(self._timers) // 2 + 16:
            self._timers = [t for t in self._timers if t.callback is not None]
            heapq.heapify(self._timers)
            self._cancelled = 0

    def watch(self, sock: socket.socket, events: int, callback: Callable[[int], None]) -> None:
        """Call back when a socket is readable or writable."""
        try:
            self._selector.modify(sock, events, callback)
        except KeyError:
            self._selector.register(sock, events, callback)

    def ignore(self, sock: socket.socket) -> bool:
        """Stop watching a socket, before it is closed; return whether it was watched."""
        try:
            self._selector.unregister(sock)
        except (KeyError, ValueError):
            return False
        return True

    @property
    def is_own_thread(self) -> bool:
        """Whether the caller is this loop's thread."""
        return threading.current_thread() is self._thread

    def stop(self) -> None:
        """End the thread after the calls that are already scheduled."""

        def end() -> None:
            self._running = False

        self.call(end)
        if not self.is_own_thread:
            self._thread.join()

    def _run(self) -> None:
        self._selector.register(self._wake_in, selectors.EVENT_READ, self._woken)
        while self._running:
            self._poll(max(0.0, self._timers[0].at - time.monotonic()) if self._timers else None)
            while self._timers and self._timers[0].at <= time.monotonic():
                self._do(heapq.heappop(self._timers).callback or _nothing)
            self._make_calls()
        self._poll(0.0)  # connections closed since the last poll still have their sockets
        self._over = True
        self._make_calls()
        self._selector.close()
        self._wake_in.close()
        self._wake_out.close()

    def _poll(self, pause: float | None) -> None:
        for key, events in self._selector.select(pause):
            self._do(functools.partial(key.data, events))

    def _make_calls(self) -> None:
        with contextlib.suppress(IndexError):
            while True:
                self._do(self._calls.popleft())

    def _woken(self, _: int) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._wake_in.recv(4096):
                pass

    def _do(self, callback: Callable[[], None]) -> None:
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
