"""``Thread`` and ``PeriodicThread`` with YARP's methods, on Python's threads."""

from __future__ import annotations

import threading

from yarp_compat.os import time as clock
from yarp_compat.wire.accessors import getter


class Thread:
    """Derive from it; ``run`` is what it does, until it ends or, when `stop` was called, sees ``isStopping()``."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()

    def run(self) -> None:
        """The thread's work."""
        raise NotImplementedError(f"{type(self).__name__} has no run")

    def threadInit(self) -> bool:
        """Prepare, on the new thread; False ends it."""
        return True

    def threadRelease(self) -> None:
        """Put things away, on the thread."""

    def onStop(self) -> None:
        """Let go of what `run` may wait for; on the thread that calls `stop`."""

    def beforeStart(self) -> None:
        """Called before the thread starts."""

    def afterStart(self, success: bool) -> None:
        """Called when it has started, or failed to."""

    def start(self) -> bool:
        """Start; False when ``threadInit`` says so."""
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
        """Tell the thread to end, and wait for that."""
        self._stopping.set()
        self.onStop()
        return self.join()

    def join(self, seconds: float = -1) -> bool:
        """Wait for the end, at most so long (negative: without a limit); whether it has come."""
        thread = self._thread
        if thread is None or thread is threading.current_thread():
            return True
        thread.join(None if seconds < 0 else seconds)
        return not thread.is_alive()

    def isStopping(self) -> bool:
        """Whether `stop` was called."""
        return self._stopping.is_set()

    def isRunning(self) -> bool:
        """Whether the thread runs."""
        return self._thread is not None and self._thread.is_alive()

    def _work(self) -> None:
        self.run()

    def getKey(self) -> int:
        """The thread's number; -1 before it started."""
        return -1 if self._thread is None or self._thread.ident is None else self._thread.ident


class PeriodicThread(Thread):
    """Derive from it; ``run`` is called once a period, in seconds."""

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
    getIterations = getter("_rounds", int, "The number of rounds.")

    def suspend(self) -> None:
        """Skip rounds until `resume`."""
        self._suspended = True

    def resume(self) -> None:
        """Go on after `suspend`."""
        self._suspended = False

    isSuspended = getter("_suspended", bool, "Whether rounds are skipped.")

    def askToStop(self) -> None:
        """Tell the thread to end after this round, without waiting."""
        self._stopping.set()

    def step(self) -> None:
        """Do one round on the calling thread."""
        self.run()

    def _work(self) -> None:
        due = clock.steady()
        while not self.isStopping():
            if not self._suspended:
                self.run()
                self._rounds += 1
            now = clock.steady()
            due = min(max(due + self._period, now - self._period), now + self._period)
            clock.wait(self._stopping, due - now, now)
