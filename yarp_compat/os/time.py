"""``Time`` and ``yarp.delay``/``yarp.now``, on the system's clock or a network clock (``YARP_CLOCK``)."""

from __future__ import annotations

import logging
import os
import threading
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from yarp_compat.os.clock import NetworkClock

log = logging.getLogger("yarp.os.Time")

YARP_CLOCK_UNINITIALIZED = -1
YARP_CLOCK_DEFAULT = 0
YARP_CLOCK_SYSTEM = 1
YARP_CLOCK_NETWORK = 2
YARP_CLOCK_CUSTOM = 3

VARIABLE = "YARP_CLOCK"
"""The environment variable that names the clock's port."""


class _InUse:
    """Which clock is in use: a network clock, or None for the system's."""

    clock: NetworkClock | None = None
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


def wait(stop: threading.Event, seconds: float) -> bool:
    """Wait in the time of the clock in use, or until ``stop`` is set; whether it is."""
    clock = _InUse.clock
    return stop.wait(max(seconds, 0.0)) if clock is None else clock.wait(seconds, stop)


def steady() -> float:
    """Seconds for durations: of a clock that nobody sets, or of the network clock."""
    clock = _InUse.clock
    return time.monotonic() if clock is None else clock.now()


def yield_c() -> None:
    """Let other threads run."""
    time.sleep(0)


def useSystemClock() -> None:
    """Use the system's clock."""
    _use(None)


def useNetworkClock(clock: str, localPortName: str = "") -> None:
    """Use a network clock, now and whenever its port returns.

    Args:
        clock: its port; "" for ``/clock``.
        localPortName: name of the port that hears it.

    Raises:
        NamingError: no name server answers, or it refuses the port.
        PortError: the connection cannot be asked for.
    """
    from yarp_compat.os.clock import NetworkClock

    _use(NetworkClock(clock, localPortName))


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


def use_the_asked_clock() -> None:
    """Use the clock that ``YARP_CLOCK`` names, as the network begins; the system's where it names none.

    Raises:
        NamingError: as `useNetworkClock`.
        PortError: as `useNetworkClock`.
    """
    asked = os.environ.get(VARIABLE)
    if asked:
        useNetworkClock(asked)
        log.info("the time is that of %s", asked)


def _use(clock: NetworkClock | None) -> None:
    with _InUse.lock:
        before, _InUse.clock = _InUse.clock, clock
    if before is not None:
        before.close()


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
