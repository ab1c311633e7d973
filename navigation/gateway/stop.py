"""Stops until they are confirmed: by the planner, which lets go of its goal, or by the base, which stands."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from dataclasses import dataclass

from bridge.messages.actions import GoalState
from navigation.gateway.drive import ClientDrive
from navigation.gateway.motion import Motion
from navigation.gateway.planner_link import PlannerLink
from navigation.status import Fault, PlannerStatus, State

LATE_SECONDS = 1.0
"""A planner that has not let go after so long is said to be late; the base may still be moving."""

CANCEL_SECONDS = 10.0
"""After so long without anything that confirms a stop the client's goal ends ABORTED: it may still be moving."""

HELD_SECONDS = 60.0
"""For so long the velocities of a planner that is not there are held, where the base stands."""

ANSWER_SECONDS = 1.5
"""The longest time until a client that asks for a stop is answered."""


StopAnswer = queue.SimpleQueue[str]
"""What `StopWaiters` answers, for another thread."""


def waited_for(answer: StopAnswer) -> str:
    """Why a stop is not confirmed; "" where it is. Waits, so not on the module's thread."""
    try:
        return answer.get(timeout=2 * ANSWER_SECONDS)
    except queue.Empty:
        return "the gateway has not answered; it may still be moving"


@dataclass
class UnconfirmedStop:
    """Goals that ended here while their planner has not said that it let go of them.

    The wish outlives the goal: `navigation.gateway.planner_link.PlannerLink` asks the planner as soon as it is there.
    """

    why: str  #: they ended
    since: float  #: when (monotonic)
    stands: bool = False  #: whether the base stands, by its odometry
    # whether it is not known yet if the planner has any goals: it is looked for since a moment ago
    unknown: bool = False


class StopWaiters:
    """The clients that asked for a stop; each is answered once it is confirmed, or late."""

    def __init__(self) -> None:
        self._asked: list[tuple[float, Callable[[str], None]]] = []

    def add(self, answer: Callable[[str], None]) -> None:
        """Have ``answer`` called once: with "" where the stop is confirmed, else with why it is not."""
        self._asked.append((time.monotonic() + ANSWER_SECONDS, answer))

    def tell(self, trouble: str) -> None:
        """Answer every client if the stop is confirmed, else those whose time is over."""
        now = time.monotonic()
        due = [one for one in self._asked if not trouble or now >= one[0]]
        self._asked = [one for one in self._asked if one not in due]
        for _, answer in due:
            answer(trouble)


class Stopping:
    """Follows stops. On the module's thread."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self.stop: UnconfirmedStop | None = None  # goals that ended here; their planner may still drive
        self.waiters = StopWaiters()  # those who asked for a stop

    def look(self, drive: ClientDrive | None, link: PlannerLink) -> tuple[GoalState, int, str] | None:
        """See whether planner or odometry confirm a stop; how a drive ends that is being given up, once known."""
        stop = self.stop
        if stop is not None:
            stop.stands = self._motion.stands(stop.since) is True
            if stop.unknown and link.may_drive:
                stop.unknown = False
                link.cancel_all()  # these are meant as well
            if link.let_go or (stop.unknown and not link.unknown):
                self.stop = None
        if drive is None or not (drive.stopping or drive.paused) or drive.let_go:
            return None
        if drive.below is None and link.let_go:
            drive.let_go = True
        if not drive.stopping:
            return None
        late, why = time.monotonic() - drive.held_at, f"{drive.stopping}; {link.planner} has not answered"
        if drive.let_go:
            return GoalState.CANCELED, Fault.OTHER, drive.stopping
        if late > LATE_SECONDS and self._motion.stands(drive.held_at):
            return GoalState.CANCELED, Fault.OTHER, f"{why}, and the base stands"
        if late > CANCEL_SECONDS:
            return GoalState.ABORTED, Fault.MAY_MOVE, f"{why}, and it may still be moving"
        return None

    def held(self, drive: ClientDrive | None, link: PlannerLink) -> bool:
        """Whether the robot must stand while its planner has not let go: no velocity of it may reach a base."""
        stop = self.stop
        if drive is not None and (drive.stopping or drive.paused) and not drive.let_go:
            return True
        if stop is None:
            return False
        gone = stop.stands and time.monotonic() > max(stop.since, link.seen_at) + HELD_SECONDS
        return not gone  # others on its side may drive by now

    def trouble(self, drive: ClientDrive | None, link: PlannerLink) -> str:
        """Why a stop is not confirmed; "" where it is."""
        stop = self.stop
        stopping = drive.stopping if drive is not None else stop is not None and not stop.stands
        return unconfirmed(link) if stopping else ""


def may_move(why: str, link: PlannerLink) -> PlannerStatus:
    """A stop that is not confirmed."""
    return PlannerStatus(State.MOVING, f"{why}; {unconfirmed(link)}", Fault.MAY_MOVE)


def unconfirmed(link: PlannerLink) -> str:
    """Why a stop is not confirmed, in words."""
    planner = f"{link.planner} has not let go of its goal" if link.ready else f"the planner {link.planner} is not there"
    return f"it may still be moving: {planner}; it is asked to stop until it does"
