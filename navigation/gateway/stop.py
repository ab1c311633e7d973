"""A stop or pause, which is confirmed when the planner has released its goals and the base stands still."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable

from bridge.state_machine import Machine
from navigation.gateway.machine import STOP, StopEvent, StopState
from navigation.gateway.motion import Motion, VelocityWatch

LATE_SECONDS = 1.0
"""A stop that is not confirmed within this time is reported as unconfirmed: the robot may still be moving."""

GIVE_UP_SECONDS = 10.0
"""After this time without a confirmation the client's goal ends ABORTED: the robot may still be moving."""

SETTLING_SECONDS = 5.0
"""If the base still moves this long after the planner released its goals, another program is assumed to move it."""

HELD_SECONDS = 60.0
"""How long an unreachable planner's velocities are kept from reaching a base that stands still."""

OVERRIDE_SECONDS = 1.0
"""For this time, zero velocities from the gateway override a planner that has not released its goals.

If the base stands still after that time, the stop is confirmed even without the planner.
"""

ANSWER_SECONDS = 2.5
"""A client that requests a stop is answered within this time, because a base may take a second to come to rest."""


StopAnswer = queue.SimpleQueue[str]
"""Receives the answer to a client that waits on another thread: "" or the reason why the stop is not confirmed."""


def wait_for(answer: StopAnswer) -> str:
    """Wait for the answer to a stop; not on the module's thread."""
    try:
        return answer.get(timeout=2 * ANSWER_SECONDS)
    except queue.Empty:
        return "the gateway has not answered; the robot may still be moving"


class StopWaiters:
    """The clients that requested a stop; each is answered once, when the stop is confirmed or late."""

    def __init__(self) -> None:
        self._waiting: list[tuple[float, Callable[[str], None]]] = []

    def add(self, answer: Callable[[str], None], seconds: float) -> None:
        """Call ``answer`` with "" if the stop is confirmed within this time, otherwise with the reason."""
        self._waiting.append((time.monotonic() + seconds, answer))

    def notify(self, trouble: str) -> None:
        """Answer all if ``trouble`` is "", otherwise those whose time is over."""
        now = time.monotonic()
        due = [entry for entry in self._waiting if not trouble or now >= entry[0]]
        self._waiting = [entry for entry in self._waiting if entry not in due]
        for _, answer in due:
            answer(trouble)

    def fail(self, reason: str) -> None:
        """Answer all with the reason why their stop will not be confirmed."""
        waiting, self._waiting = self._waiting, []
        for _, answer in waiting:
            answer(reason)


class StopOrder:
    """The current stop or pause, if any, and the clients that wait for its confirmation. Not thread-safe."""

    def __init__(self, motion: Motion, velocity: VelocityWatch) -> None:
        self._motion, self._velocity = motion, velocity
        self._machine: Machine[StopState, StopEvent] = Machine(STOP, StopState.NONE)
        self.reason = ""  # the reason for the request
        self.asked_at = 0.0  # monotonic
        self._excused = 0.0  # seconds since then that do not count
        # when the planner was seen to have released its goals (monotonic), without odometry; 0: not seen
        self._released_at = 0.0
        self.waiters = StopWaiters()

    @property
    def state(self) -> StopState:
        return self._machine.state

    @property
    def age(self) -> float:
        """Seconds since the request, without the time for which this process stood still."""
        return time.monotonic() - self.asked_at - self._excused

    def excuse(self, seconds: float) -> None:
        """Do not count time for which this process stood still."""
        self._machine.excuse(seconds)
        self._excused = min(self._excused + seconds, time.monotonic() - self.asked_at)

    @property
    def confirmed(self) -> bool:
        """Whether the robot stands still, and the planner has released its goals or had `OVERRIDE_SECONDS` to do so."""
        return self.state in (StopState.CONFIRMED, StopState.RESTING)

    def ask(self, reason: str) -> None:
        """Request a stop or pause; an unconfirmed one continues, and keeps its original request time."""
        self.reason = reason
        if not self.state.open:
            self.asked_at, self._excused = time.monotonic(), 0.0
            self._machine.on(StopEvent.ASK)

    def drop(self, reason: str = "") -> None:
        """Drop the stop: a new goal replaces it, or there was nothing to stop."""
        self._machine = Machine(STOP, StopState.NONE)
        self._velocity.close()
        if reason:
            self.waiters.fail(reason)

    def update(self, *, released: bool, seen_at: float) -> None:
        """Update the state; ``seen_at`` is when the planner was last reachable (monotonic seconds)."""
        if not self.state.open:
            return
        machine = self._machine
        base = StopEvent.STANDS if self._is_standing(released=released) else StopEvent.MOVES
        # a base that moves again is noted before the planner's release can confirm the stop
        for event in (base, StopEvent.RELEASED, base) if released else (StopEvent.NOT_RELEASED, base):
            machine.on(event)
        unreachable = min(self.age, time.monotonic() - seen_at)
        expired = machine.state is StopState.RESTING and unreachable > HELD_SECONDS
        if expired or (machine.state is StopState.SETTLING and machine.age > SETTLING_SECONDS):
            machine.on(StopEvent.EXPIRE)
        if not machine.state.open:
            self._velocity.close()

    def _is_standing(self, *, released: bool) -> bool:
        """Whether the base stands still, by odometry or else by its velocity commands after the planner's release."""
        if self._motion.known:
            self._velocity.close()
            # standing still under the gateway's zero velocities does not count: the planner may move the base again
            since = self.asked_at if released else self.asked_at + OVERRIDE_SECONDS
            return self._motion.is_standing(since) is True
        self._velocity.open()
        # before the release, silence proves nothing: an unreachable planner's velocities do not reach the hub
        self._released_at = (self._released_at or time.monotonic()) if released else 0.0
        stands = released and self._velocity.zero(self._released_at)
        if stands:
            self._motion.rest()
        return stands
