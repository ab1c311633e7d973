"""Ends a demo in order, or quickly after Ctrl-C, and in any case without leftovers."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from types import FrameType, TracebackType
from typing import Any, Self

from bridge.demo.leftovers import SharedMemory, erase
from bridge.demo.processes import DemoChild, Program
from bridge.demo.sandbox import Sandbox

SECONDS = 3.0
"""Maximum time from Ctrl-C until the demo has ended."""

_KILL_SECONDS, _EXIT_SECONDS = 0.9, 1.7
"""Seconds after Ctrl-C at which remaining processes are killed, and at which the demo exits in any case."""

_ERASE_SECONDS = 1.0
"""Seconds by which the exit is delayed while the main thread removes leftovers."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
INTERRUPTED = 130
"""Exit code after an interrupt."""


class Shutdown:
    """Turns the first termination signal into a `KeyboardInterrupt`, deferred while resources are created or released.

    Python handles signals only between two steps of its main thread, and discards exceptions raised in destructors.
    Therefore `check` raises the exception again, and a thread ends the process if the main thread does not.
    """

    def __init__(self) -> None:
        self._interrupted_at: float | None = None
        self._deferrals = 0
        self._erasers: list[Callable[[], Any]] = []
        self._erasing = threading.Lock()
        self._old: dict[signal.Signals, Any] = {}
        self._old_wakeup = -1

    def __enter__(self) -> Self:
        self._reads, self._writes = os.pipe()
        os.set_blocking(self._writes, False)
        threading.Thread(target=self._watch, name="ending", daemon=True).start()
        self._old_wakeup = signal.set_wakeup_fd(self._writes, warn_on_full_buffer=False)
        self._old = {number: signal.signal(number, self._on_signal) for number in _SIGNALS}
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self.ignore_signals()
        if self._interrupted_at is not None:
            return  # keep the handlers until the process ends
        for number, handler in self._old.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._old_wakeup)
        os.close(self._writes)  # ends the thread

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Defer the handling of a signal to the end of the block."""
        self._deferrals += 1
        try:
            yield
        finally:
            self._deferrals -= 1
        self.check()

    def ignore_signals(self) -> None:
        """Ignore signals from now on, for the cleanup."""
        self._deferrals += 1

    def guard(self, erase: Callable[[], Any]) -> None:
        """Add a function that removes leftovers; any thread may call it if the main thread is too slow."""
        self._erasers.append(erase)

    @contextlib.contextmanager
    def erasing(self) -> Iterator[None]:
        """Let the thread that ends the process wait for the block, which removes leftovers itself.

        Both would search all processes of the machine at the same time, which on a busy machine takes seconds.
        """
        with self._erasing:
            yield

    def check(self) -> None:
        """Raise `KeyboardInterrupt` if the demo was interrupted."""
        if self._interrupted_at is not None and not self._deferrals:
            raise KeyboardInterrupt

    def until(self, seconds: float) -> Callable[[], bool]:
        """Return a function: whether processes may still end by themselves; for ``seconds``, or less if interrupted."""
        end = time.monotonic() + seconds

        def may() -> bool:
            latest = end if self._interrupted_at is None else min(end, self._interrupted_at + _KILL_SECONDS)
            return time.monotonic() < latest

        return may

    def exit_if_interrupted(self, code: int) -> None:
        """If the demo was interrupted, exit at once, because zenoh's threads delay a normal exit by up to 2 s."""
        if self.interrupted:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)

    @property
    def interrupted(self) -> bool:
        return self._interrupted_at is not None

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        first = self._interrupted_at is None
        self._interrupted_at = self._interrupted_at or time.monotonic()
        if first and not self._deferrals:
            raise KeyboardInterrupt

    def _watch(self) -> None:
        """Wait for the signal itself, which the main thread may not have handled yet; exit if that takes too long."""
        numbers = os.read(self._reads, 1)
        while numbers and numbers[0] not in _SIGNALS:
            numbers = os.read(self._reads, 1)
        if not numbers:
            os.close(self._reads)
            return
        time.sleep(_EXIT_SECONDS)
        self._erasing.acquire(timeout=_ERASE_SECONDS)  # the process ends, and with it the lock
        for erase_leftovers in self._erasers:
            with contextlib.suppress(Exception):
                erase_leftovers()
        if sys.stdout.isatty():
            os.write(1, b"\x1b[?25h\n")  # show the cursor, which a live table hides
        os._exit(INTERRUPTED)


_log = logging.getLogger(__name__)
_POLL_SECONDS = 0.02
_MEMORY_SECONDS = 0.2
"""Interval of the checks for shared memory in use; a process that ends during its start may leave some."""

Stage = tuple[Sequence[DemoChild | Program], float]
"""Processes that are asked to end at the same time, and their time limit in seconds."""


def end_all(sandbox: Sandbox, shutdown: Shutdown, stages: Sequence[Stage]) -> None:
    """End the stages in sequence, or all at once after an interrupt; then kill what has not ended."""
    shutdown.ignore_signals()
    memory = SharedMemory(sandbox.folder, sandbox.domain_ports)
    memory.note()
    shutdown.guard(memory.remove)
    every = [process for stage, _ in stages for process in stage]
    if shutdown.interrupted:
        stages = [(every, max((seconds for _, seconds in stages), default=0.0))]
    for stage, seconds in stages:
        for process in stage:
            process.begin_stop()
        may = shutdown.until(seconds)
        looked = time.monotonic()
        while any(process.running for process in stage) and may():
            time.sleep(_POLL_SECONDS)
            if time.monotonic() > looked + _MEMORY_SECONDS:
                looked = time.monotonic()
                memory.note()
    with shutdown.erasing():
        left = erase(sandbox.folder, sandbox.domain_ports)
        if left and not shutdown.interrupted:
            _log.warning("these processes had to be killed: %s", ", ".join(left))
        memory.remove()
    for process in every:
        if not shutdown.interrupted:
            process.close()  # to read the remaining output
