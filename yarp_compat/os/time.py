"""``Time`` and ``yarp.delay``/``yarp.now``, on the system's clock.

YARP's network clock (``YARP_CLOCK``, ``Time.useNetworkClock``) is not followed: asking for it raises, since a program
that silently ran on another clock than it asked for would be wrong in every stamp.
"""

from __future__ import annotations

import logging
import os
import threading
import time

log = logging.getLogger("yarp.os.Time")

YARP_CLOCK_UNINITIALIZED = -1
YARP_CLOCK_DEFAULT = 0
YARP_CLOCK_SYSTEM = 1
YARP_CLOCK_NETWORK = 2
YARP_CLOCK_CUSTOM = 3


def now() -> float:
    """The time since 1970, in seconds."""
    return time.time()


def delay(seconds: float) -> None:
    """Wait; a negative or zero time does not."""
    if seconds > 0:
        time.sleep(seconds)


def yield_c() -> None:
    """Let other threads run."""
    time.sleep(0)


def useSystemClock() -> None:
    """Use the system's clock: it is in use already."""


def useNetworkClock(clock: str, localPortName: str = "") -> None:
    """Refuse.

    Raises:
        NotImplementedError: always.
    """
    del localPortName
    msg = f"yarp_compat follows no network clock (asked for {clock!r}): it runs on system time"
    raise NotImplementedError(msg)


def isSystemClock() -> bool:
    """Whether the system's clock is in use: always."""
    return True


def isNetworkClock() -> bool:
    """Whether a network clock is in use: never."""
    return False


def isCustomClock() -> bool:
    """Whether a clock of the program's own is in use: never."""
    return False


def isValid() -> bool:
    """Whether the clock runs: always."""
    return True


def isClockInitialized() -> bool:
    """Whether a clock is in use: always."""
    return True


def getClockType() -> int:
    """Which kind of clock is in use: `YARP_CLOCK_SYSTEM`."""
    return YARP_CLOCK_SYSTEM


def clockTypeToString(kind: int) -> str:
    """A clock kind's name."""
    names = {0: "YARP_CLOCK_DEFAULT", 1: "YARP_CLOCK_SYSTEM", 2: "YARP_CLOCK_NETWORK", 3: "YARP_CLOCK_CUSTOM"}
    return names.get(kind, "YARP_CLOCK_UNINITIALIZED")


def warn_of_network_clock() -> None:
    """Say so, once, when ``YARP_CLOCK`` asks for a clock that is not followed."""
    asked = os.environ.get("YARP_CLOCK")
    if asked and not _warned.is_set():
        _warned.set()
        log.warning("YARP_CLOCK=%s asks for a network clock; yarp_compat runs on system time", asked)


_warned = threading.Event()


class Time:
    """The functions of this module under YARP's class name: ``yarp.Time.now()``."""

    now = staticmethod(now)
    delay = staticmethod(delay)
    yield_c = staticmethod(yield_c)
    useSystemClock = staticmethod(useSystemClock)
    useNetworkClock = staticmethod(useNetworkClock)
    isSystemClock = staticmethod(isSystemClock)
    isNetworkClock = staticmethod(isNetworkClock)
    isCustomClock = staticmethod(isCustomClock)
    isValid = staticmethod(isValid)
    isClockInitialized = staticmethod(isClockInitialized)
    getClockType = staticmethod(getClockType)
    clockTypeToString = staticmethod(clockTypeToString)
