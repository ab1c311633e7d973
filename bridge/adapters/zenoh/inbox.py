"""Messages of one subscription between zenoh's receiving thread, which only appends, and their conversion."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

import zenoh

from bridge.adapters.base import Deliver
from bridge.adapters.zenoh.sink import is_command
from bridge.hub.qos import Qos
from bridge.routing.dispatcher import Dispatcher
from bridge.routing.priority import Priority
from bridge.routing.route import BULK, QUEUE_BYTES


@dataclass(frozen=True, slots=True)
class Lanes:
    """The threads that convert what came in: one for small messages, urgent ones first, and one for large ones."""

    small: Dispatcher
    bulk: Dispatcher

    def start(self) -> None:
        """Start the threads."""
        self.small.start()
        self.bulk.start()

    def stop(self) -> None:
        """End them."""
        self.small.stop()
        self.bulk.stop()


class Inbox:
    """A bounded queue that drops its oldest; of commands (depth 1, volatile) only the newest counts.

    Attributes:
        lost: messages dropped.
    """

    def __init__(self, deliver: Deliver, qos: Qos, lanes: Lanes) -> None:
        self.lost = 0
        self._deliver, self._lanes = deliver, lanes
        self._depth = max(qos.depth, 1)
        self._priority = Priority.COMMAND if is_command(qos) else Priority.STATE if qos.latched else Priority.STREAM
        self._lock = threading.Lock()
        self._queue: deque[tuple[zenoh.ZBytes, str, int | None]] = deque()
        self._bytes = 0
        self._lane = lanes.small
        self._closed = False

    def add(self, payload: zenoh.ZBytes, source: str, time_ns: int | None) -> None:
        """Append a message and wake a thread."""
        size = len(payload)
        with self._lock:
            if self._closed:
                return
            self._queue.append((payload, source, time_ns))
            self._bytes += size
            while len(self._queue) > self._depth or (self._bytes > QUEUE_BYTES and len(self._queue) > 1):
                self._bytes -= len(self._queue.popleft()[0])
                self.lost += 1
            if size > BULK and len(self._queue) == 1:
                self._lane = self._lanes.bulk
            lane = self._lane
        lane.submit(self._priority, self._next)

    def _next(self) -> None:
        with self._lock:
            if not self._queue or self._closed:
                return
            payload, source, time_ns = self._queue.popleft()
            self._bytes -= len(payload)
        self._deliver(payload.to_bytes(), source, time_ns)

    def close(self) -> None:
        """Deliver nothing more."""
        with self._lock:
            self._closed = True
            self._queue.clear()
