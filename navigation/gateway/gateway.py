"""The gateway: takes goals of clients of every side, has the chosen planner drive, and publishes how it gets on."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bridge.config.sections.navigation import NavigationSection
from bridge.messages.actions import GoalState
from bridge.modules.action_server import Goal
from bridge.modules.clients import SentGoal
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from navigation.frames import FramesError, RobotFrames
from navigation.gateway.drive import ClientDrive, Target, TargetError, UnconfirmedStop, target_of
from navigation.gateway.planner_link import PlannerChoice, PlannerLink, RequestError
from navigation.gateway.progress import distance, of_drive, of_ended, of_gone, of_others, seconds
from navigation.gateway.stop import Motion, Stopping, may_move
from navigation.messages import Message, duration
from navigation.pose import Pose
from navigation.status import Fault, PlannerStatus, State, status_message

DOUBTFUL_SECONDS = 0.5
"""After an end that the planner gave no error code for, so long is looked whether it is there at all."""

SETTLING_SECONDS = 5.0  # a rejection of a planner that came so lately is not believed: it is asked again
REPLACED_SECONDS = 5.0
"""A planner that still has the old goal so long after a new one drives several at a time; the old one is cancelled."""

COMING_SECONDS = 30.0
"""For so long a goal waits beyond `NavigationSection.patience` for a planner of which parts have come already."""

_LOOK_SECONDS = 0.1
_OUTCOMES = {GoalState.SUCCEEDED: "reached", GoalState.CANCELED: "canceled"}
BETWEEN_MAPS = "robot_path_planner"
"""The planner that drives to other maps, through links: there the goal's frame is the map's name."""


class Gateway:
    """Has the planner drive to what clients want, one drive at a time, and says how that gets on and why it ends.

    All on the module's thread.
    """

    def __init__(
        self,
        host: Host,
        section: NavigationSection,
        frames: RobotFrames,
        publish: Callable[[Message], None],  # called with each new status (``midspan_msgs/NavigationStatus``)
        # called when the planner's velocities are to be kept from the base, and when they are no more
        hold: Callable[[bool], None],
    ) -> None:
        self._host, self._frames = host, frames
        self._publish, self._hold = publish, hold
        self.motion = Motion(frames)
        self._stopping = Stopping(self.motion)
        self._choice = PlannerChoice(host, section, self._changed)
        self.drive: ClientDrive | None = None  # the one at hand; None where there is none
        self._last = PlannerStatus()
        self._pause: Timer | None = None
        self._held = False
        self._said: tuple[Any, ...] = ()
        #: how many drives of clients ended so; refused is what is no place to drive to
        self.ended = dict.fromkeys(("reached", "failed", "canceled", "replaced", "refused"), 0)
        host.loop.every(_LOOK_SECONDS, self._look)

    @property
    def link(self) -> PlannerLink:
        """The planner at hand."""
        return self._choice.link

    @property
    def planner(self) -> str:
        """Its name."""
        return self.link.planner

    @property
    def frame(self) -> str:
        """The map's frame."""
        return self._choice.section.frame

    @property
    def driving(self) -> bool:
        """Whether the planner has a goal, from here or from others."""
        return self.drive is not None or bool(self.link.others)

    @property
    def has_base(self) -> bool:
        """Whether the planner commands the base, or may."""
        drive = self.drive
        return self.driving and not (drive is not None and drive.paused and drive.below is None)

    def robot(self) -> Pose | None:
        """Where the robot is on the map, None where that is not known."""
        try:
            return self._frames.pose()
        except FramesError:
            return None

    # -- what clients ask for ------------------------------------------------------------------------------------------

    def take(self, goal: Goal) -> bool:
        """A goal of the action; it takes the place of any other."""
        try:
            target = target_of(goal.goal["pose"], goal.goal["behavior_tree"])
        except TargetError as err:
            self.ended["refused"] += 1
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

    def begin(self, targets: Sequence[Target], who: str, name: str = "", goal: Goal | None = None) -> ClientDrive:
        """Drive somewhere, instead of where it was driving to."""
        before, self.drive = self.drive, ClientDrive([self._on_map(one) for one in targets], who, goal, name)
        self.drive.let_go = self._stopping.stop is None and (before is None or before.let_go)
        self._unpause()
        if before is not None:
            self.ended["replaced"] += 1
            before.end(GoalState.CANCELED, Fault.OTHER, f"{who} gave another goal, which took its place")
        if goal is not None:
            goal.execute()
        self._send(self.drive, None if before is None else before.below)
        return self.drive

    def pause(self, seconds: float = float("inf")) -> None:
        """Stand still; the client's goal stays active. Raises `RequestError` if there is nothing to pause."""
        drive = self.drive
        if drive is None:
            itself = f"the goal was given to {self.planner} itself and is not known here; stop can end it, not pause it"
            raise RequestError(itself if self.link.others else "there is no goal to pause")
        self._unpause()
        drive.paused, drive.waiting, drive.held_at = True, False, time.monotonic()
        if seconds < 1e6:
            self._pause = self._host.loop.after(seconds, lambda: self._go_on(drive))
        if drive.below is not None:
            drive.below.cancel()
        self._changed()

    def resume(self) -> None:
        """Go on: the goal is sent again; raises `RequestError` if it is not paused."""
        drive = self.drive
        if drive is None or not drive.paused:
            raise RequestError("nothing is paused")
        self._go_on(drive)

    def recompute(self) -> None:
        """Have the planner find the way anew, by sending the goal again; raises `RequestError` if it is not driving."""
        drive = self.drive
        if drive is None or drive.paused:
            raise RequestError("it is not driving")
        self._send(drive, drive.below)

    def lost(self, goal: Goal, why: str) -> None:
        """A goal's client is cut off: the goal ends."""
        drive = self.drive
        if drive is not None and drive.goal is goal:
            if drive.below is not None:
                drive.below.cancel()
            self._finish(drive, GoalState.ABORTED, Fault.OTHER, why)  # it is asked to stop until it does

    def _give_up(self, why: str) -> None:
        """End the drive once the planner has let go of its goal, or the base stands."""
        drive = self.drive
        if drive is None or drive.stopping:
            return
        drive.stopping, drive.held_at = why, time.monotonic()
        if drive.goal is not None:
            drive.goal.begin_cancel()  # its client sees it CANCELING for as long as that takes
        if drive.below is not None:
            drive.below.cancel()
        elif drive.let_go:
            # the action's server tells of the cancellation first
            self._host.loop.post(lambda: self._finish(drive, GoalState.CANCELED, Fault.OTHER, why))
            return
        self._changed()

    def _unpause(self) -> None:
        if self._pause is not None:
            self._pause.close()
            self._pause = None

    def _on_map(self, target: Target) -> Target:
        """A target in the map's frame, where it is known how: where the robot is does not change what it means."""
        frame = self.frame
        if target.frame == frame:
            return target
        try:
            return Target(self._frames.on_map(target.frame) @ target.pose, frame, target.tree)
        except FramesError:
            return target

    # -- the planner's side --------------------------------------------------------------------------------------------

    def _send(self, drive: ClientDrive, before: SentGoal | None) -> None:
        """Give the planner a drive's goal, in place of one that it has."""
        if not self.link.ready:
            self._wait(drive)
            return
        self._stopping.stop = None  # the planner gives up the goals before this one for it, and is asked to as well
        drive.taken, drive.waiting, drive.let_go, drive.sent_at = drive.begun, False, False, time.monotonic()
        goal = drive.target.goal(self.planner, self.robot())
        drive.sent = self.link.send(
            goal,
            lambda sent, result, why: self._ended(drive, sent, result, why),
            lambda heard: self._heard(drive, heard),
        )
        if before is not None:
            # planners end the old goal themselves; one that does several at a time is told
            self._host.loop.after(REPLACED_SECONDS, lambda: before.cancel() if before.active else None)
        self._changed()

    def _go_on(self, drive: ClientDrive) -> None:
        if self.drive is drive and drive.paused and not drive.stopping:
            self._unpause()
            drive.paused, drive.asked_at = False, time.monotonic()
            self._send(drive, None)

    def _wait(self, drive: ClientDrive) -> None:
        """The planner is not there: wait for it for a while from when it was last seen, or wanted."""
        drive.waiting = True
        over = time.monotonic() - max(self.link.seen_at, drive.asked_at) - self._choice.section.patience
        if over >= (COMING_SECONDS if self.link.coming_up else 0.0):
            why = f"the planner {self.planner} is not there"
            if not drive.begun:
                why += f", and was waited for {self._choice.section.patience:g} s long: ask again once it is"
            self._finish(drive, GoalState.ABORTED, Fault.NO_NAVIGATOR, why)
        self._changed()

    def _look(self) -> None:
        self.link.look()  # first: what was stopped is to be, before anything else
        self.motion.look()
        if self.link.gone is not None and self.motion.stands(self.link.gone[1]):
            self.link.give_up_gone()
        self._look_at_stop()
        drive = self.drive
        if drive is not None and drive.waiting and not drive.paused and not drive.stopping:
            self._send(drive, None)
        self._settle()
        self._changed()

    def _look_at_stop(self) -> None:
        end, drive = self._stopping.look(self.drive, self.link), self.drive
        if end is not None and drive is not None:
            self._finish(drive, *end)

    def _heard(self, drive: ClientDrive, feedback: Mapping[str, Any]) -> None:
        if self.drive is not drive or drive.goal is None or drive.paused:
            return
        spent = duration(time.monotonic() - drive.began)  # of the client's goal, also of its pauses
        told = {**feedback, "navigation_time": spent}
        other = self._choice.section.others.get(self.planner)
        if other is not None and other.side == "ros1":  # MoveBase has where it is, and nothing else
            goal = drive.target.pose if drive.target.frame == self.frame else None
            left = distance(self.robot(), goal, self.link.path, self.frame)
            told |= {"distance_remaining": left, "estimated_time_remaining": seconds(left, self.motion.speed)}
        drive.goal.feedback(told)

    def _ended(self, drive: ClientDrive, sent: SentGoal, result: Mapping[str, Any] | None, why: str) -> None:
        """The planner's goal ended."""
        if self.drive is not drive or drive.sent is not sent:
            return  # another one has taken its place
        said = str((result or {}).get("error_msg", "")) or why
        code = int((result or {}).get("error_code", 0))
        drive.let_go = drive.let_go or bool(code) or sent.status in (GoalState.SUCCEEDED, GoalState.CANCELED)
        if sent.status is GoalState.SUCCEEDED:
            self._reached(drive)
        elif drive.stopping and drive.let_go:
            self._finish(drive, GoalState.CANCELED, Fault.OTHER, drive.stopping)
        elif drive.paused and drive.let_go:
            self._changed()
        elif sent.status is GoalState.CANCELED:
            self._finish(drive, GoalState.CANCELED, code or Fault.OTHER, said or self._elsewhere("canceled it"))
        elif code:
            self._finish(drive, GoalState.ABORTED, code, said or self._elsewhere("gave it up"))
        else:
            self._host.loop.after(DOUBTFUL_SECONDS, lambda: self._judge(drive, sent, said))

    def _judge(self, drive: ClientDrive, sent: SentGoal, said: str) -> None:
        """The planner gave no code: it is one of actionlib's, which has texts alone, or a bridge says it is gone."""
        if self.drive is not drive or drive.sent is not sent:
            return
        lost = self.link.lost_at
        gone = not self.link.ready or lost > drive.sent_at
        drive.let_go = drive.let_go or not gone
        if drive.paused or drive.stopping:
            self._look_at_stop()
            self._changed()
        elif not self.link.ready:
            self._wait(drive)
        elif lost > drive.sent_at or (sent.accepted is False and time.monotonic() < lost + SETTLING_SECONDS):
            self._send(drive, None)  # it is back already, or its bridge was about to lose it
        elif sent.accepted is False:
            self._finish(drive, GoalState.ABORTED, Fault.BAD_GOAL, f"{self.planner} rejected the goal")
        else:
            self._finish(drive, GoalState.ABORTED, Fault.OTHER, said or self._elsewhere("gave it up"))

    def _elsewhere(self, what: str) -> str:
        by = " for a goal that it was given itself" if self.link.others else ""
        return f"{self.planner} {what}{by}"

    def _reached(self, drive: ClientDrive) -> None:
        if drive.at + 1 == len(drive.targets):
            self._finish(drive, GoalState.SUCCEEDED, Fault.NONE, "")
        elif drive.stopping:
            self._finish(drive, GoalState.CANCELED, Fault.OTHER, drive.stopping)
        else:
            drive.at += 1
            if not drive.paused:
                self._send(drive, None)

    def _finish(self, drive: ClientDrive, status: GoalState, code: int, why: str) -> None:
        if self.drive is not drive:
            return
        self.drive = None
        self.ended[_OUTCOMES.get(status, "failed")] += 1
        if not drive.let_go:
            since = drive.held_at if drive.stopping or drive.paused else time.monotonic()
            self._stopping.stop = UnconfirmedStop(why, since)
            self._look_at_stop()
        self._unpause()
        self._last = {
            GoalState.SUCCEEDED: PlannerStatus(State.REACHED),
            GoalState.CANCELED: PlannerStatus(State.IDLE, why),
        }.get(status, PlannerStatus(State.ABORTED, why, int(code)))
        self.link.ended = None
        if status is GoalState.ABORTED:
            self._host.log.warning("the goal of %s is aborted: %s", drive.who, why)
        drive.end(status, code, why)
        self._settle()
        self._changed()

    def _settle(self) -> None:
        """Take up another planner that was waited for."""
        if self._choice.settle(driving=self.driving, stop=self._stopping.stop):
            self._stopping.stop = None

    def close(self) -> None:
        """Give up what is under way."""
        drive = self.drive
        if drive is not None:
            if drive.below is not None:
                drive.below.cancel()
            self._finish(drive, GoalState.ABORTED, Fault.OTHER, "the gateway is stopping")

    # -- how it gets on ------------------------------------------------------------------------------------------------

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
