"""The gateway: takes goals of clients of every side, and publishes how they get on over the chosen planner."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from bridge.config.sections.navigation import NavigationSection
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from navigation.frames import RobotFrames
from navigation.gateway.drive import ClientDrive, Target, TargetError, target_of
from navigation.gateway.driving import Driving
from navigation.gateway.planner_choice import RequestError
from navigation.gateway.planner_link import PlannerLink
from navigation.gateway.stop import LATE_SECONDS, UnconfirmedStop, may_move
from navigation.messages import Message
from navigation.status import Fault, PlannerStatus, State, status_message

_LOOK_SECONDS = 0.1
BETWEEN_MAPS = "robot_path_planner"
"""The planner that drives to other maps, through links: there the goal's frame is the map's name."""


class Gateway(Driving):
    """Gives goals to the chosen planner, and publishes their status. All on the module's thread."""

    def __init__(
        self,
        host: Host,
        section: NavigationSection,
        frames: RobotFrames,
        publish: Callable[[Message], None],  # called with each new status (``midspan_msgs/NavigationStatus``)
        # called when the planner's velocities are to be kept from the base, and when they are no more
        hold: Callable[[bool], None],
    ) -> None:
        super().__init__(host, section, frames)
        self._publish, self._hold = publish, hold
        self._held = False
        self._said: tuple[Any, ...] = ()
        host.loop.every(_LOOK_SECONDS, self._look)

    def take(self, goal: Goal) -> bool:
        """A goal of the action; it takes the place of any other."""
        try:
            target = target_of(goal.goal["pose"], goal.goal["behavior_tree"])
        except TargetError as err:
            goal.abort({"error_code": int(Fault.BAD_GOAL), "error_msg": str(err)})  # a rejection cannot say why
            return True
        self.begin([target], "a client of the action", goal=goal)
        return True

    def cancel(self, goal: Goal) -> bool:
        """A client cancels its goal."""
        if self.drive is not None and self.drive.goal is goal:
            self._give_up("the client canceled it")
        return True

    def go(self, places: Sequence[Target], who: str, name: str = "") -> None:
        """Drive to places of the store in turn; raises `RequestError` if the planner knows no way to the map of one."""
        elsewhere = [one.frame for one in places if one.frame != self.frame]
        if elsewhere and self.planner != BETWEEN_MAPS:
            raise RequestError(f"it is on the map {elsewhere[0]}; {self.planner} knows only the one that is in use")
        self.begin(places, who, name)

    def stop(self) -> str:
        """Have the planner give up all goals, also others'; what was done. `when_stopped` tells if the robot stands."""
        others, driven = len(self.link.others), self.link.may_drive
        self.link.cancel_all()  # also what is not in its list yet
        if self.drive is not None:
            self._give_up("it was stopped")
            return "the goal is canceled"
        unknown, stopping = not driven and self.link.unknown, self._stopping
        if (driven or unknown) and stopping.stop is None:
            stopping.stop = UnconfirmedStop("it was stopped", time.monotonic(), unknown=unknown)
        if not driven and (stopping.stop is None or stopping.stop.unknown):
            self._last = PlannerStatus()
        self._changed()
        return f"the goals that {self.planner} was given itself are canceled" if others else "there was no goal"

    def when_stopped(self, answer: Callable[[str], None]) -> None:
        """Call ``answer`` once: with "" as soon as a stop is confirmed, else, after a while, with why it is not."""
        self._stopping.waiters.add(answer)
        self._stopping.waiters.tell(self._unstopped())

    def choose(self, planner: str) -> str:
        """Have another planner drive; what it waits for, in words. Raises `RequestError` if unknown, or one drives."""
        self._choice.choose(planner, driving=self.driving)
        self._settle()
        self._changed()
        return f"once {self.planner} has let go of its goal" if self.pending else ""

    def configure(self, section: NavigationSection) -> None:
        """Take up another section, at the end of the drive where there is one; see `PlannerChoice.configure`."""
        self._choice.configure(section)
        self._settle()
        self._changed()

    @property
    def held(self) -> bool:
        """Whether the robot must stand while its planner has not let go."""
        return self._stopping.held(self.drive, self.link)

    @property
    def choices(self) -> tuple[str, ...]:
        """The planners that can be chosen."""
        return self._choice.section.choices

    @property
    def pending(self) -> str:
        """The planner that takes over once the current one stands; "" for none."""
        return self._choice.pending

    def state(self) -> PlannerStatus:
        """How it is getting on. On any thread."""
        drive, link, stop = self.drive, self.link, self._stopping.stop
        if drive is not None:
            return of_drive(drive, link, stands=self.motion.stands(drive.held_at), silence=self._choice.section.silence)
        if stop is not None and not stop.stands:
            return may_move(stop.why, link)
        others = [] if stop is not None else link.others
        if others:
            return of_others(link, others[-1])
        return of_gone(link) if stop is None and link.gone is not None else self._last

    def status(self) -> Message:
        """The same as a ``midspan_msgs/NavigationStatus``."""
        drive, others = self.drive, self.link.others
        said = self._host.clock.stamp(), self.state()
        if drive is not None:
            return status_message(*said, goal_id=drive.id, goal=drive.target.stamped(self.robot()))
        if others:
            return status_message(*said, goal_id=others[-1], goal=self.link.pose(others[-1]))
        return status_message(*said)

    def _changed(self) -> None:
        """Publish the status if it has changed."""
        if self.drive is None and not self.link.others and self.link.ended is not None:
            self._last, self.link.ended = of_ended(self.link, *self.link.ended), None
        drive = self.drive
        said = (*self.state(), drive and drive.id, drive and drive.at, None if drive else tuple(self.link.others[-1:]))
        if said != self._said:
            self._said = said
            self._publish(self.status())
        held = self.held
        if held != self._held:
            self._held = held
            self._hold(held)
        self._stopping.waiters.tell(self._unstopped())

    def _unstopped(self) -> str:
        return self._stopping.trouble(self.drive, self.link)


def of_drive(drive: ClientDrive, link: PlannerLink, *, stands: bool | None, silence: float) -> PlannerStatus:
    """How a client's drive gets on; ``stands``: whether the base does, None where that is not known.

    A planner that tells nothing for longer than ``silence`` seconds is said not to answer; 0: never.
    """
    if drive.stopping:
        return (
            PlannerStatus(State.MOVING, f"stopping: {drive.stopping}")
            if not _late(drive)
            else may_move(drive.stopping, link)
        )
    if drive.paused:
        if _late(drive) and stands is not True:
            return may_move("it was paused", link)
        return PlannerStatus(State.PAUSED, "" if drive.let_go else f"{link.planner} is stopping")
    below = drive.below
    if drive.waiting:
        # clients take an error for the end, and the drive goes on once the planner is back
        moves = drive.begun and stands is not True
        why = f"the planner {link.planner} is not there; it is waited for" + (
            "; it may still be moving" if moves else ""
        )
        return PlannerStatus(State.MOVING if moves else State.PREPARING, why, Fault.NO_NAVIGATOR)
    if below is None:
        return PlannerStatus(State.MOVING)  # it ended without a reason, which is being looked for
    if silence and not link.ours and link.silent > silence:  # the daemon watches Midspan's own
        why = f"{link.planner} does not answer: no status or feedback of it for {silence:g} s"
        return PlannerStatus(State.MOVING, why, Fault.SILENT)
    if not below.accepted:
        return PlannerStatus(State.PREPARING)
    state, why = link.told(below.id) or (State.MOVING, "")
    if state.ended:
        return PlannerStatus(State.MOVING, "", link.code(below.id))  # how it ended comes as the goal's result
    return PlannerStatus(State.MOVING if state is State.PAUSED else state, why, link.code(below.id))


def _late(drive: ClientDrive) -> bool:
    return not drive.let_go and time.monotonic() > drive.held_at + LATE_SECONDS


def of_others(link: PlannerLink, goal: bytes) -> PlannerStatus:
    """How a goal gets on that the planner was given itself."""
    state, why = link.told(goal) or (State.MOVING, "")
    return PlannerStatus(state, why or _itself(link), link.code(goal))


def of_gone(link: PlannerLink) -> PlannerStatus:
    """Such a goal, as the planner is out of reach: it goes on there, for all that is known."""
    why = f"{_itself(link)}; the planner {link.planner} is not there; it may still be moving"
    return PlannerStatus(State.MOVING, why, Fault.MAY_MOVE)


def of_ended(link: PlannerLink, goal: bytes, state: State, why: str) -> PlannerStatus:
    """How such a goal ended."""
    told = link.told(goal)
    return PlannerStatus(state, why or (told[1] if told else "") or _itself(link), link.code(goal))


def _itself(link: PlannerLink) -> str:
    return f"a goal that {link.planner} was given itself"
