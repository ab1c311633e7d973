"""YARP's network clock: a port that says the time, followed by whoever asks for it (`yarp/os/NetworkClock.h`).

Each message is a Bottle of two integers, seconds and nanoseconds. The connection is a persistent one: the name server
makes it when the clock's port comes, and again when that returns.
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

from yarp_compat.naming.errors import NamingError, PortError
from yarp_compat.os.contact import ContactStyle
from yarp_compat.os.network import Network
from yarp_compat.os.runtime import RUNTIME
from yarp_compat.ports.message import Message
from yarp_compat.ports.port import PortCore
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError

log = logging.getLogger("yarp.os.NetworkClock")

DEFAULT = "/clock"
"""The clock's port where nobody names another."""


def read_time(values: list[object]) -> float | None:
    """The time in a clock's Bottle, in seconds; None where it is none. Nested in one list it is taken too."""
    if len(values) == 1 and isinstance(values[0], list):
        values = values[0]
    if len(values) < 2 or not all(isinstance(value, int | float) for value in values[:2]):
        return None
    seconds, nanoseconds = values[0], values[1]
    assert isinstance(seconds, int | float)
    assert isinstance(nanoseconds, int | float)
    return seconds + nanoseconds * 1e-9


class NetworkClock:
    """Follows a clock's port.

    Args:
        source: the clock's port.
        local: the name of the own port, "" for ``/<host>/<program>/<process>/clock:i``.

    Raises:
        NamingError: the own port cannot be opened.
        PortError: there is no name server that could make the connection.
    """

    def __init__(self, source: str = DEFAULT, local: str = "") -> None:
        self.source = source or DEFAULT
        self._time: float | None = None
        self._condition = threading.Condition()
        self._closed = False
        self._waiters: list[tuple[float, int, threading.Event]] = []
        self._numbers = itertools.count()
        name = local or f"/{socket.gethostname()}/{Path(sys.argv[0]).name or 'python'}/{os.getpid()}/clock:i"
        self._port = PortCore(name, on_message=self._hear, naming=RUNTIME.naming, is_output=False)
        self._port.open()
        style = ContactStyle(persistent=True)
        if not Network.connect(self.source, self._port.name, style):
            self._port.close()
            msg = f"no name server connects the clock {self.source}"
            raise PortError(msg)

    @property
    def is_valid(self) -> bool:
        """Whether the clock has said the time yet."""
        return self._time is not None

    def now(self) -> float:
        """The time in seconds; 0 until the clock has said it."""
        return self._time or 0.0

    def wait(self, seconds: float, stop: threading.Event | None = None) -> bool:
        """Wait in the clock's time; whether ``stop`` was set. A clock that is set back does not prolong it."""
        woken = stop or threading.Event()
        if seconds <= 0 or woken.is_set():
            return woken.is_set()
        passed = threading.Event()
        with self._condition:
            if self._closed:
                return woken.wait(seconds)
            heapq.heappush(self._waiters, (self.now() + seconds, next(self._numbers), passed))
        while not passed.is_set():
            if woken.wait(0.01) if stop is not None else passed.wait(1.0):
                break
        return stop is not None and stop.is_set()

    def close(self) -> None:
        """Follow the clock no more; whoever waits goes on."""
        with self._condition:
            self._closed = True
            waiters, self._waiters = self._waiters, []
        for _, _, passed in waiters:
            passed.set()
        try:
            Network.disconnect(self.source, self._port.name, ContactStyle(persistent=True))
        except NamingError as err:
            log.debug("%s", err)
        self._port.close()

    def _hear(self, message: Message) -> None:
        try:
            found = read_time(binary.decode(bytes(message.payload)))
        except WireError:
            found = None
        if found is None:
            log.error("%s does not say the time: two integers, seconds and nanoseconds", self.source)
            return
        with self._condition:
            before, self._time = self._time or 0.0, found
            if found < before:
                gap = found - before
                self._waiters = [(due + gap, number, passed) for due, number, passed in self._waiters]
                heapq.heapify(self._waiters)
            while self._waiters and self._waiters[0][0] - found < 1e-12:
                heapq.heappop(self._waiters)[2].set()
