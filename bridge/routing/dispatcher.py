"""Threads that carry messages from the hub to a side, the most urgent class first.

zenoh's receiving thread queues large messages, and messages that arrive while their route is publishing, and wakes a
dispatcher: publishing an image may take milliseconds. It publishes small messages itself: no edge waits for a peer, and
the hand-over to a sleeping thread would cost 40 us of a total latency of 230 us (benchmarks/topic_latency.py).
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

from bridge.progress import StepWatch
from bridge.routing.limits import Priority

_log = logging.getLogger(__name__)
_ORDER = (Priority.COMMAND, Priority.STATE, Priority.STREAM)
_STUCK_SECONDS = 4.0
"""A call without progress for longer hangs."""


class Dispatcher:
    """One thread with a queue of calls for each class; each call handles one message of a route."""

    def __init__(self, name: str) -> None:
        self._classes: dict[Priority, deque[Callable[[], None]]] = {p: deque() for p in _ORDER}
        self._wake: SimpleQueue[bool] = SimpleQueue()
        self._busy: dict[int, float] = {}
        self._step = StepWatch(_STUCK_SECONDS)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def submit(self, priority: Priority, work: Callable[[], None]) -> None:
        """Queue a call in its class. The queues are bounded by the queues of their routes."""
        self._classes[priority].append(work)
        self._wake.put(True)

    def here(self, work: Callable[..., None], *about: Any) -> None:
        """Make a call at once, on the calling thread, with the arguments ``about``."""
        me = threading.get_ident()
        self._busy[me] = time.monotonic()
        try:
            work(*about)
        except Exception:
            _log.exception("a route failed on one message")
        finally:
            del self._busy[me]

    def alive(self, name: str) -> str:
        """Return a text if a call on the dispatcher's thread computes for a long time, else "". Not thread-safe.

        Raises `TimeoutError` if a call hangs, or takes too long on another thread.
        """
        now, busy = time.monotonic(), self._busy.copy()
        own_since = busy.pop(self._thread.ident or 0, None)
        stuck = max((now - since for since in busy.values()), default=0.0)
        if stuck > _STUCK_SECONDS:
            raise TimeoutError(f"{name} has been stuck for {stuck:.1f} s")
        return self._step.judge(name, own_since)

    def stop(self) -> None:
        """End the thread after its current call; queued calls are dropped."""
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
            self.here(work)
