"""Steps that a client asks for, each answered once all that it names have acknowledged the time it came to."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from bridge.modules.loop import Loop, Timer
from bridge.modules.services import Answer
from sim import messages
from sim.simulation import TICK_NS

_MOST = 3600.0
_BUNDLE = 50
"""Ticks at one go, after which others are heard."""


class Stepping:
    """Serves ``/sim/step``, one step at a time; all on the module's thread.

    Args:
        loop: the module's thread.
        tick: lets one tick pass, and says the time it came to.
    """

    def __init__(self, loop: Loop, tick: Callable[[], int]) -> None:
        self._loop, self._tick = loop, tick
        self._answer: Answer | None = None
        self._left = 0
        self._now = 0
        self._wait_for: set[str] = set()
        self._said: dict[str, int] = {}
        self._patience = 0.0
        self._timer: Timer | None = None

    @property
    def busy(self) -> bool:
        """Whether a step is under way."""
        return self._answer is not None

    def serve(self, request: dict[str, Any], answer: Answer) -> None:
        """Step."""
        seconds, patience = request["seconds"], request["patience"]
        if not (math.isfinite(seconds) and 0.0 < seconds <= _MOST and math.isfinite(patience)):
            answer(_reply(self._now, f"a step is more than 0 and at most {_MOST:g} seconds"))
            return
        if self.busy:
            answer(_reply(self._now, "another step is under way: wait for its reply"))
            return
        self._answer, self._left = answer, max(1, round(seconds * 1e9 / TICK_NS))
        self._wait_for, self._patience = set(request["wait_for"]), max(0.0, patience)
        self._go()

    def acknowledge(self, message: dict[str, Any]) -> None:
        """A participant is done with a time."""
        at = message["stamp"]["sec"] * 1_000_000_000 + message["stamp"]["nanosec"]
        if message["frame_id"] in self._wait_for:
            self._said[message["frame_id"]] = at
            self._finish()

    def give_up(self, why: str) -> None:
        """End the step that is under way."""
        answer, self._answer = self._answer, None
        self._left, self._said = 0, {}
        if self._timer is not None:
            self._timer.close()
        if answer is not None:
            answer(_reply(self._now, why))

    def _go(self) -> None:
        if self._answer is None:
            return
        count = min(self._left, _BUNDLE)
        for _ in range(count):
            self._now = self._tick()
        self._left -= count
        if self._left:
            self._loop.post(self._go)
            return
        if self._wait_for:
            self._timer = self._loop.after(self._patience, self._tired)
        self._finish()

    def _waiting(self) -> set[str]:
        return {name for name in self._wait_for if self._said.get(name, -1) < self._now}

    def _finish(self) -> None:
        if self._answer is not None and not self._left and not self._waiting():
            self.give_up("")

    def _tired(self) -> None:
        if self._answer is not None and not self._left and (missing := self._waiting()):
            self.give_up(f"not acknowledged by {', '.join(sorted(missing))} within {self._patience:g} s")


def _reply(time_ns: int, why: str) -> dict[str, Any]:
    return {"success": not why, "message": why, "stamp": messages.stamp(time_ns)}
