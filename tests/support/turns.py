"""Decides when a pytest-xdist process starts its next file: once the processors can keep up with the running files.

A simulated robot runs in real time. With more robots than the processors can serve, each test lasts longer, misses its
deadlines, and computes until then, so the whole run takes longer, too. Therefore, a process waits before a file while
many threads are ready to run. At least one file always runs, whatever else the machine does. Only Linux publishes the
number of such threads; on other systems, files start at once.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from pathlib import Path
from typing import IO, Any

import pytest

from tests.support.scheduler import CORES

try:
    import fcntl
except ModuleNotFoundError:  # Windows
    fcntl = None  # type: ignore[assignment]

READY = 2.0
"""Threads per processor, running or ready to run, up to which another file may start."""

_SAMPLES, _EVERY = 10, 0.02
_LOAD = Path("/proc/loadavg")


def ready() -> float:
    """Return how many other threads on the machine are running or ready to run, on average over 0.2 s."""
    total = 0
    for _ in range(_SAMPLES):
        total += int(_LOAD.read_text(encoding="utf-8").split()[3].partition("/")[0]) - 1
        time.sleep(_EVERY)
    return total / _SAMPLES


class Turns:
    """Has the processes of one run take turns.

    The process that decides locks the first byte of a common file. A process that runs a file locks another byte. The
    system releases the locks of a process that ends.
    """

    _GATE, _RUNNING, _MOST = 0, 1, 1000

    def __init__(self, file: IO[bytes], place: int) -> None:
        self._file, self._place = file, self._RUNNING + place

    def take(self) -> None:
        """Wait until another file may start. Processes decide one by one, so that each sees the load of the others."""
        self._lock(self._GATE)
        while self._others_run() and ready() > READY * CORES:
            pass
        self._lock(self._place)
        self._unlock(self._GATE)

    def end(self) -> None:
        """Record that this process runs no file."""
        self._unlock(self._place)

    def close(self) -> None:
        """Remove the file; the other processes continue to use it."""
        Path(self._file.name).unlink(missing_ok=True)
        self._file.close()

    def _others_run(self) -> bool:
        try:
            fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB, self._MOST, self._RUNNING)
        except OSError:
            return True
        self._unlock(self._RUNNING, self._MOST)
        return False

    def _lock(self, place: int) -> None:
        fcntl.lockf(self._file, fcntl.LOCK_EX, 1, place)

    def _unlock(self, place: int, count: int = 1) -> None:
        fcntl.lockf(self._file, fcntl.LOCK_UN, count, place)


class Plugin:
    """A pytest plugin that takes a turn for each file."""

    def __init__(self, turns: Turns) -> None:
        self._turns = turns
        self._runs: Path | None = None

    @pytest.hookimpl(
        wrapper=True, tryfirst=True
    )  # outside of pytest-timeout's wrapper, so that its limit does not include the wait
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, Any, Any]:
        if self._runs != item.path:
            self._turns.take()
            self._runs = item.path
        try:
            return (yield)
        finally:
            if nextitem is None or nextitem.path != item.path:
                self._turns.end()
                self._runs = None

    def pytest_unconfigure(self) -> None:
        self._turns.close()


def pytest_configure(config: pytest.Config) -> None:
    """Take turns if this is one of several processes, which share pytest's cache (not with ``-p no:cacheprovider``)."""
    worker, cache = getattr(config, "workerinput", None), getattr(config, "cache", None)
    if worker is None or worker["workercount"] < 2 or cache is None or fcntl is None or not _LOAD.exists():
        return
    file = (cache.mkdir("turns") / worker["testrunuid"]).open("ab")
    config.pluginmanager.register(Plugin(Turns(file, int(worker["workerid"].removeprefix("gw")))))
