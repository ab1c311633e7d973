"""The streams of a worker's process on the daemon's loop: callbacks receive its data, and writing never blocks.

The loop watches pipes if the system's selectors can. Windows' select waits for sockets only, so each pipe has a thread
that reads or writes it.
"""

from __future__ import annotations

import contextlib
import os
import queue
import select
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import IO

from typing_extensions import override

from yarp_compat.selector_loop import File, SelectorLoop

READ_SIZE = 1 << 16
_LAST_SECONDS = 0.2
_SELECTS_PIPES = hasattr(select, "poll")

OnData = Callable[[bytes], None]
"""Receives the data that has arrived, and b"" once at the end of the stream."""


class Reader(ABC):
    """Reads a pipe, and calls back with its data on the loop."""

    @abstractmethod
    def drain(self) -> None:
        """Deliver the last output of a process that has exited."""

    @abstractmethod
    def close(self) -> None:
        """Stop reading; no further data is delivered."""


class Writer(ABC):
    """Writes without blocking: data for which the stream has no room is written later. Errors are ignored."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Write data, or queue it."""

    @abstractmethod
    def close(self) -> None: ...


def reader(loop: SelectorLoop, pipe: IO[bytes], on_data: OnData) -> Reader:
    """Return a reader of a pipe; the reader closes the pipe."""
    return (_SelectedReader if _SELECTS_PIPES else _ThreadReader)(loop, pipe, on_data)


def writer(loop: SelectorLoop, pipe: IO[bytes]) -> Writer:
    """Return a writer to a pipe; the writer closes the pipe."""
    if not _SELECTS_PIPES:
        return _ThreadWriter(pipe)
    os.set_blocking(pipe.fileno(), False)
    stream = SelectedWriter(loop)
    stream.attach(pipe.fileno(), partial(os.write, pipe.fileno()), pipe.close)
    return stream


class _SelectedReader(Reader):
    """Reads a pipe when the loop finds data."""

    def __init__(self, loop: SelectorLoop, pipe: IO[bytes], on_data: OnData) -> None:
        self._loop, self._pipe, self._on_data = loop, pipe, on_data
        os.set_blocking(pipe.fileno(), False)
        loop.on_readable(pipe.fileno(), self.drain)

    @override
    def drain(self) -> None:
        if self._pipe.closed:
            return
        try:
            data = os.read(self._pipe.fileno(), READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.close()
        self._on_data(data)

    @override
    def close(self) -> None:
        if not self._pipe.closed:
            self._loop.unwatch(self._pipe.fileno())
            self._pipe.close()


class _ThreadReader(Reader):
    """Reads a pipe on a thread, which closes the pipe at its end."""

    def __init__(self, loop: SelectorLoop, pipe: IO[bytes], on_data: OnData) -> None:
        self._loop, self._pipe, self._on_data = loop, pipe, on_data
        self._arrived: deque[bytes] = deque()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="daemon-read", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        data = b"-"
        while data and not self._closed:
            try:
                data = os.read(self._pipe.fileno(), READ_SIZE)
            except OSError:
                data = b""
            self._arrived.append(data)
            self._loop.call_soon(self._deliver)
        self._pipe.close()

    def _deliver(self) -> None:
        while self._arrived and not self._closed:
            self._on_data(self._arrived.popleft())

    @override
    def drain(self) -> None:
        self._thread.join(_LAST_SECONDS)  # would take longer only if a child of the worker keeps the pipe open
        self._deliver()

    @override
    def close(self) -> None:
        self._closed = True


class SelectedWriter(Writer):
    """Writes to a pipe or a socket when the loop finds room; before `attach`, the data is buffered."""

    def __init__(self, loop: SelectorLoop) -> None:
        self._loop = loop
        self._waiting = b""
        self._file: File | None = None
        self._write: Callable[[bytes], int] = len
        self._close: Callable[[], None] = lambda: None

    def attach(self, file: File, write: Callable[[bytes], int], close: Callable[[], None]) -> None:
        """Start writing to a non-blocking file."""
        self._file, self._write, self._close = file, write, close
        self._flush()

    @override
    def write(self, data: bytes) -> None:
        idle = not self._waiting
        self._waiting += data
        if idle:
            self._flush()

    def _flush(self) -> None:
        if self._file is None:
            return
        self._loop.on_writable(self._file, None)
        try:
            while self._waiting:
                self._waiting = self._waiting[self._write(self._waiting) :]
        except BlockingIOError:
            self._loop.on_writable(self._file, self._flush)
        except OSError:
            self._waiting = b""  # the process has exited, which its channel detects

    @override
    def close(self) -> None:
        if self._file is not None:
            self._loop.unwatch(self._file)
            self._file, self._waiting = None, b""  # the rest of a line must not begin the next connection
            self._close()


class _ThreadWriter(Writer):
    """Writes to a pipe on a thread, which closes the pipe at its end."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self._pipe = pipe
        self._queue: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        threading.Thread(target=self._run, name="daemon-write", daemon=True).start()

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            while data := self._queue.get():
                while data:
                    data = data[os.write(self._pipe.fileno(), data) :]
        with contextlib.suppress(OSError):
            self._pipe.close()

    @override
    def write(self, data: bytes) -> None:
        self._queue.put(data)

    @override
    def close(self) -> None:
        self._queue.put(b"")
