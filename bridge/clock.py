"""One time scale for all stamps of a process: the system's clock, or ``/clock`` of a simulation."""

from __future__ import annotations

import logging
import struct
import threading
import time
from collections.abc import Callable

_log = logging.getLogger(__name__)
_TIME = struct.Struct("<iI")
_HEADER = 4

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
CLOCK_TOPIC = "/clock"
DONE_TOPIC = "/sim/acknowledge"
"""Where whoever runs on a simulation's clock says that it is done with a time, so that the next step may come."""

DONE_TYPE = "std_msgs/msg/Header"

Jumped = Callable[[], None]
"""Hears that time was set back: what depends on it is to be forgotten."""


class RunClock:
    """Says the time: the system's, or where ``simulated`` what `hear` took last. Safe to use from any thread."""

    def __init__(self, *, simulated: bool = False) -> None:
        self.simulated = simulated
        self._now = 0
        self._lock = threading.Lock()
        self._jumped: list[Jumped] = []
        self._heard: list[Callable[[int], None]] = []
        self._after: list[Callable[[int], None]] = []

    def now_ns(self) -> int:
        """Nanoseconds since 1970, or of the simulation; 0 until that has said the time."""
        return self._now if self.simulated else time.time_ns()

    def stamp(self) -> dict[str, int]:
        """The time as ``builtin_interfaces/msg/Time``."""
        seconds, nanoseconds = divmod(self.now_ns(), 1_000_000_000)
        return {"sec": seconds, "nanosec": nanoseconds}

    def hear(self, cdr: bytes) -> None:
        """Take up a message of ``/clock``, CDR with its encapsulation header."""
        if not self.simulated or len(cdr) < _HEADER + _TIME.size:
            return
        seconds, nanoseconds = _TIME.unpack_from(cdr, _HEADER)
        found = seconds * 1_000_000_000 + nanoseconds
        with self._lock:
            back, self._now = found < self._now, found
            jumped = tuple(self._jumped) if back else ()
            heard = (*self._heard, *self._after)
        if back:
            _log.warning("%s was set back to %.3f s", CLOCK_TOPIC, found / 1e9)
        for forget in jumped:
            forget()
        for tell in heard:
            tell(found)

    def on_jump(self, jumped: Jumped) -> Callable[[], None]:
        """Tell when the time was set back, until the returned function is called; on the thread that hears the time."""
        self._jumped.append(jumped)
        return lambda: _discard(self._jumped, jumped)

    def on_time(self, heard: Callable[[int], None], *, last: bool = False) -> Callable[[], None]:
        """Report each time of a simulation in ns until the returned function is called; ``last``: after all others."""
        among = self._after if last else self._heard
        among.append(heard)
        return lambda: _discard(among, heard)


SYSTEM = RunClock()
"""The system's clock."""


def _discard(among: list[Callable[..., None]], what: Callable[..., None]) -> None:
    if what in among:
        among.remove(what)
