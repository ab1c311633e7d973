"""``Thread`` and ``PeriodicThread`` with YARP's methods, on Python's threads."""

from __future__ import annotations

import threading

from yarp_compat.interruptible import interruptible
from yarp_compat.os import time as clock
from yarp_compat.overriding import override
from yarp_compat.wire.accessors import getter


def ended(thread: threading.Thread, seconds: float) -> bool:
    """Wait for the end of a thread, at most ``seconds`` (negative: no limit); return whether it has ended."""

    def join(left: float | None) -> bool:
        thread.join(left)
        return not thread.is_alive()

    return interruptible(join, None if seconds < 0 else seconds)


class Thread:
    """The base class of threads, which override ``run``; ``run`` should return when ``isStopping()`` is true."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()

    def run(self) -> None:
        """Do the thread's work."""
        raise NotImplementedError(f"{type(self).__name__} has no run")

    def threadInit(self) -> bool:
        """Prepare, on the new thread; return False to end it."""
        return True

    def threadRelease(self) -> None:
        """Release resources, on the thread."""

    def onStop(self) -> None:
        """Interrupt a waiting `run`; called on the thread that calls `stop`."""

    def beforeStart(self) -> None:
        """Prepare on the calling thread, before the new one starts."""

    def afterStart(self, success: bool) -> None:
        """React on the calling thread to the start, or its failure."""

    def start(self) -> bool:
        """Start the thread; return False if ``threadInit`` fails."""
        self.join()
        self._stopping.clear()
        self.beforeStart()
        ready = threading.Event()
        started: list[bool] = []

        def work() -> None:
            try:
                started.append(bool(self.threadInit()))
            finally:
                ready.set()
            if started[0]:
                try:
                    self._work()
                finally:
                    self.threadRelease()

        self._thread = threading.Thread(target=work, name=f"yarp {type(self).__name__}", daemon=True)
        self._thread.start()
        ready.wait()
        success = bool(started and started[0])
        self.afterStart(success)
        return success

    def stop(self) -> bool:
        """Ask the thread to end, and wait until it has."""
        self._stopping.set()
        self.onStop()
        return self.join()

    def join(self, seconds: float = -1) -> bool:
        """Wait for the end, at most ``seconds`` (negative: no limit); return whether the thread has ended."""
        thread = self._thread
        if thread is None or thread is threading.current_thread():
            return True
        return ended(thread, seconds)

    def isStopping(self) -> bool:
        """Return whether `stop` was called."""
        return self._stopping.is_set()

    def isRunning(self) -> bool:
        """Return whether the thread is running."""
        return self._thread is not None and self._thread.is_alive()

    def _work(self) -> None:
        self.run()

    def getKey(self) -> int:
        """Return the thread's identifier; -1 before it started."""
        return -1 if self._thread is None or self._thread.ident is None else self._thread.ident


class PeriodicThread(Thread):
    """The base class of periodic threads, which override ``run``; the period is in seconds."""

    def __init__(self, period: float) -> None:
        super().__init__()
        self._period = period
        self._suspended = False
        self._rounds = 0

    def setPeriod(self, period: float) -> bool:
        """Change the period, in seconds."""
        self._period = period
        return True

    getPeriod = getter("_period", float, "The period in seconds.")
    getIterations = getter("_rounds", int, "The number of cycles.")

    def suspend(self) -> None:
        """Skip cycles until `resume`."""
        self._suspended = True

    def resume(self) -> None:
        """Continue after `suspend`."""
        self._suspended = False

    isSuspended = getter("_suspended", bool, "Whether cycles are skipped.")

    def askToStop(self) -> None:
        """Ask the thread to end after this cycle, without waiting."""
        self._stopping.set()

    def step(self) -> None:
        """Execute one cycle on the calling thread."""
        self.run()

    @override
    def _work(self) -> None:
        due = clock.steady()
        while not self.isStopping():
            if not self._suspended:
                self.run()
                self._rounds += 1
            now = clock.steady()
            due = min(max(due + self._period, now - self._period), now + self._period)
            clock.wait(self._stopping, due - now, now)
