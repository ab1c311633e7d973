"""A loop for sockets, timers and calls from other threads, based only on `selectors`.

Midspan's daemon runs one on its only thread, and all ports of a process share one (`yarp_compat.ports.loop`)::

    loop = SelectorLoop()
    loop.on_readable(sock, accept)
    loop.call_later(5.0, check)
    while running:
        loop.step()
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import selectors
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

Callback = Callable[[], object]
File = socket.socket | int

_READ, _WRITE = selectors.EVENT_READ, selectors.EVENT_WRITE

CALLS_PER_STEP = 1000
"""Maximum calls per step. The others wait for the next step, so that many calls do not delay sockets and timers."""


@dataclass(slots=True, order=True)
class Timer:
    """A callback that is due at a time of the monotonic clock."""

    due: float
    order: int
    callback: Callback | None = field(compare=False)


@dataclass(slots=True)
class _Watch:
    """The callbacks of one file."""

    readable: Callback | None
    writable: Callback | None

    @property
    def events(self) -> int:
        return _READ * (self.readable is not None) | _WRITE * (self.writable is not None)


def _descriptor(file: File) -> int:
    """Return a file's descriptor, -1 if closed; given a socket, `selectors` makes two system calls for a `KeyError`."""
    return file if isinstance(file, int) else file.fileno()


class SelectorLoop:
    """Runs callbacks, one `step` after the other; none of them may block.

    Only the thread that calls `step` may use a loop, except for `call_soon` and `wake`: these are safe in all threads
    and in signal handlers. An exception in a callback propagates from `step`; all other callbacks stay due.
    """

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._select: Callable[[float | None], list[tuple[selectors.SelectorKey, int]]] = self._selector.select
        self._calls: deque[Callback] = deque()
        self._timers: list[Timer] = []
        self._canceled = 0
        self._order = itertools.count()
        self._wake_in, self._wake_out = socket.socketpair()
        self._wake_in.setblocking(False)
        self._wake_out.setblocking(False)
        self.on_readable(self._wake_in, self._woken)

    # -- files ---------------------------------------------------------------------------------------------------------

    def watch(self, file: File, readable: Callback | None = None, writable: Callback | None = None) -> None:
        """Replace the callbacks of a file, which run whenever it is readable or writable; None: never.

        Raises `ValueError` for a closed socket.
        """
        try:
            key = self._selector.get_key(_descriptor(file))
        except KeyError:
            watch = _Watch(readable, writable)
            if watch.events:
                self._selector.register(file, watch.events, watch)
            return
        watch = key.data
        watch.readable, watch.writable = readable, writable
        if not watch.events:
            self._selector.unregister(file)
        elif watch.events != key.events:
            self._selector.modify(file, watch.events, watch)

    def on_readable(self, file: File, callback: Callback | None) -> None:
        """Call back whenever the file is readable; None ends the callbacks."""
        self.watch(file, callback, self._callbacks(file).writable)

    def on_writable(self, file: File, callback: Callback | None) -> None:
        """Call back whenever the file is writable; None ends the callbacks."""
        self.watch(file, self._callbacks(file).readable, callback)

    def _callbacks(self, file: File) -> _Watch:
        try:
            watch: _Watch = self._selector.get_key(_descriptor(file)).data
        except KeyError:
            return _Watch(None, None)
        return watch

    def unwatch(self, file: File) -> bool:
        """End all callbacks of a file, before it is closed; return whether there were any."""
        descriptor = _descriptor(file)
        try:
            watch: _Watch = self._selector.unregister(descriptor if descriptor >= 0 else file).data
        except (KeyError, ValueError):
            return False
        watch.readable = watch.writable = None  # the current step may not have called them yet
        return True

    # -- timers and calls ----------------------------------------------------------------------------------------------

    def call_later(self, seconds: float, callback: Callback) -> Timer:
        """Call back once after a delay."""
        timer = Timer(time.monotonic() + seconds, next(self._order), callback)
        heapq.heappush(self._timers, timer)
        return timer

    def cancel(self, timer: Timer) -> None:
        """Cancel a timer, unless it has already run."""
        if timer.callback is None:
            return
        timer.callback = None
        self._canceled += 1
        if self._canceled > len(self._timers) // 2 + 16:
            self._timers = [pending for pending in self._timers if pending.callback is not None]
            heapq.heapify(self._timers)
            self._canceled = 0

    def call_soon(self, callback: Callback) -> None:
        """Call back in the next step, in the order of these calls."""
        self._calls.append(callback)
        self.wake()

    def wake(self) -> None:
        """Make the running `step` return, or if none is running, the next one."""
        with contextlib.suppress(OSError):  # full: the loop will wake anyway; or closed
            self._wake_out.send(b"\0")

    # -- running -------------------------------------------------------------------------------------------------------

    def step(self, seconds: float | None = None) -> None:
        """Wait at most this many seconds for something to do, and do it: each ready file, due timer and call once."""
        pause = self._pause(seconds) if self._calls or self._timers else seconds
        for key, events in self._select(pause):
            watch: _Watch = key.data
            try:  # another thread may end the callbacks in the meantime
                if events & _READ and (callback := watch.readable) is not None:
                    callback()
                if events & _WRITE and (callback := watch.writable) is not None:
                    callback()
            except Exception as err:
                self._failed(err)
        if self._timers:
            self._expire()
        if self._calls:
            for _ in range(min(len(self._calls), CALLS_PER_STEP)):
                self._run(self._calls.popleft())

    def _pause(self, seconds: float | None) -> float | None:
        """Return how long to wait for files: until the next timer, and not at all while calls are left."""
        if self._calls:
            return 0.0
        if self._timers:
            left = max(0.0, self._timers[0].due - time.monotonic())
            return left if seconds is None else min(left, seconds)
        return seconds

    def _expire(self) -> None:
        now = time.monotonic()
        for _ in range(len(self._timers)):
            if not self._timers or self._timers[0].due > now:
                return
            timer = heapq.heappop(self._timers)
            callback, timer.callback = timer.callback, None
            if callback is None:
                self._canceled -= 1
            else:
                self._run(callback)

    def _run(self, callback: Callback) -> None:
        try:
            callback()
        except Exception as err:
            self._failed(err)

    def _failed(self, err: Exception) -> None:
        raise err

    def _woken(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._wake_in.recv(4096):
                pass

    def close(self) -> None:
        self._selector.close()
        self._wake_in.close()
        self._wake_out.close()
