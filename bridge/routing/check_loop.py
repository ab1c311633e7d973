"""The thread that checks both graphs of an engine when they change, and also periodically."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable

from bridge.progress import StepWatch
from bridge.ticks import until_tick

_log = logging.getLogger(__name__)

TICK = 1.0
"""Seconds between two ticks."""

POLL = 10.0
"""Minimum seconds until a check without a wake-up, which catches missed notifications; `_RETRY` if it has to repeat."""

_SHARE, _LONGEST = 1000, 60.0
"""This pause is 1000 times the last check's CPU time (0.1 % of a core), at least `POLL` and at most 60 s."""

_RETRY = 2.0
_SETTLE = 0.02
_STEP_SECONDS = 3.0
"""Seconds without progress after which a check counts as hanging."""


class CheckLoop:
    """Runs ``check`` when woken and at least every minute, and any ``tick`` each second, on a separate thread.

    ``check`` returns whether to repeat it soon, because refused routes may work by then. If either fails, the thread
    calls ``failed`` and ends. Any thread may call `wake`.
    """

    def __init__(
        self, side: str, check: Callable[[], bool], failed: Callable[[str], None],
        tick: Callable[[], None] | None = None,
    ) -> None:  # fmt: skip
        self._side = side
        self._check, self._failed, self._tick = check, failed, tick
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._began: float | None = None  # None while the thread waits
        self._step = StepWatch(_STEP_SECONDS)
        self._thread = threading.Thread(target=self._run, name=f"midspan-{side}-engine", daemon=True)

    def start(self) -> None:
        """Start the thread, with a check at once."""
        self._thread.start()

    def wake(self) -> None:
        """Schedule a check."""
        self._wake.set()

    def stop(self) -> None:
        """End the thread after the current check, and wait up to three seconds for it."""
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(3.0)

    def alive(self) -> str:
        """Return a text if a check takes long, else ""; raises `TimeoutError` if it hangs."""
        return self._step.judge(f"the {self._side} engine's loop", self._began)

    def _run(self) -> None:
        self._step.begin()
        check, tick = 0.0, math.inf if self._tick is None else 0.0
        while not self._stopping.is_set():
            woken = self._wake.wait(max(0.0, min(tick, check) - time.monotonic()))
            if self._stopping.is_set():
                return
            now = self._began = time.monotonic()
            try:
                if woken or now >= check:
                    check = now + self._check_now()
                    self._stopping.wait(_SETTLE)
                if self._tick is not None and now >= tick:
                    tick = now + until_tick(TICK)
                    self._tick()
            except Exception as err:
                _log.exception("%s: following the graphs failed", self._side)
                self._failed(f"following the graphs failed: {err}")
                return
            self._began = None

    def _check_now(self) -> float:
        """Check, and return the seconds until a check without a wake-up."""
        self._wake.clear()
        cost = time.thread_time()
        again = self._check()
        cost = time.thread_time() - cost
        return _RETRY if again else max(POLL, min(_SHARE * cost, _LONGEST))
