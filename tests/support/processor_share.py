"""The share of the machine's processors that other programs leave to a test."""

from __future__ import annotations

import contextlib
import time

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
        elapsed = time.monotonic() - self._begun
        return max(_LEAST, 1.0 - max(0.0, _others() - self._others) / (CPUS * elapsed))


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
