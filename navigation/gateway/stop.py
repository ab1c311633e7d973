"""Whether the base stands by its odometry, and stops until the planner or the base confirms them."""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable

from bridge.messages.actions import GoalState
from navigation.frames import FramesError, RobotFrames
from navigation.gateway.drive import ClientDrive, UnconfirmedStop
from navigation.gateway.planner_link import PlannerLink
from navigation.pose import Pose
from navigation.status import Fault, PlannerStatus, State

STANDING_SECONDS = 0.4  # a base that has not moved for so long stands
STILL_METRES, STILL_RADIANS = 0.005, 0.01  # what odometry of a base that stands may change by in that time
_KEPT_SECONDS = 3.0  # for so long poses are kept, for the speed


class Motion:
    """Follows the base's odometry: `look` on the module's thread, the rest on any."""

    def __init__(self, frames: RobotFrames) -> None:
        self._frames = frames
        self._poses: tuple[tuple[float, Pose], ...] = ()
        """When each came, and the pose. Never changed, only replaced: other threads read it."""

    def look(self) -> None:
        """Note where the base is now; called some ten times a second."""
        now = time.monotonic()
        try:
            pose = self._frames.odometry()
        except FramesError:
            self._poses = ()
            return
        before = self._poses
        if not before or pose.stamp_ns != before[-1][1].stamp_ns:
            self._poses = (*(one for one in before if one[0] >= now - _KEPT_SECONDS), (now, pose))

    def stands(self, since: float = 0.0) -> bool | None:
        """Whether the base has stood for `STANDING_SECONDS` by its odometry's stamps; None without odometry.

        What came before ``since`` (monotonic seconds) does not count.
        """
        poses = self._poses
        if not poses:
            return None
        now = poses[-1][1]
        for came, pose in reversed(poses):
            turned = math.remainder(pose.theta - now.theta, math.tau)
            if math.hypot(pose.x - now.x, pose.y - now.y) > STILL_METRES or abs(turned) > STILL_RADIANS:
                return False
            if came < since:
                return None
            if now.stamp_ns - pose.stamp_ns >= STANDING_SECONDS * 1e9:
                return True
        return None

    @property
    def speed(self) -> float | None:
        """Metres a second over the last seconds; None where that is not known, or the base hardly moves."""
        poses = self._poses
        if len(poses) < 2:
            return None
        first, last = poses[0][1], poses[-1][1]
        seconds = (last.stamp_ns - first.stamp_ns) / 1e9
        moved = math.hypot(last.x - first.x, last.y - first.y)
        return moved / seconds if seconds > 0 and moved > 2 * STILL_METRES else None


LATE_SECONDS = 1.0  # a planner that has not let go after so long is said to be late; the base may still be moving
CANCEL_SECONDS = 10.0
"""After so long without anything that confirms a stop the client's goal ends ABORTED: it may still be moving."""

HELD_SECONDS = 60.0  # for so long the velocities of a planner that is not there are held, where the base stands
ANSWER_SECONDS = 1.5  # the longest time until a client that asks for a stop is answered


StopAnswer = queue.SimpleQueue[str]  # what `StopWaiters` answers, for another thread


def waited_for(answer: StopAnswer) -> str:
    """Why a stop is not confirmed; "" where it is. Waits, so not on the module's thread."""
    try:
        return answer.get(timeout=2 * ANSWER_SECONDS)
    except queue.Empty:
        return "the gateway has not answered; it may still be moving"


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
