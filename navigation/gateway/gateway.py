"""The gateway: executes requests from clients on every side, and reports to them."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from bridge.config.sections.navigation import NavigationSection
from bridge.messages.actions import GoalState
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from navigation.frames import FramesError, Localized, RobotFrames
from navigation.gateway.choice import PlannerChoice, RequestError
from navigation.gateway.drive import ClientDrive
from navigation.gateway.execution import Execution, robot_pose
from navigation.gateway.machine import DriveEvent, DriveState
from navigation.gateway.motion import STALL_SECONDS, Motion, VelocityWatch
from navigation.gateway.planner_link import PlannerLink
from navigation.gateway.stop import ANSWER_SECONDS, StopOrder
from navigation.gateway.targets import Target, TargetError, targets_of
from navigation.gateway.words import Situation, derive, own_client, trouble, unconfirmed
from navigation.messages import Message
from navigation.pose import Pose
from navigation.status import Fault, PlannerStatus, State, status_message

_POLL_SECONDS = 0.1
BETWEEN_MAPS = "robot_path_planner"
"""The planner that also drives to other maps, through links; a goal on another map has that map's name as frame."""


class Gateway:
    """Executes clients' requests, one drive at a time. Used only on the module's thread.

    `navigation.gateway.machine` defines its states; `navigation.gateway.words` derives every answer from them.
    """

    def __init__(
        self,
        host: Host,
        section: NavigationSection,
        frames: RobotFrames,
        publish: Callable[[Message], None],  # called with each new status (``midspan_msgs/NavigationStatus``)
        hold: Callable[[bool], None],  # called with whether the planner's velocities must not reach the base
    ) -> None:
        self._host, self._frames = host, frames
        self._publish, self._hold = publish, hold
        self.motion = Motion(frames, host.clock.now_ns, simulated=host.clock.simulated)
        self._localized = Localized(host)
        self._order = StopOrder(self.motion, VelocityWatch(host, section.velocity))
        self._choice = PlannerChoice(host, section, self._on_change)
        self.execution = Execution(
            host,
            self._choice,
            frames,
            self.motion,
            self._order,
            self._on_change,
            lambda: unconfirmed(self._situation()),
        )
        self._reported: tuple[Any, ...] = ()
        self._status = PlannerStatus()
        self.held = False  # whether the planner's velocities must not reach the base
        self._status = derive(self._situation())  # unknown, not idle
        self._polled_at = time.monotonic()
        host.loop.every(_POLL_SECONDS, self.poll)

    @property
    def drive(self) -> ClientDrive | None:
        """The current drive of a client."""
        return self.execution.drive

    @property
    def ended(self) -> dict[str, int]:
        """The number of drives by their result; refused: goals without a valid pose."""
        return self.execution.ended

    @property
    def link(self) -> PlannerLink:
        """The current planner."""
        return self._choice.link

    @property
    def planner(self) -> str:
        """The current planner's name."""
        return self.link.planner

    @property
    def frame(self) -> str:
        """The map's frame."""
        return self._choice.section.frame

    @property
    def choices(self) -> tuple[str, ...]:
        """The planners that can be chosen."""
        return self._choice.section.choices

    @property
    def pending(self) -> str:
        """The planner that takes over when the robot stands still; "" for none."""
        return self._choice.pending

    @property
    def planner_has_action(self) -> bool:
        """Whether the planner, or one that takes over, serves the gateway's action itself."""
        return self._choice.has_action

    @property
    def driving(self) -> bool:
        """Whether there is a drive, or the planner has a goal from its own clients."""
        return self.execution.driving

    @property
    def has_base(self) -> bool:
        """Whether the planner commands the base, or may do so."""
        drive = self.drive
        return self.driving and not (drive is not None and drive.state is DriveState.PAUSED)

    def robot(self) -> Pose | None:
        """Return the robot's pose on the map, None if it is unknown."""
        return robot_pose(self._frames)

    # -- requests of clients -------------------------------------------------------------------------------------------

    def accept_goal(self, goal: Goal) -> bool:
        """Accept a goal of one of the actions; it replaces any other, but an invalid goal is aborted at once."""
        try:
            targets = targets_of(goal.goal)
        except TargetError as err:
            self.ended["refused"] += 1
            # not a rejection, which could not give a reason
            goal.abort({"error_code": int(Fault.BAD_GOAL), "error_msg": str(err)})
            return True
        self.execution.begin(targets, "a client of the action", goal=goal)
        return True

    def cancel_goal(self, goal: Goal) -> bool:
        """Cancel a client's goal at its request."""
        if self.drive is not None and self.drive.goal is goal:
            self.execution.stop_drive("the client canceled it")
        return True

    def go(self, places: Sequence[Target], client: str, name: str = "") -> None:
        """Drive to places of the store in turn.

        Raises `RequestError` if a place is on another map and the planner cannot drive there.
        """
        elsewhere = [place.frame for place in places if place.frame != self.frame]
        if elsewhere and self.planner != BETWEEN_MAPS:
            raise RequestError(f"it is on the map {elsewhere[0]}; {self.planner} only knows the map in use")
        self.execution.begin(places, client, name)

    def stop(self) -> str:
        """Stop the robot: cancel all goals of the planner, including goals of clients that bypass the gateway.

        Returns a message; `when_confirmed` reports whether the robot stands still.
        """
        foreign, motion, drive = self.link.foreign, self.link.motion, self.drive
        self.link.end_all()
        if drive is not None:
            self.execution.stop_drive("it was stopped")
        elif self.execution.last.state is not State.IDLE:
            self.execution.last = PlannerStatus()  # how the last drive ended no longer matters
        self._order.ask("it was stopped")
        self.execution.advance()
        self._on_change()
        if drive is not None:
            return "the goal is canceled"
        if foreign:
            return f"the goals that {self.planner} received from its own clients are canceled"
        return f"the goals of {', '.join(motion)} are canceled" if motion else "no active goal"

    def when_confirmed(self, answer: Callable[[str], None]) -> None:
        """Call ``answer`` once: with "" when the stop or pause is confirmed, or with the reason why it is not.

        The reason is given after `ANSWER_SECONDS`, or when a new goal replaces the stop.
        """
        self._order.waiters.add(answer, ANSWER_SECONDS)
        self._order.waiters.notify(trouble(self._situation()))

    def choose(self, planner: str) -> str:
        """Select another planner; returns a message that says when it takes over, "" if it already has.

        Raises `RequestError` if the planner is unknown, or the current planner is driving.
        """
        self._choice.choose(planner, driving=self.driving)
        self.execution.settle()
        self._on_change()
        return f"as soon as {self.planner} has released its goal" if self.pending else ""

    def configure(self, section: NavigationSection) -> None:
        """Use another section, from the end of the current drive on if it changes the planners."""
        self._choice.configure(section)
        self.execution.settle()
        self._on_change()

    def client_lost(self, goal: Goal, reason: str) -> None:
        """End a goal whose client is unreachable."""
        drive = self.drive
        if drive is not None and drive.goal is goal:
            self.execution.cancel(drive)
            self.execution.finish(drive, GoalState.ABORTED, Fault.OTHER, reason)

    def shut_down(self, done: Callable[[], None]) -> None:
        """Stop everything that the gateway started, and call ``done`` when that is confirmed, or takes too long."""
        drive = self.drive
        if drive is None:
            done()
            return
        self.execution.stop_drive("the gateway is shutting down")
        self.when_confirmed(lambda _trouble: done())

    def close(self) -> None:
        """End the drive."""
        drive = self.drive
        if drive is not None:
            self.execution.cancel(drive)
            reason = drive.reason if drive.state is DriveState.STOPPING else "the gateway is shutting down"
            self.execution.finish(
                drive, GoalState.ABORTED, Fault.MAY_MOVE, f"{reason}; {unconfirmed(self._situation())}"
            )

    def poll(self) -> None:
        """Read the state of planner and base, and act on it; called about ten times a second."""
        self._excuse_stall()
        self.motion.poll()
        self.link.refresh(self.motion)  # first, so that cancel requests are sent before anything else
        self.execution.poll()
        self._on_change()

    def _excuse_stall(self) -> None:
        """Count time for which this process stood still as one period, because the messages of that time are unread."""
        now = time.monotonic()
        passed, self._polled_at = now - self._polled_at, now
        if passed > STALL_SECONDS:
            for judged in (self.link.presence, self._order, self.drive):
                if judged is not None:
                    judged.excuse(passed - _POLL_SECONDS)

    # -- reports -------------------------------------------------------------------------------------------------------

    def _situation(self) -> Situation:
        drive, link, order, foreign = self.drive, self.link, self._order, self.link.foreign
        telemetry, silence = link.telemetry, self._choice.section.silence
        # the daemon watches Midspan's own planners
        silent = silence if silence and not link.ours and telemetry.silent > silence else 0.0
        sent = drive.sent.id if drive is not None and drive.sent is not None else b""
        return Situation(
            planner=self.planner,
            planner_state=link.state,
            planner_age=link.presence.machine.age,
            base=self.motion.base(link.motion_since),  # a base that stood earlier may move now
            goals=link.goals,
            doubtful=link.foreign_goals.doubtful is not None,
            motion=link.motion,
            foreign=self._of_foreign(foreign[-1]) if foreign else None,
            unlisted=link.unlisted,
            orphans=link.orphans,
            drive=None if drive is None else drive.state,
            reason="" if drive is None else drive.reason,
            unreleased=drive is not None and not drive.released,
            reported=self._published_status(sent),
            silence=silent,
            localization="" if link.ours else self._localization(),
            stop=order.state,
            stop_reason=order.reason,
            stop_age=order.age,
            odometry=self.motion.known,
            since_end=time.monotonic() - self.execution.ended_at,
            last=self.execution.last,
        )

    def _published_status(self, goal: bytes) -> PlannerStatus | None:
        reported = self.link.telemetry.reported(goal)
        return None if reported is None else PlannerStatus(*reported, self.link.telemetry.code(goal))

    def _of_foreign(self, goal: bytes) -> PlannerStatus:
        reported = self._published_status(goal) or PlannerStatus(State.MOVING)
        return reported._replace(reason=reported.reason or own_client(self.planner))

    def _localization(self) -> str:
        try:
            self._localized.check()
        except FramesError as err:
            return str(err)
        return ""

    def state(self) -> PlannerStatus:
        """Return the state with its reason, as last published; may be called on any thread."""
        return self._status

    def status(self) -> Message:
        """Return the status as a ``midspan_msgs/NavigationStatus``."""
        drive, foreign, stamp = self.drive, self.link.foreign, self._host.clock.stamp()
        if drive is not None:
            goal = drive.target.stamped(self.robot())
            return status_message(stamp, self._status, goal_id=drive.id, goal=goal)
        if foreign:
            pose = self.link.telemetry.pose(foreign[-1])
            return status_message(stamp, self._status, goal_id=foreign[-1], goal=pose)
        return status_message(stamp, self._status)

    def _on_change(self) -> None:
        """Publish the status if it has changed, and answer the clients that wait for a stop."""
        end, drive = self.link.foreign_goals.end, self.drive
        if drive is not None and drive.sent is not None and drive.sent.active and drive.sent.accepted:
            drive.machine.on(DriveEvent.ACCEPTED)
        if drive is None and end is not None and not self.link.foreign:
            reported = self.link.telemetry.reported(end.goal)
            reason = end.reason or (reported[1] if reported else "") or own_client(self.planner)
            self.execution.last = PlannerStatus(end.state, reason, self.link.telemetry.code(end.goal))
            self.link.foreign_goals.end = None
        situation = self._situation()
        self._status = derive(situation)
        goal = None if drive is not None else self.link.foreign[-1:]
        key = (*self._status, drive and drive.id, drive and drive.at, goal)
        if key != self._reported:
            self._reported = key
            self._publish(self.status())
        held = self._order.state.held
        if held != self.held:
            self.held = held
            self._hold(held)
        self._order.waiters.notify(trouble(situation))
