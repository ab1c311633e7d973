"""The supervisor's event loop: file descriptors, and a wake-up for signal handlers."""

from __future__ import annotations

import contextlib
import selectors
import socket
from collections.abc import Callable

Callback = Callable[[], None]


class SelectorLoop:
    """Calls back when descriptors are ready. Only `wake` is thread-safe, and safe in signal handlers."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._readers: dict[int, Callback] = {}
        self._writers: dict[int, Callback] = {}
        self._wake_read, self._wake_write = socket.socketpair()
        self._wake_read.setblocking(False)
        self._wake_write.setblocking(False)
        self.on_readable(self._wake_read.fileno(), self._woken)

    def on_readable(self, file: int, callback: Callback | None) -> None:
        """Call back whenever the descriptor is readable; None ends the callbacks."""
        self._set(self._readers, file, callback)

    def on_writable(self, file: int, callback: Callback | None) -> None:
        """Call back whenever the descriptor is writable; None ends the callbacks."""
        self._set(self._writers, file, callback)

    def unwatch(self, file: int) -> None:
        """End all callbacks of a descriptor, before it is closed."""
        self.on_readable(file, None)
        self.on_writable(file, None)

    def _set(self, callbacks: dict[int, Callback], file: int, callback: Callback | None) -> None:
        if callback is None:
            callbacks.pop(file, None)
        else:
            callbacks[file] = callback
        events = selectors.EVENT_READ * (file in self._readers) | selectors.EVENT_WRITE * (file in self._writers)
        watched = file in self._selector.get_map()
        if events and watched:
            self._selector.modify(file, events)
        elif events:
            self._selector.register(file, events)
        elif watched:
            self._selector.unregister(file)

    def wake(self) -> None:
        """Make a running `step` return."""
        with contextlib.suppress(BlockingIOError):
            self._wake_write.send(b"w")

    def step(self, seconds: float) -> None:
        """Wait at most this many seconds for ready descriptors, and call back."""
        ready = [
            (callbacks, key.fd, callbacks[key.fd])
            for key, events in self._selector.select(seconds)
            for event, callbacks in ((selectors.EVENT_READ, self._readers), (selectors.EVENT_WRITE, self._writers))
            if events & event
        ]
        for callbacks, file, callback in ready:
            if callbacks.get(file) == callback:  # an earlier callback may have ended it
                callback()

    def _woken(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._wake_read.recv(4096):
                pass

    def close(self) -> None:
        """Close the loop's descriptors."""
        self._selector.close()
        self._wake_read.close()
        self._wake_write.close()
