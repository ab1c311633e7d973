"""Threads with YARP's methods."""

from __future__ import annotations

import threading

import yarp_compat as yarp
from tests.support.wait import until


class Counter(yarp.Thread):
    def __init__(self, ready: bool = True) -> None:
        super().__init__()
        self.ready, self.said = ready, []

    def threadInit(self) -> bool:
        self.said.append("init")
        return self.ready

    def run(self) -> None:
        while not self.isStopping():
            if "run" not in self.said:
                self.said.append("run")
            self._stopping.wait(0.01)

    def threadRelease(self) -> None:
        self.said.append("release")


def test_thread_runs_until_stopped() -> None:
    thread = Counter()
    assert thread.start()
    until(lambda: "run" in thread.said, "the thread is running")
    assert thread.isRunning()
    assert thread.stop()
    assert not thread.isRunning()
    assert thread.said == ["init", "run", "release"]


def test_thread_whose_init_fails_does_not_run() -> None:
    thread = Counter(ready=False)
    assert not thread.start()
    assert thread.join()
    assert thread.said == ["init"]


def test_periodic_thread_runs_once_per_period() -> None:
    rounds = []

    class Ticker(yarp.PeriodicThread):
        def run(self) -> None:
            rounds.append(threading.get_ident())

    ticker = Ticker(0.01)
    assert ticker.start()
    until(lambda: len(rounds) >= 3, "three cycles have run")
    ticker.suspend()
    ticker.askToStop()
    assert ticker.stop()
    assert ticker.getIterations() == len(rounds)
    ticker.step()
    assert rounds[-1] == threading.get_ident()
