"""What the gateway does with goals, whoever's they are: over one planner, with pauses, repetitions and reasons."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bridge.config.sections.navigation import NavigationSection
from bridge.modules.action_client import SentGoal
from bridge.modules.action_server import Goal
from bridge.modules.goal import Status
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from navigation.frames import Frames, FramesError
from navigation.gateway.drive import Drive, Target, TargetError, target_of
from navigation.gateway.link import Link
from navigation.gateway.standing import Standing, of_drive, of_ended, of_others
from navigation.pose import Pose
from navigation.status import Fault, State, status_message

DOUBTFUL_SECONDS = 0.5
"""After an end that the planner gave no error code for, so long is looked whether it is there at all."""

SETTLING_SECONDS = 5.0
"""A rejection of a planner that came so lately is not believed: it is asked again."""

CANCEL_SECONDS = 5.0
"""After so long without an answer to a cancellation the client is told that it ended."""

LETTING_GO_SECONDS = 30.0
"""For so long another planner waits for one that does not let go of a goal that ended here, and is asked to."""

_LOOK_SECONDS = 0.1
_BETWEEN_MAPS = "robot_path_planner"
"""The planner that drives to other maps, through links: there the goal's frame is the map's name."""

Message = dict[str, Any]


class RefusedError(RuntimeError):
    """What was asked for cannot be done now; the text says why."""


class Gateway:
    """Gives goals to the chosen planner, and tells its clients how they get on. All on the module's thread.

    Args:
        host: the module's.
        section: of the configuration.
        frames: where the robot is.
        changed: called with each new status (``midspan_msgs/NavigationStatus``).
    """

    def __init__(
        self, host: Host, section: NavigationSection, frames: Frames, changed: Callable[[Message], None]
    ) -> None:
        self._host, self._section, self._frames, self._tell = host, section, frames, changed
        self.drive: Drive | None = None
        self.planner, self._chosen = section.planner, ""
        self._next: NavigationSection | None = None
        self._last = Standing(State.IDLE)
        self._said: tuple[Any, ...] = ()
        self._pause: Timer | None = None
        self._held_since: float | None = None
        self.link = Link(host, section, self.planner, self._changed)
        host.loop.every(_LOOK_SECONDS, self._look)

    # -- what clients ask for ------------------------------------------------------------------------------------------

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

    def lost(self, goal: Goal, why: str) -> None:
        """A goal's client is cut off: the goal ends."""
        drive = self.drive
        if drive is not None and drive.goal is goal:
            if drive.below is not None:
                drive.below.cancel()
            self._finish(drive, Status.ABORTED, Fault.OTHER, why)

    def begin(self, targets: Sequence[Target], who: str, name: str = "", goal: Goal | None = None) -> Drive:
        """Drive somewhere, instead of where it was driving to."""
        before, self.drive = self.drive, Drive([self._on_map(one) for one in targets], who, goal, name)
        self._unpause()
        if before is not None:
            before.end(Status.CANCELED, Fault.OTHER, f"{who} gave another goal, which took its place")
        if goal is not None:
            goal.execute()
        self._send(self.drive, None if before is None else before.below)
        return self.drive

    def go(self, places: Sequence[Target], who: str, name: str = "") -> None:
        """Drive to places of the store, one after the other.

        Raises:
            RefusedError: one is on another map than the one in use, and the planner knows no way there.
        """
        elsewhere = [one.frame for one in places if one.frame != self.frame]
        if elsewhere and self.planner != _BETWEEN_MAPS:
            raise RefusedError(f"it is on the map {elsewhere[0]}; {self.planner} knows only the one that is in use")
        self.begin(places, who, name)

    def pause(self, seconds: float = float("inf")) -> None:
        """Stand still; the client's goal stays active.

        Raises:
            RefusedError: there is nothing to pause.
        """
        drive = self.drive
        if drive is None:
            if self.link.others:
                raise RefusedError(
                    f"the goal was given to {self.planner} itself and is not known here; stop can end it, not pause it"
                )
            raise RefusedError("there is no goal to pause")
        self._unpause()
        drive.paused, drive.waiting_until = True, None
        if seconds < 1e6:
            self._pause = self._host.loop.after(seconds, lambda: self._go_on(drive))
        if drive.below is not None:
            drive.below.cancel()
        self._changed()

    def resume(self) -> None:
        """Go on: the goal is sent again.

        Raises:
            RefusedError: it is not paused.
        """
        drive = self.drive
        if drive is None or not drive.paused:
            raise RefusedError("nothing is paused")
        self._go_on(drive)

    def recompute(self) -> None:
        """Have the planner find the way anew: the goal is sent again, and takes its own place.

        Raises:
            RefusedError: it is not driving.
        """
        drive = self.drive
        if drive is None or drive.paused:
            raise RefusedError("it is not driving")
        self._send(drive, drive.below)

    def stop(self) -> str:
        """Have the planner give up all goals, also those that others gave it; what was done, in words."""
        others = len(self.link.others)
        self.link.cancel_all()  # also what is not in its list yet
        if self.drive is not None:
            self._give_up("it was stopped")
            return "the goal is canceled"
        if not others:
            self._last = Standing(State.IDLE)
            self._changed()
        return f"the goals that {self.planner} was given itself are canceled" if others else "there was no goal"

    def choose(self, planner: str) -> str:
        """Have another planner drive; what it waits for, in words.

        Raises:
            RefusedError: there is none of the name, or it is driving.
        """
        if planner not in self.choices:
            raise RefusedError(f"there is no planner {planner!r}; there are {', '.join(self.choices)}")
        if planner != self.planner and self.driving:
            raise RefusedError(f"{self.planner} is driving; stop it first")
        self._chosen = planner
        self._next = self._next or self._section
        self._settle()
        self._changed()
        return f"once {self.planner} has let go of its goal" if self.pending else ""

    def configure(self, section: NavigationSection) -> None:
        """Take up another section; at the end of the drive where there is one.

        A planner that was chosen meanwhile stays, unless the section names another one than before.
        """
        if section.planner != (self._next or self._section).planner:
            self._chosen = ""
        self._next = section
        self._settle()
        self._changed()

    # -- what is known -------------------------------------------------------------------------------------------------

    @property
    def driving(self) -> bool:
        """Whether the planner has a goal, from here or from others."""
        return self.drive is not None or bool(self.link.others)

    @property
    def has_base(self) -> bool:
        """Whether the planner commands the base, or may."""
        drive = self.drive
        return self.driving and not (drive is not None and drive.paused and drive.below is None)

    @property
    def frame(self) -> str:
        """The map's frame."""
        return self._section.frame

    @property
    def choices(self) -> tuple[str, ...]:
        """The planners that can be chosen."""
        return self._section.choices

    @property
    def pending(self) -> str:
        """The planner that is to drive once the one that drives now stands; "" where there is none such."""
        return "" if self._next is None else self._wanted(self._next)

    def robot(self) -> Pose | None:
        """Where the robot is on the map, None where that is not known."""
        try:
            return self._frames.pose()
        except FramesError:
            return None

    def state(self) -> Standing:
        """How it is getting on."""
        if self.drive is not None:
            return of_drive(self.drive, self.link)
        others = self.link.others
        return of_others(self.link, others[-1]) if others else self._last

    def status(self) -> Message:
        """The same as a ``midspan_msgs/NavigationStatus``."""
        drive, others = self.drive, self.link.others
        said = (self._host.clock.stamp(), *self.state())
        if drive is not None:
            return status_message(*said, goal_id=drive.id, goal=drive.target.stamped(self.robot()))
        if others:
            return status_message(*said, goal_id=others[-1], goal=self.link.pose(others[-1]))
        return status_message(*said)

    # -- the planner's side --------------------------------------------------------------------------------------------

    def _send(self, drive: Drive, before: SentGoal | None) -> None:
        """Give the planner a drive's goal, in place of one that it has."""
        if not self.link.ready:
            self._wait(drive)
            return
        drive.waiting_until, drive.sent_at = None, time.monotonic()
        goal = drive.target.goal(self.planner, self.robot())
        drive.sent = self.link.send(
            goal,
            lambda sent, result, why: self._ended(drive, sent, result, why),
            lambda heard: self._heard(drive, heard),
        )
        if before is not None:
            # planners end the old goal themselves; one that does several at a time is told
            self._host.loop.after(CANCEL_SECONDS, lambda: before.cancel() if before.active else None)
        self._changed()

    def _go_on(self, drive: Drive) -> None:
        if self.drive is drive and drive.paused and not drive.stopping:
            self._unpause()
            drive.paused = False
            self._send(drive, None)

    def _wait(self, drive: Drive) -> None:
        """The planner is not there: wait for it for a while."""
        now = time.monotonic()
        if drive.waiting_until is None:
            drive.waiting_until = now + self._section.patience
        if now >= drive.waiting_until:
            self._finish(drive, Status.ABORTED, Fault.NO_NAVIGATOR, f"the planner {self.planner} is not there")
        self._changed()

    def _look(self) -> None:
        drive = self.drive
        if drive is not None and drive.waiting_until is not None and not drive.paused:
            self._send(drive, None)
        self.link.look()
        self._settle()
        self._changed()

    def _heard(self, drive: Drive, feedback: Mapping[str, Any]) -> None:
        if self.drive is drive and drive.goal is not None and not drive.paused:
            seconds, rest = divmod(time.monotonic() - drive.began, 1.0)
            spent = {"sec": int(seconds), "nanosec": int(rest * 1e9)}  # of the client's goal, also of its pauses
            drive.goal.feedback({**feedback, "navigation_time": spent})

    def _ended(self, drive: Drive, sent: SentGoal, result: Mapping[str, Any] | None, why: str) -> None:
        """The planner's goal ended."""
        if self.drive is not drive or drive.sent is not sent:
            return  # another one has taken its place
        said = str((result or {}).get("error_msg", "")) or why
        code = int((result or {}).get("error_code", 0))
        if sent.status is Status.SUCCEEDED:
            self._reached(drive)
        elif drive.stopping:
            self._finish(drive, Status.CANCELED, Fault.OTHER, drive.stopping)
        elif drive.paused:
            self._changed()
        elif sent.status is Status.CANCELED:
            self._finish(drive, Status.CANCELED, code or Fault.OTHER, said or self._elsewhere("canceled it"))
        elif code:
            self._finish(drive, Status.ABORTED, code, said or self._elsewhere("gave it up"))
        else:
            self._host.loop.after(DOUBTFUL_SECONDS, lambda: self._judge(drive, sent, said))

    def _judge(self, drive: Drive, sent: SentGoal, said: str) -> None:
        """The planner gave no code: it is one of actionlib's, which has texts alone, or a bridge says it is gone."""
        if self.drive is not drive or drive.sent is not sent or drive.paused or drive.stopping:
            return
        lost = self.link.lost_at
        if not self.link.ready:
            self._wait(drive)
        elif lost > drive.sent_at or (sent.accepted is False and time.monotonic() < lost + SETTLING_SECONDS):
            self._send(drive, None)  # it is back already, or its bridge was about to lose it
        elif sent.accepted is False:
            self._finish(drive, Status.ABORTED, Fault.BAD_GOAL, f"{self.planner} rejected the goal")
        else:
            self._finish(drive, Status.ABORTED, Fault.OTHER, said or self._elsewhere("gave it up"))

    def _elsewhere(self, what: str) -> str:
        by = " for a goal that it was given itself" if self.link.others else ""
        return f"{self.planner} {what}{by}"

    def _reached(self, drive: Drive) -> None:
        if drive.at + 1 == len(drive.targets):
            self._finish(drive, Status.SUCCEEDED, Fault.NONE, "")
        elif drive.stopping:
            self._finish(drive, Status.CANCELED, Fault.OTHER, drive.stopping)
        else:
            drive.at += 1
            if not drive.paused:
                self._send(drive, None)

    def _give_up(self, why: str) -> None:
        """End the drive once the planner has let go of its goal."""
        drive = self.drive
        if drive is None or drive.stopping:
            return
        drive.stopping = why
        below = drive.below
        if below is None:
            # the action's server tells of the cancellation first
            self._host.loop.post(lambda: self._finish(drive, Status.CANCELED, Fault.OTHER, why))
            return
        below.cancel()
        late = f"{why}; {self.planner} has not answered"
        self._host.loop.after(CANCEL_SECONDS, lambda: self._finish(drive, Status.CANCELED, Fault.OTHER, late))
        self._changed()

    def _finish(self, drive: Drive, status: Status, code: int, why: str) -> None:
        if self.drive is not drive:
            return
        self.drive = None
        self._unpause()
        self._last = {
            Status.SUCCEEDED: Standing(State.REACHED),
            Status.CANCELED: Standing(State.IDLE, why),
        }.get(status, Standing(State.ABORTED, why, int(code)))
        self.link.ended = None
        if status is Status.ABORTED:
            self._host.log.warning("the goal of %s is aborted: %s", drive.who, why)
        drive.end(status, code, why)
        self._settle()
        self._changed()

    # -- its own -------------------------------------------------------------------------------------------------------

    def _on_map(self, target: Target) -> Target:
        """A target in the map's frame, where it is known how: where the robot is does not change what it means."""
        frame = self._section.frame
        if target.frame == frame:
            return target
        try:
            return Target(self._frames.on_map(target.frame) @ target.pose, frame, target.tree)
        except FramesError:
            return target

    def _wanted(self, section: NavigationSection) -> str:
        """Who is to drive by a section."""
        return self._chosen if self._chosen in section.choices else section.planner

    def _settle(self) -> None:
        """Take up a section that waited for the end of a drive, and for the planner to let go."""
        section = self._next
        if section is None:
            return
        planner = self._wanted(section)
        same = planner == self.planner and section.others == self._section.others
        if not same and (self.driving or self._holds_on()):
            return
        self._section, self._next = section, None
        if not same:
            self._link_to(planner)

    def _holds_on(self) -> bool:
        """Whether the planner still drives to a goal that ended here: without the link nobody would ask it to stop."""
        if not self.link.holds_on:
            self._held_since = None
            return False
        now = time.monotonic()
        if self._held_since is None:
            self._held_since = now
        return now < self._held_since + LETTING_GO_SECONDS

    def _link_to(self, planner: str) -> None:
        if self._held_since is not None:
            self._host.log.warning("%s has not let go of its goal for %g s", self.planner, LETTING_GO_SECONDS)
            self._held_since = None
        self.link.close()
        self.planner = planner
        self.link = Link(self._host, self._section, planner, self._changed)
        self._host.log.info("%s is the planner now", planner)
        self._changed()

    def _unpause(self) -> None:
        if self._pause is not None:
            self._pause.close()
            self._pause = None

    def _changed(self) -> None:
        """Tell the status, where it is another one."""
        if self.drive is None and not self.link.others and self.link.ended is not None:
            self._last, self.link.ended = of_ended(self.link, *self.link.ended), None
        drive = self.drive
        said = (*self.state(), drive and drive.id, drive and drive.at, None if drive else tuple(self.link.others[-1:]))
        if said != self._said:
            self._said = said
            self._tell(self.status())

    def close(self) -> None:
        """Give up what is under way."""
        drive = self.drive
        if drive is not None:
            if drive.below is not None:
                drive.below.cancel()
            self._finish(drive, Status.ABORTED, Fault.OTHER, "the gateway is stopping")
