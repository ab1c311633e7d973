"""Time and delays: ``yarp.now`` and ``yarp.delay``, by the system's clock or a network clock."""

from __future__ import annotations

import threading
import time
from typing import Protocol

from yarp_compat.interruptible import interruptible

YARP_CLOCK_UNINITIALIZED = -1
YARP_CLOCK_DEFAULT = 0
YARP_CLOCK_SYSTEM = 1
YARP_CLOCK_NETWORK = 2
YARP_CLOCK_CUSTOM = 3


class Clock(Protocol):
    """A clock other than the system clock."""

    @property
    def is_valid(self) -> bool:
        """Whether the clock has a time."""

    def now(self) -> float:
        """Return the time in seconds."""

    def wait(self, seconds: float, stop: threading.Event | None = None, since: float | None = None) -> bool:
        """Wait in the clock's time, from ``since`` (by default now) on; return whether ``stop`` was set."""

    def close(self) -> None:
        """Release waiting threads."""


class _InUse:
    """The clock in use: a network clock, or None for the system clock."""

    clock: Clock | None = None
    lock = threading.Lock()


def now() -> float:
    """Return the time in seconds: since 1970, or of the network clock, which is 0 until a time is received."""
    clock = _InUse.clock
    return time.time() if clock is None else clock.now()


def delay(seconds: float) -> None:
    """Wait for seconds of the clock in use; return at once if not positive."""
    clock = _InUse.clock
    if clock is not None:
        clock.wait(seconds)
    elif seconds > 0:
        time.sleep(seconds)


def wait(stop: threading.Event, seconds: float, since: float) -> bool:
    """Wait until ``seconds`` after ``since`` (of `steady`), or until ``stop`` is set; return whether it is set."""
    clock = _InUse.clock
    if clock is None:
        return interruptible(stop.wait, max(since + seconds - steady(), 0.0))
    return clock.wait(seconds, stop, since)


def steady() -> float:
    """Return the time in seconds for durations: of the monotonic clock, or of the network clock."""
    clock = _InUse.clock
    return time.monotonic() if clock is None else clock.now()


def yield_c() -> None:
    """Let other threads run."""
    time.sleep(0)


def useSystemClock() -> None:
    """Use the system's clock."""
    use(None)


def isSystemClock() -> bool:
    """Return whether the system's clock is in use."""
    return _InUse.clock is None


def isNetworkClock() -> bool:
    """Return whether a network clock is in use."""
    return _InUse.clock is not None


def isCustomClock() -> bool:
    """Return False: custom clocks are not supported."""
    return False


def isValid() -> bool:
    """Return whether the clock has a time, which a network clock has to receive first."""
    clock = _InUse.clock
    return clock is None or clock.is_valid


def isClockInitialized() -> bool:
    """Return True: a clock is always in use."""
    return True


def getClockType() -> int:
    """Return the kind of the clock in use: `YARP_CLOCK_SYSTEM` or `YARP_CLOCK_NETWORK`."""
    return YARP_CLOCK_SYSTEM if _InUse.clock is None else YARP_CLOCK_NETWORK


def clockTypeToString(kind: int) -> str:
    """Return the name of a kind of clock."""
    names = {0: "YARP_CLOCK_DEFAULT", 1: "YARP_CLOCK_SYSTEM", 2: "YARP_CLOCK_NETWORK", 3: "YARP_CLOCK_CUSTOM"}
    return names.get(kind, "YARP_CLOCK_UNINITIALIZED")


def use(clock: Clock | None) -> None:
    """Use a clock, or the system's for None; close the previous one."""
    with _InUse.lock:
        before, _InUse.clock = _InUse.clock, clock
    if before is not None:
        before.close()
