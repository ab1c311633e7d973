"""How many requests a server may have before it.

A native program keeps the last 10 requests, and the last 10 replies, that it has not taken yet (rmw's default for
services), and forgets older ones without a word: of 1,000 calls at once of one rclpy program to another, 52 were
answered (measured). DDS does not tell what was taken. So what may be lying there is counted, here and in
`bridge.adapters.ros2.services.pacing`, and what is more waits on our side.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial

from bridge.adapters.ros2.rcl import RequestId
from bridge.concurrency import DelayedCalls

ROOM = 8
"""Of the 10, so that others find room beside us."""

PATIENCE = 0.5
"""Seconds after which a request counts as taken by a server that says nothing: it may work on all of them for hours.
A server that does one after the other, and each takes longer than this, may lose some of more than `ROOM` at once."""


class SentRequests:
    """What was sent to a server and may not be taken yet, by the requests' rising numbers. A lock is the caller's."""

    def __init__(self) -> None:
        self._sent: deque[tuple[int, float]] = deque()
        self._answered = time.monotonic()

    def sent(self, number: int) -> None:
        """A request has gone out."""
        self._sent.append((number, time.monotonic()))

    def answered(self, number: int) -> None:
        """A reply has come: a server takes requests in their order, so all before have been taken too."""
        while self._sent and self._sent[0][0] <= number:
            self._sent.popleft()
            self._answered = time.monotonic()

    def wait(self) -> float:
        """Seconds until the next may be sent, 0 for now; earlier when a reply comes."""
        if len(self._sent) < ROOM:
            return 0.0
        left = max(self._sent[0][1], self._answered) + PATIENCE - time.monotonic()
        if left > 0:
            return left
        self._sent.clear()
        return 0.0


_REPLY_SECONDS = 0.001
"""Time that a client is given to take a reply, where it asked for many; rclpy's take some 0.15 ms."""

_TRY_SECONDS, _SELDOM = 0.1, 1.0
_PATIENCE = 20.0
"""Seconds for which a client that asked is looked for: on a busy machine what DDS tells of it may come after its
heartbeats alone, each 3 s. rmw itself waits 0.1 s for it, and then gives up."""

_log = logging.getLogger(__name__)


class ClientReplies:
    """The replies to one client; ``write`` is False while it cannot be reached, ``later`` sends those that wait."""

    def __init__(self, write: Callable[[RequestId, bytes], bool], later: DelayedCalls) -> None:
        self._write, self._later = write, later
        self._lock = threading.Lock()
        self._outbox: deque[tuple[RequestId, bytes]] = deque()
        self._asked = 0
        self._credit = float(ROOM)
        self._last = time.monotonic()
        self._missed: float | None = None
        self._reached = self._sending = False

    @property
    def busy(self) -> bool:
        """Whether calls of the client are under way."""
        return bool(self._asked or self._outbox)

    def asked(self, backlog: int) -> None:
        """A request came, with so many that wait to be taken."""
        with self._lock:
            self._asked += 1
            if max(backlog, self._asked + len(self._outbox)) <= ROOM:
                self._credit = float(ROOM)

    def unanswered(self) -> None:
        """A request has no reply."""
        with self._lock:
            self._asked -= 1

    def send(self, request: RequestId, payload: bytes) -> None:
        """Send a reply, now or soon: the first may have to wait for its client, and not on the caller's thread."""
        with self._lock:
            self._asked -= 1
            self._outbox.append((request, payload))
            if self._sending:
                return
            self._sending = True
            if not self._reached:
                self._later.after(0.0, self._go_on)
                return
        self._go_on()

    def _go_on(self) -> None:
        """Send what may be sent; one thread at a time."""
        while True:
            with self._lock:
                if not self._outbox:
                    self._sending = False
                    return
                wait = self._wait()
                if wait:
                    self._later.after(wait, self._go_on)
                    return
                request, payload = self._outbox.popleft()
            if self._write(request, payload):
                self._reached, self._missed = True, None
            elif self._waits(request, payload):
                return

    def _wait(self) -> float:
        """Seconds until the next may be sent, 0 for now, and then it counts as sent."""
        now = time.monotonic()
        self._credit = min(float(ROOM), self._credit + (now - self._last) / _REPLY_SECONDS)
        self._last = now
        if self._credit < 1:
            return (1 - self._credit) * _REPLY_SECONDS
        self._credit -= 1
        return 0.0

    def _waits(self, request: RequestId, payload: bytes) -> bool:
        """Give a client that cannot be reached some time; False when it had enough."""
        now = time.monotonic()
        with self._lock:
            if self._missed is None:
                self._missed = now
            missed = now - self._missed
            if missed < _PATIENCE:
                self._outbox.appendleft((request, payload))
                self._later.after(min(max(missed / 4, _TRY_SECONDS), _SELDOM), self._go_on)
                return True
        _log.warning("a ROS 2 client could not be reached with its reply")
        return False

    def flush(self) -> None:
        """Send at once what is there."""
        with self._lock:
            rest, self._outbox = list(self._outbox), deque()
        for request, payload in rest:
            if not self._write(request, payload):
                self._later.after(_TRY_SECONDS, partial(self._write, request, payload))
