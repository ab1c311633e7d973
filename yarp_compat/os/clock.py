"""YARP's network clock: follows a port that publishes the time (`yarp/os/NetworkClock.h`).

Each message is a Bottle of two integers, seconds and nanoseconds. The connection is persistent: the name server makes
it as soon as the clock's port is registered, and again whenever that port returns.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import os
import socket
import sys
import threading
from pathlib import Path

from yarp_compat.interruptible import interruptible
from yarp_compat.os import time
from yarp_compat.os.runtime import RUNTIME
from yarp_compat.ports.message import PortMessage
from yarp_compat.ports.naming import NamingError, PortError
from yarp_compat.ports.port import PortCore
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError

log = logging.getLogger("yarp.os.NetworkClock")

DEFAULT = "/clock"  # the clock's port by default
VARIABLE = "YARP_CLOCK"  # the environment variable that names the clock's port


def read_time(values: list[object]) -> float | None:
    """Return the time in a clock's Bottle, in seconds; None if invalid. The numbers may be nested in a list."""
    if len(values) == 1 and isinstance(values[0], list):
        values = values[0]
    match values:
        case [int() | float() as seconds, int() | float() as nanoseconds, *_]:
            return seconds + nanoseconds * 1e-9
    return None


class NetworkClock:
    """A clock that follows a port; ``local`` names the input, "" for ``/<host>/<program>/<process>/clock:i``.

    Raises `NamingError` if the input cannot be opened, `PortError` if no name server makes the connection.
    """

    def __init__(self, source: str = DEFAULT, local: str = "") -> None:
        self.source = source or DEFAULT
        self._time: float | None = None
        self._condition = threading.Condition()
        self._closed = False
        self._waiters: list[tuple[float, int, threading.Event]] = []
        self._numbers = itertools.count()
        name = local or f"/{socket.gethostname()}/{Path(sys.argv[0]).name or 'python'}/{os.getpid()}/clock:i"
        self._port = PortCore(name, on_message=self._on_message, naming=RUNTIME.naming, is_output=False)
        self._port.open()
        if not self._persistent("subscribe"):
            self._port.close()
            raise PortError(f"the name server did not connect the clock {self.source}")

    @property
    def is_valid(self) -> bool:
        """Whether a time has been received."""
        return self._time is not None

    def now(self) -> float:
        """Return the time in seconds; 0 until one is received."""
        return self._time or 0.0

    def wait(self, seconds: float, stop: threading.Event | None = None, since: float | None = None) -> bool:
        """Wait in the clock's time; return whether ``stop`` was set. Setting the clock back does not prolong the wait.

        The wait starts at ``since``, by default now: the clock may have advanced since the caller read it.
        """
        stopped = stop or threading.Event()
        passed = threading.Event()
        with self._condition:
            now = self.now()
            due = seconds + (now if since is None else min(since, now))
            if due <= now or stopped.is_set():
                return stopped.is_set()
            if self._closed:
                return interruptible(stopped.wait, seconds)
            heapq.heappush(self._waiters, (due, next(self._numbers), passed))
        while not passed.is_set():
            if stopped.wait(0.01) if stop is not None else passed.wait(1.0):
                break
        return stop is not None and stop.is_set()

    def close(self) -> None:
        """Stop following the clock, and release waiting threads."""
        with self._condition:
            self._closed = True
            waiters, self._waiters = self._waiters, []
        for _, _, passed in waiters:
            passed.set()
        self._persistent("unsubscribe")
        self._port.close()

    def _persistent(self, verb: str) -> bool:
        try:
            return RUNTIME.persistent(verb, self.source, self._port.name)
        except (NamingError, OSError, ValueError) as err:
            log.error("cannot %s %s to %s: %s", verb, self.source, self._port.name, err)
            return False

    def _on_message(self, message: PortMessage) -> None:
        try:
            time = read_time(binary.decode(bytes(message.payload)))
        except WireError:
            time = None
        if time is None:
            log.error("invalid time from %s: expected two integers, seconds and nanoseconds", self.source)
            return
        with self._condition:
            before, self._time = self._time or 0.0, time
            if time < before:
                gap = time - before
                self._waiters = [(due + gap, number, passed) for due, number, passed in self._waiters]
                heapq.heapify(self._waiters)
            while self._waiters and self._waiters[0][0] - time < 1e-12:
                heapq.heappop(self._waiters)[2].set()


def useNetworkClock(clock: str, localPortName: str = "") -> None:
    """Use a network clock ("" for ``/clock``), now and whenever its port returns; raises like `NetworkClock`."""
    time.use(NetworkClock(clock, localPortName))


def use_environment_clock() -> None:
    """Use the clock that ``YARP_CLOCK`` names, if any, when the network starts; raises like `useNetworkClock`."""
    clock = os.environ.get(VARIABLE)
    if clock:
        useNetworkClock(clock)
        logging.getLogger("yarp.os.Time").info("using the network clock %s", clock)


class Time:
    """The time functions under YARP's class name: ``yarp.Time.now()``."""

    now = staticmethod(time.now)
    delay = staticmethod(time.delay)
    yield_c = staticmethod(time.yield_c)
    useSystemClock = staticmethod(time.useSystemClock)
    useNetworkClock = staticmethod(useNetworkClock)
    isSystemClock = staticmethod(time.isSystemClock)
    isNetworkClock = staticmethod(time.isNetworkClock)
    isCustomClock = staticmethod(time.isCustomClock)
    isValid = staticmethod(time.isValid)
    isClockInitialized = staticmethod(time.isClockInitialized)
    getClockType = staticmethod(time.getClockType)
    clockTypeToString = staticmethod(time.clockTypeToString)
