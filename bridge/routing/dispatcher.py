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

from bridge.progress import StepWatch
from bridge.routing.limits import Priority

_log = logging.getLogger(__name__)
_ORDER = (Priority.COMMAND, Priority.STATE, Priority.STREAM)
_STUCK_SECONDS = 4.0
"""Work that stands still for longer hangs."""


class Dispatcher:
    """One thread and a queue of work for each class; a piece of work is a call that handles one message of a route."""

    def __init__(self, name: str) -> None:
        self._classes: dict[Priority, deque[Callable[[], None]]] = {p: deque() for p in _ORDER}
        self._wake: SimpleQueue[bool] = SimpleQueue()
        self._busy: dict[int, float] = {}
        self._step = StepWatch(_STUCK_SECONDS)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def submit(self, priority: Priority, work: Callable[[], None]) -> None:
        """Do a piece of work in its class's turn. The queues are bounded by the queues of their routes."""
        self._classes[priority].append(work)
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

    def alive(self, who: str) -> str:
        """A text about work on its own thread that computes for long, else ""; for one thread.

        Raises `TimeoutError` where a piece of work hangs, or one on a caller's thread takes too long.
        """
        now, busy = time.monotonic(), self._busy.copy()
        own = busy.pop(self._thread.ident or 0, None)
        stuck = max((now - since for since in busy.values()), default=0.0)
        if stuck > _STUCK_SECONDS:
            raise TimeoutError(f"{who} has been stuck for {stuck:.1f} s")
        return self._step.judge(who, own)

    def stop(self) -> None:
        """End the thread after the work under way; queued work is dropped."""
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
