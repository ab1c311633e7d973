"""The time and waiting: ``yarp.now`` and ``yarp.delay``, on the system's clock or the clock in use."""

from __future__ import annotations

import threading
import time
from typing import Protocol

YARP_CLOCK_UNINITIALIZED = -1
YARP_CLOCK_DEFAULT = 0
YARP_CLOCK_SYSTEM = 1
YARP_CLOCK_NETWORK = 2
YARP_CLOCK_CUSTOM = 3


class Clock(Protocol):
    """A clock other than the system's."""

    @property
    def is_valid(self) -> bool:
        """Whether it has said the time yet."""

    def now(self) -> float:
        """The time in seconds."""

    def wait(self, seconds: float, stop: threading.Event | None = None, since: float | None = None) -> bool:
        """Wait in the clock's time, from ``since`` (now) on; whether ``stop`` was set."""

    def close(self) -> None:
        """Release waiting threads."""


class _InUse:
    """Which clock is in use: a network clock, or None for the system's."""

    clock: Clock | None = None
    lock = threading.Lock()


def now() -> float:
    """The time in seconds: since 1970, or of the network clock, which is 0 until it has said it."""
    clock = _InUse.clock
    return time.time() if clock is None else clock.now()


def delay(seconds: float) -> None:
    """Wait, in the time of the clock in use; a negative or zero time does not."""
    clock = _InUse.clock
    if clock is not None:
        clock.wait(seconds)
    elif seconds > 0:
        time.sleep(seconds)


def wait(stop: threading.Event, seconds: float, since: float) -> bool:
    """Wait until ``seconds`` after ``since`` of `steady`, or until ``stop`` is set; whether it is."""
    clock = _InUse.clock
    return stop.wait(max(since + seconds - steady(), 0.0)) if clock is None else clock.wait(seconds, stop, since)


def steady() -> float:
    """Seconds for durations: of a clock that nobody sets, or of the network clock."""
    clock = _InUse.clock
    return time.monotonic() if clock is None else clock.now()


def yield_c() -> None:
    """Let other threads run."""
    time.sleep(0)


def useSystemClock() -> None:
    """Use the system's clock."""
    use(None)


def isSystemClock() -> bool:
    """Whether the system's clock is in use."""
    return _InUse.clock is None


def isNetworkClock() -> bool:
    """Whether a network clock is in use."""
    return _InUse.clock is not None


def isCustomClock() -> bool:
    """Whether a clock of the program's own is in use: never."""
    return False


def isValid() -> bool:
    """Whether the clock runs: a network clock has said the time."""
    clock = _InUse.clock
    return clock is None or clock.is_valid


def isClockInitialized() -> bool:
    """Whether a clock is in use: always."""
    return True


def getClockType() -> int:
    """Which kind of clock is in use: `YARP_CLOCK_SYSTEM` or `YARP_CLOCK_NETWORK`."""
    return YARP_CLOCK_SYSTEM if _InUse.clock is None else YARP_CLOCK_NETWORK


def clockTypeToString(kind: int) -> str:
    """A clock kind's name."""
    names = {0: "YARP_CLOCK_DEFAULT", 1: "YARP_CLOCK_SYSTEM", 2: "YARP_CLOCK_NETWORK", 3: "YARP_CLOCK_CUSTOM"}
    return names.get(kind, "YARP_CLOCK_UNINITIALIZED")


def use(clock: Clock | None) -> None:
    """Use a clock, or the system's; the one in use until now is closed."""
    with _InUse.lock:
        before, _InUse.clock = _InUse.clock, clock
    if before is not None:
        before.close()
