"""The share of the machine's processors that other programs leave to a test."""

from __future__ import annotations

import contextlib
import threading
import time
from types import TracebackType
from typing import Self

import psutil

CPUS = psutil.cpu_count() or 1

_LEAST = 0.25
"""A smaller share counts as this one, so that a limit divided by it does not become too long to detect anything."""


class ProcessorShare:
    """Measures from its creation on.

    It counts the processor time of everything except this process and its descendants, including a hypervisor's.
    """

    def __init__(self) -> None:
        self._begun, self._others = time.monotonic(), _others()

    def least(self) -> float:
        """Return the share of the processors' time (`_LEAST` to 1) that other programs left to the test."""
        return _left(time.monotonic() - self._begun, _others() - self._others)


class ProcessorShares:
    """Measures like `ProcessorShare`, but knows the share of each part of the time. Its thread runs in the context."""

    _EVERY = 0.5
    """Seconds between two samples, each of which takes some 20 ms."""

    def __init__(self) -> None:
        self._samples: list[tuple[float, float]] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="processor-shares")

    def during(self, begin: float, end: float) -> float:
        """Return the share from the last sample before a time (monotonic) to the first one after another time."""
        self._sample()
        samples = sorted(self._samples)
        first = max((sample for sample in samples if sample[0] <= begin), default=samples[0])
        last = next((sample for sample in samples if sample[0] >= end), samples[-1])
        return _left(last[0] - first[0], last[1] - first[1])

    def _run(self) -> None:
        while not self._ending.wait(self._EVERY):
            self._sample()

    def _sample(self) -> None:
        self._samples.append((time.monotonic(), _others()))

    def __enter__(self) -> Self:
        self._sample()
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, err: BaseException | None, tb: TracebackType | None) -> None:
        self._ending.set()
        self._thread.join()


def _left(elapsed: float, others: float) -> float:
    """Return the share (`_LEAST` to 1) that is left if others used ``others`` s of processor time in ``elapsed`` s."""
    return max(_LEAST, 1.0 - max(0.0, others) / (CPUS * elapsed))


def _others() -> float:
    """Return the processor time (s) so far of all processes that are not this process or a descendant."""
    times = psutil.cpu_times()
    used = sum(times) - times.idle - getattr(times, "iowait", 0.0) - getattr(times, "guest", 0.0)
    this = psutil.Process()
    own = 0.0
    for process in (this, *this.children(recursive=True)):
        with contextlib.suppress(psutil.NoSuchProcess):
            own += sum(process.cpu_times()[:4])  # with the children that it has waited for
    return used - own
