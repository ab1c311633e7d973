"""How a demo ends: in good order, or at once after Ctrl-C, and with nothing left behind."""

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

from bridge.demo.leftovers import erase, remove_unread, remove_unused, shared_memory
from bridge.demo.processes import DemoChild, Program
from bridge.demo.sandbox import Sandbox

SECONDS = 3.0
"""Within so long after Ctrl-C the demo has ended."""

_KILL_SECONDS, _EXIT_SECONDS = 0.9, 1.7
"""Seconds after Ctrl-C at which parts that have not ended are killed, and at which all is, whatever still waits."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
INTERRUPTED = 130
"""Exit code."""


class Shutdown:
    """Turns the first signal to end into one `KeyboardInterrupt`, and none while something is made or undone.

    Python acts on a signal between two steps of its main thread alone, and drops what is raised where an object is
    taken down. So `look` raises it once more, and a thread ends the process where the main one does not get there.
    """

    def __init__(self) -> None:
        self._interrupted_at: float | None = None
        self._held = 0
        self._erase: Callable[[], Any] = lambda: None
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
            return  # until the process has ended
        for number, handler in self._old.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._old_wakeup)
        os.close(self._writes)  # ends the thread

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """What is done within is done whole; a signal is acted on after it."""
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
        self.check()

    def ignore_signals(self) -> None:
        """Undo in peace: nothing is raised any more."""
        self._held += 1

    def guard(self, erase: Callable[[], Any]) -> None:
        """What leaves nothing behind, on any thread, where the main one is not in time."""
        self._erase = erase

    def check(self) -> None:
        """Raise `KeyboardInterrupt` where the demo is to end."""
        if self._interrupted_at is not None and not self._held:
            raise KeyboardInterrupt

    def until(self, seconds: float) -> Callable[[], bool]:
        """Whether parts may still end by themselves: for so long from now on, less once the demo was interrupted."""
        end = time.monotonic() + seconds

        def may() -> bool:
            latest = end if self._interrupted_at is None else min(end, self._interrupted_at + _KILL_SECONDS)
            return time.monotonic() < latest

        return may

    def exit_if_interrupted(self, code: int) -> None:
        """End the process at once where the demo was interrupted: zenoh's threads take Python up to 2 s to end."""
        if self.interrupted:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)

    @property
    def interrupted(self) -> bool:
        """Whether it was interrupted."""
        return self._interrupted_at is not None

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        first = self._interrupted_at is None
        self._interrupted_at = self._interrupted_at or time.monotonic()
        if first and not self._held:
            raise KeyboardInterrupt

    def _watch(self) -> None:
        """From the signal itself on, which the main thread may not have seen yet."""
        numbers = os.read(self._reads, 1)
        while numbers and numbers[0] not in _SIGNALS:
            numbers = os.read(self._reads, 1)
        if not numbers:
            os.close(self._reads)
            return
        time.sleep(_EXIT_SECONDS)
        with contextlib.suppress(Exception):
            self._erase()
        if sys.stdout.isatty():
            os.write(1, b"\x1b[?25h\n")  # the cursor, which a live table hides
        os._exit(INTERRUPTED)


_log = logging.getLogger(__name__)
_POLL_SECONDS = 0.02
_MEMORY_SECONDS = 0.2
"""So often it is looked which shared memory the processes use: one that ends as it comes up may leave some."""

Stage = tuple[Sequence[DemoChild | Program], float]
"""Processes that are asked to end at the same time, and how many seconds they may take."""


def end_all(sandbox: Sandbox, shutdown: Shutdown, stages: Sequence[Stage]) -> None:
    """Ask stage after stage, all at once where the demo was interrupted; then kill what has not ended."""
    shutdown.ignore_signals()
    memory, ports = shared_memory(sandbox.folder, sandbox.domain_ports)
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
                own_files, shared = shared_memory(sandbox.folder, sandbox.domain_ports)
                memory, ports = memory | own_files, ports | shared
    left = erase(sandbox.folder, sandbox.domain_ports)
    if left and not shutdown.interrupted:
        _log.warning("these processes had to be killed: %s", ", ".join(left))
    remove_unused(memory)
    remove_unread(ports)
    for process in every:
        if not shutdown.interrupted:
            process.close()  # what it says last is read
