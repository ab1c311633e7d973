"""Sends a client's drive to the planner, one goal at a time, and follows the drive to its end."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bridge.client.actions import SentGoal
from bridge.messages.actions import GoalState
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from bridge.modules.loop import Timer
from navigation import nav2_errors
from navigation.frames import FramesError, RobotFrames
from navigation.gateway.choice import PlannerChoice, RequestError
from navigation.gateway.drive import ClientDrive
from navigation.gateway.machine import DriveEvent, DriveState, PlannerState, StopState
from navigation.gateway.motion import Base, Motion
from navigation.gateway.planner_link import PlannerLink
from navigation.gateway.progress import distance, seconds
from navigation.gateway.stop import GIVE_UP_SECONDS, StopOrder
from navigation.gateway.targets import Target, goal_through
from navigation.gateway.words import MAY_MOVE, own_client
from navigation.messages import duration
from navigation.pose import Pose
from navigation.status import Fault, PlannerStatus, State

JUDGING_SECONDS = 0.5
"""Within this time, the planner's goal list may show why a goal ended without an error code."""

SETTLING_SECONDS = 5.0
"""A planner that became reachable less than this time ago may reject goals while starting; they are sent again."""

RETRY_SECONDS = 0.5
"""Time between two attempts to send a goal that the planner cannot accept yet."""

REPLACED_SECONDS = 5.0
"""If a planner still has the old goal this long after it got a new one, it executes both; the old one is canceled."""

COMING_SECONDS = 30.0
"""A goal waits this much longer than `NavigationSection.patience` for a planner whose first parts have appeared."""

_OUTCOMES = {GoalState.SUCCEEDED: "reached", GoalState.CANCELED: "canceled"}
_STOPPING = frozenset((DriveState.PAUSING, DriveState.PAUSED, DriveState.STOPPING))
_ACTIVE = frozenset((DriveState.SENT, DriveState.DRIVING))


class Execution:
    """One drive at a time, and the current stop or pause. Used only on the module's thread.

    `navigation.gateway.machine` defines the states. ``changed`` is called after a change of state; ``unconfirmed``
    returns why the robot is not known to stand still.
    """

    def __init__(
        self,
        host: Host,
        choice: PlannerChoice,
        frames: RobotFrames,
        motion: Motion,
        order: StopOrder,
        changed: Callable[[], None],
        unconfirmed: Callable[[], str],
    ) -> None:
        self._host, self._choice, self._frames, self._motion = host, choice, frames, motion
        self._order, self._changed, self._unconfirmed = order, changed, unconfirmed
        self.drive: ClientDrive | None = None
        self.last, self.ended_at = PlannerStatus(), 0.0  # how the last drive ended, and when (monotonic)
        self._pause: Timer | None = None
        #: the number of clients' drives by outcome; refused: goals without a valid pose
        self.ended = dict.fromkeys(("reached", "failed", "canceled", "replaced", "refused"), 0)

    @property
    def _known_to_stand(self) -> bool:
        """Whether the base stands still or, if its motion is unknown, the planner has no goals."""
        idle = self._link.state in (PlannerState.IDLE, PlannerState.ABSENT) and not self._link.left
        base = self._motion.base()
        return base is Base.STANDING or (idle and base is Base.UNKNOWN)

    @property
    def driving(self) -> bool:
        """Whether there is a drive, or the planner has a goal from its own clients."""
        return self.drive is not None or bool(self._link.foreign)

    @property
    def _link(self) -> PlannerLink:
        return self._choice.link

    @property
    def _planner(self) -> str:
        return self._choice.link.planner

    @property
    def _frame(self) -> str:
        return self._choice.section.frame

    def begin(self, targets: Sequence[Target], client: str, name: str = "", goal: Goal | None = None) -> ClientDrive:
        """Start a drive, which replaces the current one."""
        before, self.drive = self.drive, ClientDrive([self._on_map(target) for target in targets], client, goal, name)
        self._unpause()
        if before is not None:
            self.drive.replace(before)
            self.ended["replaced"] += 1
            before.end(GoalState.CANCELED, Fault.OTHER, f"{client} gave another goal, which replaced it")
        if goal is not None:
            goal.execute()
        self._send(self.drive, None if before is None else before.sent)
        return self.drive

    def pause(self, seconds: float = float("inf")) -> None:
        """Pause for some seconds after the robot has stopped; the client's goal remains active.

        Raises `RequestError` without a goal.
        """
        drive = self.drive
        if drive is None:
            foreign = f"{own_client(self._planner)} can be stopped, but not paused"
            raise RequestError(foreign if self._link.foreign else "no goal to pause")
        self._unpause()
        drive.pause_seconds = seconds
        if drive.begin_stop(DriveEvent.PAUSE):
            drive.reason = "it was paused"
            self.cancel(drive)
            self._order.ask(drive.reason)
            if drive.released and not drive.begun and self._known_to_stand:
                self._order.drop()
                self._on_paused(drive)
        elif drive.state is DriveState.PAUSED:
            self._on_paused(drive)
            self._order.ask(drive.reason)  # a client that bypasses the gateway may have moved the robot since
        self.advance()
        self._changed()

    def resume(self) -> None:
        """Send the paused goal again; raises `RequestError` if nothing is paused."""
        drive = self.drive
        if drive is None or drive.state not in (DriveState.PAUSING, DriveState.PAUSED):
            raise RequestError("nothing is paused")
        self._resume(drive)

    def recompute(self) -> None:
        """Send the goal again so that the planner plans again; raises `RequestError` if no drive is in progress."""
        drive = self.drive
        if drive is None or drive.state not in (*_ACTIVE, DriveState.WAITING):
            raise RequestError("the robot is not driving")
        self._send(drive, drive.sent)

    def _send(self, drive: ClientDrive, before: SentGoal | None) -> None:
        """Send a drive's goal to the planner, replacing its current one, or wait until it accepts goals."""
        now = time.monotonic()
        if not self._link.reachable or now < drive.due:
            if before is not None and before is not drive.sent:
                self._link.end(before)
            self._give_up_waiting(drive)
            self._changed()
            return
        several = self._passes(drive)
        if self._link.other_goals(drive.unlisted, several=several):
            if before is not None:
                self._link.end(before)
            drive.reason = f"waiting until {self._planner} has ended its previous goal"
            self._changed()
            return
        if self._order.state is not StopState.NONE:
            # this goal replaces the planner's earlier goals, which are also canceled
            self._order.drop(f"{MAY_MOVE}: {drive.client} gave another goal")
        drive.machine.on(DriveEvent.SEND)
        drive.released, drive.path_canceled, drive.sent_at, drive.reason = False, False, now, ""
        drive.sent, drive.several, robot = None, several, robot_pose(self._frames)
        self._changed()  # the planner must not receive the goal while a status reports that the robot stands
        drive.sent = self._link.send(
            goal_through(drive.left, self._planner, robot) if several else drive.target.goal(self._planner, robot),
            lambda sent, result, reason: self._on_end(drive, sent, result, reason),
            lambda feedback: self._on_feedback(drive, feedback),
            several=several,
        )
        if before is not None:
            if before.active and before not in drive.replaced:
                drive.replaced.append(before)  # the same drive's goal, before it was sent again
            # planners end the old goal by themselves, unless they execute several at a time
            self._host.loop.after(REPLACED_SECONDS, lambda: self._link.end(before))
        self._changed()

    def _passes(self, drive: ClientDrive) -> bool:
        """Whether the planner gets all remaining targets in one goal, and drives through them without stops."""
        same = {(target.frame, target.tree) for target in drive.left} == {(self._frame, drive.target.tree)}
        return (drive.several or len(drive.left) > 1) and same and self._link.passes

    def _resume(self, drive: ClientDrive) -> None:
        if self.drive is drive and drive.machine.on(DriveEvent.RESUME):
            self._unpause()
            drive.asked_at, drive.reason = time.monotonic(), ""
            self._send(drive, None)

    def cancel(self, drive: ClientDrive) -> None:
        """Cancel a drive's unreleased goal and, without foreign goals, the other actions that move the base."""
        for replaced in drive.replaced:
            self._link.end(replaced)
        if drive.released:
            return
        if drive.sent is not None:
            self._link.end(drive.sent)
        if not self._link.foreign:
            drive.path_canceled |= self._link.end_motion()

    def stop_drive(self, reason: str) -> None:
        """End the drive as soon as the planner has released its goal, or the stop is confirmed or takes too long."""
        drive = self.drive
        if drive is None or not drive.begin_stop(DriveEvent.STOP):
            return
        drive.reason = reason
        self._unpause()
        if drive.goal is not None:
            drive.goal.begin_cancel()  # its client sees CANCELING until the end
        if drive.released and not drive.begun:  # the action's server reports the cancellation first
            self._host.loop.post(lambda: self.finish(drive, GoalState.CANCELED, Fault.OTHER, reason))
            return
        self.cancel(drive)
        self._order.ask(reason)
        self._changed()

    def _give_up_waiting(self, drive: ClientDrive) -> None:
        """End a drive if its planner has been unavailable, and its goal pending, for too long."""
        if self._link.reachable:
            return
        patience = self._choice.section.patience
        over = time.monotonic() - max(self._link.presence.seen_at, drive.asked_at) - patience
        if over >= (COMING_SECONDS if self._link.presence.coming_up else 0.0):
            reason = f"the planner {self._planner} was not available for {patience:g} s"
            if not drive.begun:
                reason += "; send the goal again when it is available"
            if drive.begun and self._motion.base() is Base.MOVING:
                self._abort_moving(drive, Fault.NO_NAVIGATOR, reason)
            else:
                self.finish(drive, GoalState.ABORTED, Fault.NO_NAVIGATOR, reason)

    def poll(self) -> None:
        """Update the drive and the stop; called about ten times a second."""
        self.advance()
        if self.drive is not None:
            self._advance_drive(self.drive)
        self.settle()

    def advance(self) -> None:
        """Update the stop or pause, and end a stopped drive once its stop is confirmed or takes too long."""
        drive, order, link = self.drive, self._order, self._link
        if drive is not None and not drive.released and drive.state in _STOPPING:
            drive.released = link.state.reported and not link.left and not link.may_execute(drive.sent)
        released = link.released and (drive is None or drive.released)
        order.update(released=released, seen_at=link.presence.seen_at)
        if not order.state.open:
            link.end_no_more()
        if drive is None:
            return
        if drive.state is DriveState.PAUSING and (order.confirmed or order.state is StopState.EXPIRED):
            self._on_paused(drive)
        elif drive.state is DriveState.PAUSED and order.state in (StopState.ASKED, StopState.SETTLING):
            drive.machine.on(DriveEvent.MOVES)
        elif drive.state is DriveState.STOPPING:
            self._end_stopped(drive)

    def _on_paused(self, drive: ClientDrive) -> None:
        """Start timing the pause: the robot now stands still, or its stop has expired."""
        drive.machine.on(DriveEvent.STANDS)
        if drive.pause_seconds < 1e6 and self._pause is None:
            self._pause = self._host.loop.after(drive.pause_seconds, lambda: self._resume(drive))

    def _end_stopped(self, drive: ClientDrive) -> None:
        order, reason = self._order, drive.reason
        if drive.aborted is not None:
            code, reason = drive.aborted
            if order.confirmed or not order.state.open:
                self.finish(drive, GoalState.ABORTED, code, reason)
            elif order.age > GIVE_UP_SECONDS:
                self.finish(drive, GoalState.ABORTED, code, reason, self._unconfirmed())
        elif drive.released:
            self.finish(drive, GoalState.CANCELED, Fault.OTHER, reason)
        elif order.confirmed:
            text = f"{reason}; {self._planner} has not answered, and the base stands"
            self.finish(drive, GoalState.CANCELED, Fault.OTHER, text)
        elif order.age > GIVE_UP_SECONDS:
            text = f"{reason}; {self._unconfirmed()}"
            self.finish(drive, GoalState.ABORTED, Fault.MAY_MOVE, text)

    def _advance_drive(self, drive: ClientDrive) -> None:
        if drive.state in _ACTIVE and not self._link.reachable:
            drive.machine.on(DriveEvent.CONTACT_LOST)
        if drive.state is DriveState.WAITING:
            self._send(drive, None)
        elif drive.state is DriveState.LOST:
            self._find_again(drive)
        elif drive.state is DriveState.JUDGING:
            self._judge(drive)
        elif drive.sent is not None and drive.sent is drive.followed:
            self._link.ask_again(drive.sent)

    def _find_again(self, drive: ClientDrive) -> None:
        """Follow the goal again if the planner still has it; otherwise send it again."""
        link, sent = self._link, drive.sent
        if not link.reachable or sent is None:
            self._give_up_waiting(drive)
        elif time.monotonic() > drive.due and (link.state.reported or link.presence.machine.age > SETTLING_SECONDS):
            if link.lists(sent) is not None and not drive.forgotten:
                link.follow(sent)
                drive.followed, drive.due = sent, time.monotonic() + RETRY_SECONDS
                drive.machine.on(DriveEvent.RESUMED_CONTACT)
            else:
                drive.released = link.state.reported and not drive.forgotten  # a forgotten goal may still be executed
                drive.machine.on(DriveEvent.RETRY)
                self._send(drive, None)

    def _on_feedback(self, drive: ClientDrive, feedback: Mapping[str, Any]) -> None:
        if self.drive is not drive or drive.state not in _ACTIVE:
            return
        poses = int(feedback.get("number_of_poses_remaining", 0))
        if drive.several and 0 < poses < len(drive.left):
            drive.at = len(drive.targets) - poses
            self._changed()
        if drive.goal is None:
            return
        spent = duration(time.monotonic() - drive.began)  # since the client's goal began, including pauses
        message = {**feedback, "navigation_time": spent}
        other = self._choice.section.others.get(self._planner)
        if other is not None and other.side == "ros1":  # MoveBase reports its pose and nothing else
            goal = drive.target.pose if drive.target.frame == self._frame else None
            left = distance(robot_pose(self._frames), goal, self._link.telemetry.path, self._frame)
            message |= {"distance_remaining": left, "estimated_time_remaining": seconds(left, self._motion.speed)}
        if "poses" in drive.goal.goal:
            message |= {"number_of_poses_remaining": len(drive.left)}
        drive.goal.feedback(message)

    def _on_end(self, drive: ClientDrive, sent: SentGoal, result: Mapping[str, Any] | None, message: str) -> None:
        """Handle the end of the planner's goal, or the loss of contact with the planner."""
        if self.drive is not drive or drive.sent is not sent:
            return  # replaced by another goal
        for replaced in drive.replaced:
            self._link.end(replaced)  # a planner that does not execute the new goal may still execute them
        if result is None and sent.accepted is not False:
            self._link.lose_contact()
            drive.machine.on(DriveEvent.CONTACT_LOST)
        else:
            drive.released = True
            self._on_result(drive, sent, result or {}, message)
        self.advance()
        self._changed()

    def _on_result(self, drive: ClientDrive, sent: SentGoal, result: Mapping[str, Any], message: str) -> None:
        """Handle the result of a goal that the planner itself ended."""
        code = int(result.get("error_code", 0))
        reason = nav2_errors.reason_text(str(result.get("error_msg", "")) or message, code)
        succeeded = sent.status is GoalState.SUCCEEDED
        if drive.state in _STOPPING and (drive.path_canceled or not succeeded):
            return  # `advance` confirms the stop or pause; Nav2 reports success for a goal whose path was canceled
        if succeeded:
            self._on_reached(drive)
        elif sent.accepted is False:
            self._on_rejected(drive)
        elif sent.status is GoalState.CANCELED:
            self.finish(drive, GoalState.CANCELED, code or Fault.OTHER, reason or self._without_reason("canceled"))
        elif nav2_errors.is_missing_transform(code) and self._may_retry(drive):
            drive.reason = f"{self._planner}: {reason}; trying again"
            drive.due = time.monotonic() + RETRY_SECONDS
            drive.machine.on(DriveEvent.RETRY)
        elif code:
            self._abort(drive, code, reason or self._without_reason("aborted"))
        else:
            drive.reason = reason
            drive.machine.on(DriveEvent.ABORTED)

    def _may_retry(self, drive: ClientDrive) -> bool:
        """Whether the patience allows another attempt at a goal that failed because a transform is missing."""
        now, patience = time.monotonic(), self._choice.section.patience
        if not drive.transform_missing_at or now > drive.sent_at + max(patience, 2 * RETRY_SECONDS):
            drive.transform_missing_at = now
        return now < drive.transform_missing_at + patience

    def _on_rejected(self, drive: ClientDrive) -> None:
        """Send the goal again if the planner has just started, and may reject goals; otherwise judge the rejection."""
        if time.monotonic() < self._link.presence.unreachable_at + SETTLING_SECONDS:
            drive.reason = f"{self._planner} has just started and rejected the goal; trying again"
            drive.due = time.monotonic() + RETRY_SECONDS
            drive.machine.on(DriveEvent.RETRY)
            return
        drive.reason = f"{self._planner} rejected the goal"
        if drive.target.frame != self._frame:
            drive.reason += f": {self._frame_trouble(drive.target.frame)}"
        drive.machine.on(DriveEvent.ABORTED)

    def _frame_trouble(self, frame: str) -> str:
        try:
            self._frames.on_map(frame)
        except FramesError as err:
            return str(err)
        return f"it is in the frame '{frame}', not '{self._frame}'"

    def _judge(self, drive: ClientDrive) -> None:
        """Decide how to end a drive whose goal the planner rejected, or aborted without an error code.

        The planner may have aborted the goal because another client sent one, or given its reason in words. A bridge
        whose planner has just disappeared also rejects goals, before other programs notice that the planner is gone.
        """
        rejected = drive.sent is not None and drive.sent.accepted is False
        if not self._link.reachable:
            drive.released = False
            drive.machine.on(DriveEvent.CONTACT_LOST)
        elif rejected:
            if drive.machine.age > JUDGING_SECONDS:
                self.finish(drive, GoalState.ABORTED, Fault.BAD_GOAL, drive.reason)
        elif self._link.foreign and self._link.state.reported:
            reason = drive.reason or self._without_reason("canceled")
            self.finish(drive, GoalState.CANCELED, Fault.OTHER, reason)
        elif drive.machine.age > (SETTLING_SECONDS if self._link.may_execute(drive.sent) else JUDGING_SECONDS):
            self._abort(drive, Fault.OTHER, drive.reason or self._without_reason("aborted"))

    def _abort(self, drive: ClientDrive, code: int, reason: str) -> None:
        """End an aborted drive; first stop other actions (Nav2's controller) unless the base stood all the time."""
        if self._motion.base(drive.sent_at) is Base.STANDING or self._link.foreign or not self._link.may_move:
            self.finish(drive, GoalState.ABORTED, code, reason)
        else:
            self._abort_moving(drive, code, reason)

    def _abort_moving(self, drive: ClientDrive, code: int, reason: str) -> None:
        """Stop the base; report the end of the drive when the stop is confirmed, or after `GIVE_UP_SECONDS`."""
        drive.aborted, drive.reason, drive.released = (code, reason), reason, False
        drive.machine.on(DriveEvent.STOP)
        self.cancel(drive)
        self._order.ask(reason)

    def _without_reason(self, how: str) -> str:
        return f"{self._planner} {how} the goal" + (f" for {own_client(self._planner)}" if self._link.foreign else "")

    def _on_reached(self, drive: ClientDrive) -> None:
        if drive.several or len(drive.left) == 1:
            self.finish(drive, GoalState.SUCCEEDED, Fault.NONE, "")
        elif drive.state is DriveState.STOPPING:
            self.finish(drive, GoalState.CANCELED, Fault.OTHER, drive.reason)
        else:
            drive.at += 1
            if drive.machine.on(DriveEvent.NEXT):
                self._send(drive, None)

    def finish(self, drive: ClientDrive, status: GoalState, code: int, reason: str, unconfirmed: str = "") -> None:
        """End a drive; a stop continues if the planner has not released its goal, or the base still moves.

        ``unconfirmed`` is for the client only: the gateway's own status shows it as long as it applies.
        """
        if self.drive is not drive:
            return
        self.drive, self.ended_at = None, time.monotonic()
        self.ended[_OUTCOMES.get(status, "failed")] += 1
        self._unpause()
        if not drive.released:
            self.cancel(drive)
        settles = status is not GoalState.SUCCEEDED and not self._link.foreign
        moves = settles and self._motion.base() is Base.MOVING
        if (moves or not drive.released or self._link.left) and not self._order.state.open:
            self._order.ask(reason)
        self.last = {
            GoalState.SUCCEEDED: PlannerStatus(State.REACHED),
            GoalState.CANCELED: PlannerStatus(State.IDLE, reason),
        }.get(status, PlannerStatus(State.ABORTED, reason, int(code)))
        self._link.foreign_goals.end = None
        if status is GoalState.ABORTED:
            self._host.log.warning("the goal of %s is aborted: %s", drive.client, reason)
        drive.end(status, code, f"{reason}; {unconfirmed}" if unconfirmed else reason)
        self.advance()
        self.settle()
        self._changed()

    def settle(self) -> None:
        """Switch to another planner if one is pending."""
        before = self._link
        if self._choice.settle(driving=self.driving, stop=self._order.state):
            self._order.drop()
        if self._link is not before:
            self._link.refresh(self._motion)

    def _unpause(self) -> None:
        if self._pause is not None:
            self._pause.close()
            self._pause = None

    def _on_map(self, target: Target) -> Target:
        """Return a target in the map's frame if the transform is known, so that it does not move with the robot."""
        frame = self._frame
        if target.frame == frame:
            return target
        try:
            return Target(self._frames.on_map(target.frame) @ target.pose, frame, target.tree)
        except FramesError:
            return target


def robot_pose(frames: RobotFrames) -> Pose | None:
    """Return the robot's pose on the map, None if it is unknown."""
    try:
        return frames.pose()
    except FramesError:
        return None
