"""The queues of routes to a side, and the threads that empty them, most urgent class first.

The receiving thread (of zenoh or the lane) publishes small messages itself, because no edge waits for a peer, and the
hand-over to a sleeping thread would cost 40 us of a total latency of 230 us (benchmarks/topic_latency.py). It queues
messages that are large, because publishing an image may take milliseconds, or that arrive while their route is
publishing, and wakes a dispatcher.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Collection
from queue import SimpleQueue
from typing import Any

from bridge.hub.endpoints.subscription import HubSample
from bridge.progress import StepWatch
from bridge.routing.limits import BULK, QUEUE_BYTES, Priority

_log = logging.getLogger(__name__)
_ORDER = (Priority.COMMAND, Priority.STATE, Priority.STREAM)
_STUCK_SECONDS = 4.0
"""Seconds without progress after which a call counts as hanging."""


class Dispatcher:
    """A thread with a queue of calls for each priority class; each call handles one message of a route."""

    def __init__(self, name: str) -> None:
        self._classes: dict[Priority, deque[Callable[[], None]]] = {p: deque() for p in _ORDER}
        self._wake: SimpleQueue[bool] = SimpleQueue()
        self._busy: dict[int, float] = {}
        self._step = StepWatch(_STUCK_SECONDS)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def submit(self, priority: Priority, work: Callable[[], None]) -> None:
        """Queue a call in its class. The length of these queues is limited by the queues of the routes."""
        self._classes[priority].append(work)
        self._wake.put(True)

    def run_here(self, work: Callable[..., None], *args: Any) -> None:
        """Call ``work(*args)`` at once, on the calling thread; log its exceptions."""
        me = threading.get_ident()
        self._busy[me] = time.monotonic()
        try:
            work(*args)
        except Exception:
            _log.exception("a route failed on one message")
        finally:
            del self._busy[me]

    def alive(self, name: str) -> str:
        """Return a text if a call on the dispatcher's thread has been computing for long, else "". Not thread-safe.

        Raises `TimeoutError` if a call hangs, or takes too long on another thread.
        """
        now, busy = time.monotonic(), self._busy.copy()
        own_since = busy.pop(self._thread.ident or 0, None)
        stuck = max((now - since for since in busy.values()), default=0.0)
        if stuck > _STUCK_SECONDS:
            raise TimeoutError(f"{name} has been stuck for {stuck:.1f} s")
        return self._step.judge(name, own_since)

    def stop(self) -> None:
        """End the thread after the calls that are already queued; wait up to two seconds for it."""
        self._wake.put(False)
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(2.0)

    def _run(self) -> None:
        self._step.begin()
        queues = [self._classes[p] for p in _ORDER]
        while self._wake.get():
            for queue in queues:
                if queue:
                    work = queue.popleft()
                    break
            else:
                continue
            self.run_here(work)


class RouteQueue:
    """The queue of one route to the side; messages are published in order and one at a time.

    `receive` publishes a small message at once, unless an earlier message is queued or being published. Other messages
    are queued for the dispatcher ``small`` until a large message finds the queue empty; this message and all later ones
    are queued for ``bulk``. A full queue drops its oldest messages.

    Locks: this queue and the route hold ``publishing`` while they publish a message. ``_lock`` guards the queue and the
    state that ``admits`` uses. A thread that holds ``_lock`` never waits for ``publishing``, so a thread that holds
    ``publishing`` may wait for ``_lock``.

    Attributes:
        priority, depth: class and maximum number of queued messages; the engine's loop sets them.
        line: the queued messages; never another object.
    """

    def __init__(
        self, small: Dispatcher, bulk: Dispatcher, publish: Callable[[HubSample], None], dropped: Callable[[], None],
        admits: Callable[[HubSample], bool] | None = None,
    ) -> None:  # fmt: skip
        self.priority, self.depth = Priority.STREAM, 1
        self.publishing = threading.Lock()
        self._dispatcher, self._bulk = small, bulk
        self._publish, self._dropped, self._admits = publish, dropped, admits
        self._lock = threading.Lock()
        self.line: deque[HubSample] = deque()
        self._bytes = 0

    @property
    def locked(self) -> tuple[Callable[[], bool], ...]:
        """Calls that return whether a thread queues or publishes a message now."""
        return self._lock.locked, self.publishing.locked

    def receive(self, sample: HubSample) -> None:
        """Publish or queue a message; runs on a receiving thread."""
        size = len(sample.payload)
        if self.line:
            sample.data()  # a message that has to wait must not occupy the sender's memory
        with self._lock:
            if self._admits is not None and not self._admits(sample):
                return
            at_once = size <= BULK and not self.line and self.publishing.acquire(blocking=False)
            if not at_once:
                self._append(sample, size)
            dispatcher = self._dispatcher
        if not at_once:
            dispatcher.submit(self.priority, self._next)
            return
        try:
            dispatcher.run_here(self._publish, sample)
        finally:
            self.publishing.release()

    def _append(self, sample: HubSample, size: int) -> None:
        self.line.append(sample)
        self._bytes += size
        while len(self.line) > self.depth or (self._bytes > QUEUE_BYTES and len(self.line) > 1):
            self._bytes -= len(self.line.popleft().payload)
            self._dropped()
        if size > BULK and len(self.line) == 1:
            self._dispatcher = self._bulk

    def _next(self) -> None:
        with self.publishing:
            with self._lock:
                if not self.line:
                    return
                sample = self.line.popleft()
                self._bytes -= len(sample.payload)
            self._publish(sample)

    def remove(self, sources: Collection[bytes]) -> None:
        """Remove the queued messages of publishers, given by GID, without counting them as dropped."""
        with self._lock:
            for sample in [sample for sample in self.line if sample.gid in sources]:
                self.line.remove(sample)
            self._bytes = sum(len(sample.payload) for sample in self.line)

    def clear(self) -> None:
        with self._lock:
            self.line.clear()
            self._bytes = 0
