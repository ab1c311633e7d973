"""Threads that carry messages from the hub to a side, the most urgent class first.

A large message, and one that comes while its route still publishes, is appended to the route's queue by zenoh's
receiving thread, which wakes a dispatcher: publishing may take milliseconds for an image. A small message is published
by the receiving thread itself: no edge waits for a peer in it, and the hand-over to a sleeping thread would cost 40 of
the 230 us that the whole way takes (benchmarks/topic_latency.py).
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

from bridge.routing.priority import Priority

_log = logging.getLogger(__name__)
_ORDER = (Priority.COMMAND, Priority.STATE, Priority.STREAM)


class Dispatcher:
    """One thread and three lanes of work; a piece of work is a call that handles one message of a route."""

    def __init__(self, name: str) -> None:
        self._lanes: dict[Priority, deque[Callable[[], None]]] = {p: deque() for p in _ORDER}
        self._wake: SimpleQueue[bool] = SimpleQueue()
        self._busy: dict[int, float] = {}
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def submit(self, priority: Priority, work: Callable[[], None]) -> None:
        """Do a piece of work in its lane's turn. The lanes are bounded by the queues of their routes."""
        self._lanes[priority].append(work)
        self._wake.put(True)

    def here(self, work: Callable[..., None], *about: Any) -> None:
        """Do a piece of work at once, on the caller's thread; ``about`` is what it is called with."""
        me = threading.get_ident()
        self._busy[me] = time.monotonic()
        try:
            work(*about)
        except Exception:
            _log.exception("a route failed on one message")
        finally:
            del self._busy[me]

    def stuck_for(self) -> float:
        """Seconds that the longest piece of work now under way has taken, 0.0 when idle."""
        now = time.monotonic()
        return max((now - since for since in self._busy.copy().values()), default=0.0)

    def stop(self) -> None:
        """Let the thread end after the work under way; what is still queued is dropped."""
        self._wake.put(False)
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(2.0)

    def _run(self) -> None:
        lanes = [self._lanes[p] for p in _ORDER]
        while self._wake.get():
            for lane in lanes:
                if lane:
                    work = lane.popleft()
                    break
            else:
                continue
            self.here(work)
