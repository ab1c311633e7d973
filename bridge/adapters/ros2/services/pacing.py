"""Limits on the requests and replies that are in flight to one native program.

A native program queues the last 10 requests, and the last 10 replies, that it has not taken yet (rmw's default for
services), and silently drops older ones: of 1,000 concurrent calls between two rclpy programs, 52 got replies
(measured). DDS does not report which messages were taken. So Midspan counts the messages that may still be queued, and
holds back the rest.
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
"""Messages in flight at most, out of the 10: this leaves room for other clients and servers."""

PATIENCE = 0.5
"""Seconds after which a request counts as taken by a server that does not reply, because its execution may take hours.
A sequential server that needs longer for each request may lose some of more than `ROOM` concurrent requests."""


class SentRequests:
    """Requests to a server that it may not have taken yet, by rising numbers. Not thread-safe."""

    def __init__(self) -> None:
        self._sent: deque[tuple[int, float]] = deque()
        self._answered_at = time.monotonic()

    def on_sent(self, number: int) -> None:
        """Record a request that was sent."""
        self._sent.append((number, time.monotonic()))

    def on_reply(self, number: int) -> None:
        """Record a reply: a server takes requests in order, so all earlier ones have been taken, too."""
        while self._sent and self._sent[0][0] <= number:
            self._sent.popleft()
            self._answered_at = time.monotonic()

    def wait(self) -> float:
        """Return the seconds until the next request may be sent, 0 if now; a reply may shorten the wait."""
        if len(self._sent) < ROOM:
            return 0.0
        left = max(self._sent[0][1], self._answered_at) + PATIENCE - time.monotonic()
        if left > 0:
            return left
        self._sent.clear()
        return 0.0


_REPLY_SECONDS = 0.001
"""Time for a client to take one of many replies; rclpy's clients need some 0.15 ms."""

_TRY_SECONDS, _SLOWEST_SECONDS = 0.1, 1.0
_PATIENCE = 20.0
"""Seconds until a reply to an undiscovered client is dropped. On a busy machine, discovery may have to wait for the
client's heartbeats, every 3 s. rmw itself gives up after 0.1 s."""

_log = logging.getLogger(__name__)


class ClientReplies:
    """The replies to one client; ``write`` returns False if the client is unreachable, ``later`` sends queued ones."""

    def __init__(self, write: Callable[[RequestId, bytes], bool], later: DelayedCalls) -> None:
        self._write, self._later = write, later
        self._lock = threading.Lock()
        self._outbox: deque[tuple[RequestId, bytes]] = deque()
        self._pending_calls = 0
        self._credit = float(ROOM)
        self._last = time.monotonic()
        self._missed_since: float | None = None
        self._reached = self._sending = False

    @property
    def busy(self) -> bool:
        """Whether calls of the client are pending."""
        return bool(self._pending_calls or self._outbox)

    def on_request(self, backlog: int) -> None:
        """Record a request; ``backlog`` requests are still to be taken."""
        with self._lock:
            self._pending_calls += 1
            if max(backlog, self._pending_calls + len(self._outbox)) <= ROOM:
                self._credit = float(ROOM)

    def on_no_reply(self) -> None:
        """Record that a request gets no reply."""
        with self._lock:
            self._pending_calls -= 1

    def send(self, request: RequestId, payload: bytes) -> None:
        """Send a reply, now or soon: the first may have to wait for its client, on another thread."""
        with self._lock:
            self._pending_calls -= 1
            self._outbox.append((request, payload))
            if self._sending:
                return
            self._sending = True
            if not self._reached:
                self._later.after(0.0, self._send_outbox)
                return
        self._send_outbox()

    def _send_outbox(self) -> None:
        """Send waiting replies as far as allowed; one thread at a time."""
        while True:
            with self._lock:
                if not self._outbox:
                    self._sending = False
                    return
                wait = self._wait()
                if wait:
                    self._later.after(wait, self._send_outbox)
                    return
                request, payload = self._outbox.popleft()
            if self._write(request, payload):
                self._reached, self._missed_since = True, None
            elif self._retry_later(request, payload):
                return

    def _wait(self) -> float:
        """Return the seconds until the next reply may be sent; if that is 0, count it as sent."""
        now = time.monotonic()
        self._credit = min(float(ROOM), self._credit + (now - self._last) / _REPLY_SECONDS)
        self._last = now
        if self._credit < 1:
            return (1 - self._credit) * _REPLY_SECONDS
        self._credit -= 1
        return 0.0

    def _retry_later(self, request: RequestId, payload: bytes) -> bool:
        """Retry later for an unreachable client; return False if its time is over."""
        now = time.monotonic()
        with self._lock:
            if self._missed_since is None:
                self._missed_since = now
            missed = now - self._missed_since
            if missed < _PATIENCE:
                self._outbox.appendleft((request, payload))
                self._later.after(min(max(missed / 4, _TRY_SECONDS), _SLOWEST_SECONDS), self._send_outbox)
                return True
        _log.warning("a reply is dropped: its ROS 2 client is unreachable")
        return False

    def flush(self) -> None:
        """Send all waiting replies at once."""
        with self._lock:
            replies, self._outbox = list(self._outbox), deque()
        for request, payload in replies:
            if not self._write(request, payload):
                self._later.after(_TRY_SECONDS, partial(self._write, request, payload))
