"""A `SelectorLoop` that runs on a separate thread, and whose files any thread may add and remove."""

from __future__ import annotations

import contextlib
import errno
import logging
import selectors
import sys
import threading

from yarp_compat.overriding import override
from yarp_compat.selector_loop import Callback, File, SelectorLoop

_log = logging.getLogger(__name__)

_SELECT_LIMIT = 512 if sys.platform == "win32" else 1024
"""``select`` accepts this many files on Windows, and only descriptors below this number elsewhere."""


class ThreadedLoop(SelectorLoop):
    """A loop whose thread runs from `start` to `stop`, and which logs the exceptions of callbacks.

    All threads may use `watch`, `on_readable`, `on_writable`, `unwatch`, `call_soon` and `stop`; timers belong to the
    loop's thread. A callback that has just been replaced may still run once, so files must be non-blocking.

    Args:
        name: the thread's name.
        at_end: called last, on the thread; the loop's own files are closed afterwards.
    """

    def __init__(self, name: str, at_end: Callback = lambda: None, log: logging.Logger = _log) -> None:
        self._lock = threading.RLock()
        self._changes = 0
        self._thread = threading.Thread(target=self._loop, name=name, daemon=True)
        self._at_end, self._logger = at_end, log
        self._running = True
        self._stopping = self._over = False
        self._notices_changes, self._selects = True, False
        super().__init__()
        kind = type(self._selector).__name__
        self._notices_changes = kind in ("EpollSelector", "KqueueSelector")
        self._selects = isinstance(self._selector, selectors.SelectSelector)
        if self._selects:
            self._select = self._select_open

    @property
    def is_own_thread(self) -> bool:
        """Whether the caller is this loop's thread."""
        return threading.current_thread() is self._thread

    def start(self) -> None:
        """Start the thread, unless it was started or the loop is stopped."""
        with self._lock:
            if self._thread.ident is None and not self._stopping:
                self._thread.start()

    def stop(self, seconds: float | None = None) -> None:
        """End the thread after the calls that are already scheduled, and wait for it. Safe to call twice."""
        with self._lock:
            first, self._stopping = not self._stopping, True
            started = self._thread.ident is not None
        if first and started:
            self.call_soon(self._end)
        elif first:
            self._finish()
        if started and not self.is_own_thread:
            self._thread.join(seconds)

    @override
    def watch(self, file: File, readable: Callback | None = None, writable: Callback | None = None) -> None:
        """Replace the callbacks of a file; raises `OSError` if the system cannot watch so many."""
        with self._lock:
            if self._selects and (readable or writable) and not self._fits(file):
                raise OSError(errno.EMFILE, f"this system's select() watches {_SELECT_LIMIT} files at most")
            super().watch(file, readable, writable)
            self._changed()

    @override
    def unwatch(self, file: File) -> bool:
        """End all callbacks of a file, before it is closed; return whether there were any."""
        with self._lock:
            watched = super().unwatch(file)
            self._changes += 1  # last: a thread that has read this number no longer selects the file
            return watched

    @override
    def call_soon(self, callback: Callback) -> None:
        """Schedule a call on the thread; if the thread has ended, the caller runs it itself."""
        super().call_soon(callback)
        if self._over:
            self._make_calls()

    def _fits(self, file: File) -> bool:
        if file in self._selector.get_map():
            return True
        if sys.platform == "win32":
            return len(self._selector.get_map()) < _SELECT_LIMIT
        return (file if isinstance(file, int) else file.fileno()) < _SELECT_LIMIT

    def _changed(self) -> None:
        """Make a waiting thread notice changed files, which `select` and `poll` do not notice by themselves."""
        if not (self._notices_changes or self.is_own_thread):
            self.wake()

    def _select_open(self, pause: float | None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait with `select`, which fails for a file that another thread closes in the meantime."""
        changes = self._changes
        try:
            return self._selector.select(pause)
        except OSError:
            if changes == self._changes:
                raise
            return []

    def _end(self) -> None:
        self._running = False

    def _loop(self) -> None:
        while self._running:
            self.step()
        self._finish()

    def _finish(self) -> None:
        self._run(self._at_end)
        self._over = True
        self._make_calls()
        self.close()

    def _make_calls(self) -> None:
        with contextlib.suppress(IndexError):
            while True:
                self._run(self._calls.popleft())

    @override
    def _failed(self, err: Exception) -> None:
        self._logger.error("a callback of the thread %s failed", self._thread.name, exc_info=err)
