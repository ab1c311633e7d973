"""All reports to clients about the robot's motion, derived from the state of the gateway."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from navigation.gateway.machine import DriveState, PlannerState, StopState
from navigation.gateway.motion import Base
from navigation.gateway.stop import LATE_SECONDS, SETTLING_SECONDS
from navigation.status import Fault, PlannerStatus, State

MAY_MOVE = "the robot may still be moving"

_MAY_START = "the robot stands, and may move again"

_LIST_LAG = 0.5
"""The lists of Nav2's servers may show the end of a goal this much later than its result, in seconds."""


@dataclass(frozen=True)
class Situation:
    """The state of the planner, the base, the current drive and the current stop at one time."""

    planner: str  #: the planner's name
    planner_state: PlannerState = PlannerState.UNKNOWN
    planner_age: float = 0.0  #: seconds since ``planner_state`` changed
    base: Base = Base.UNKNOWN
    #: whether the planner's newest list, even an invalid one, has active goals; None before the first list
    goals: bool | None = None
    #: whether the planner had a goal of a client that bypasses the gateway when its list was last valid
    doubtful: bool = False
    motion: tuple[str, ...] = ()  #: other actions that move the base now, such as Nav2's ``/follow_path``
    foreign: PlannerStatus | None = None  #: the status of a goal of the planner's own client
    unlisted: bool = False  #: whether the planner serves goals of several poses, but has not reported them yet
    orphans: bool = False  #: whether the planner drives to a goal from before the gateway was restarted
    drive: DriveState | None = None
    reason: str = ""  #: why the drive stops or waits
    unreleased: bool = False  #: whether the planner may have a goal of the drive
    reported: PlannerStatus | None = None  #: the planner's own status of the drive's goal
    silence: float = 0.0  #: the allowed seconds without a message if the planner has been silent for longer, else 0
    localization: str = ""  #: why the robot's pose is not trusted
    stop: StopState = StopState.NONE
    stop_reason: str = ""
    stop_age: float = 0.0  #: seconds since the request for the stop or pause
    odometry: bool = False  #: whether there is odometry
    since_end: float = 0.0  #: seconds since the last drive ended
    last: PlannerStatus = field(default_factory=PlannerStatus)  #: how the last drive ended


def derive(now: Situation) -> PlannerStatus:
    """Return the state to report, its reason and its code."""
    return _without_drive(now) if now.drive is None else _OF_DRIVE[now.drive](now)


def trouble(now: Situation) -> str:
    """Return why a stop or pause is not confirmed; "" if it is, or none is requested."""
    confirmed = now.stop in (StopState.NONE, StopState.CONFIRMED, StopState.RESTING)
    return "" if confirmed else unconfirmed(now)


def unconfirmed(now: Situation) -> str:
    """Return why the robot is not known to stand still."""
    if now.motion and now.planner_state.reachable:
        return f"{MAY_MOVE}: {', '.join(now.motion)} of {now.planner} has not ended"
    if now.stop in (StopState.SETTLING, StopState.EXPIRED):
        reason = (
            f"{now.planner} has released its goals, but the base has not come to rest"
            if now.odometry
            else "odometry is missing, and the velocity commands have not ended"
        )
        return f"{MAY_MOVE}: {reason}"
    if not now.planner_state.reachable:
        reason = f"the planner {now.planner} is not available"
    elif not now.planner_state.reported:
        reason = f"{now.planner} has not reported its goals yet"
    else:
        reason = f"{now.planner} has not released its goal"
    return f"{MAY_MOVE}: {reason}; the stop request is repeated"


def _stopping(now: Situation) -> PlannerStatus:
    reason = now.reason or now.stop_reason
    if now.stop_age <= LATE_SECONDS:
        return PlannerStatus(State.MOVING, f"stopping: {reason}")
    return PlannerStatus(State.MOVING, f"{reason}; {unconfirmed(now)}", Fault.MAY_MOVE)


def _waiting(now: Situation) -> PlannerStatus:
    """Return the status while the goal is not at the planner or contact is lost; an earlier goal may be executing.

    A goal that may be executing can move a base that stands now before its odometry arrives here.
    """
    may_drive = now.unreleased or now.goals is True or bool(now.motion)
    state = State.MOVING if may_drive or now.base is Base.MOVING else State.PREPARING
    unseen = now.goals is None and now.planner_state is not PlannerState.ABSENT
    if unseen and now.base is Base.UNKNOWN and state is State.PREPARING:
        return _unknown(now)
    if now.planner_state.reachable:
        reason = now.reason or f"waiting for the goal list of {now.planner}"
        return PlannerStatus(state, reason, Fault.OTHER if now.reason else Fault.NONE)
    reason = f"the planner {now.planner} is not available; waiting for it"
    if may_drive:
        reason = f"{reason}; {_MAY_START if now.base is Base.STANDING else MAY_MOVE}"
    return PlannerStatus(state, reason, Fault.NO_NAVIGATOR)


def _sent(now: Situation) -> PlannerStatus:
    """Return the status of a goal that the planner may execute before its acceptance arrives here."""
    return PlannerStatus(State.MOVING, f"waiting for {now.planner} to accept the goal")


def _driving(now: Situation) -> PlannerStatus:
    if now.silence:
        reason = f"{now.planner} does not answer: no status or feedback for {now.silence:g} s"
        return PlannerStatus(State.MOVING, reason, Fault.SILENT)
    status = now.reported or PlannerStatus(State.MOVING)
    if status.state.ended:
        return PlannerStatus(State.MOVING, "", status.fault)  # the goal's result reports the end
    if now.localization and not status.reason:
        return PlannerStatus(State.MOVING, now.localization, Fault.NOT_LOCALIZED)
    moves = status.state is State.PREPARING and now.base is Base.MOVING
    return status._replace(state=State.MOVING) if moves or status.state is State.PAUSED else status


def _judging(now: Situation) -> PlannerStatus:
    return PlannerStatus(State.MOVING, f"{now.planner} ended the goal; waiting for its reason")


def _paused(now: Situation) -> PlannerStatus:
    if now.foreign is not None and now.base is not Base.STANDING:
        return now.foreign
    if now.base is Base.MOVING and not now.planner_state.reported and now.planner_state is not PlannerState.ABSENT:
        return _unknown(now)
    return _COASTING if _coasting(now) else PlannerStatus(State.PAUSED)


_COASTING = PlannerStatus(State.MOVING, "the base has not come to rest yet")


def _coasting(now: Situation) -> bool:
    """Whether the base still moves for a goal that has just ended."""
    ended = now.planner_state is PlannerState.IDLE and now.planner_age < SETTLING_SECONDS
    return ended and now.base is Base.MOVING


def _ended(now: Situation) -> PlannerStatus:
    return now.last


_OF_DRIVE: Mapping[DriveState, Callable[[Situation], PlannerStatus]] = {
    DriveState.WAITING: _waiting,
    DriveState.SENT: _sent,
    DriveState.DRIVING: _driving,
    DriveState.JUDGING: _judging,
    DriveState.LOST: _waiting,
    DriveState.PAUSING: _stopping,
    DriveState.PAUSED: _paused,
    DriveState.STOPPING: _stopping,
    DriveState.ENDED: _ended,
}


def own_client(planner: str) -> str:
    """Return the text for a goal that bypassed the gateway."""
    return f"a goal that {planner} received from its own client"


def _without_drive(now: Situation) -> PlannerStatus:
    """Return the status without a drive: the planner's own clients may drive, and a stop may not be confirmed yet."""
    if now.stop in (StopState.ASKED, StopState.SETTLING):
        return _stopping(now)
    if now.stop is StopState.RESTING:
        return now.last
    if now.foreign is not None:
        return now.foreign
    if now.orphans:
        reason = f"stopping: {now.planner} still has a goal from before the gateway was restarted"
        return PlannerStatus(State.MOVING, reason, Fault.MAY_MOVE)
    if now.doubtful:
        cause = "has not reported its goals" if now.planner_state.reachable else "is not available"
        reason = f"{own_client(now.planner)}; the planner {now.planner} {cause}; {MAY_MOVE}"
        return PlannerStatus(State.MOVING, reason, Fault.MAY_MOVE)
    lists_agree = now.base is Base.MOVING or now.since_end > _LIST_LAG
    if now.motion and now.base is not Base.STANDING and lists_agree:
        return PlannerStatus(State.MOVING, f"{', '.join(now.motion)} moves the base")
    if _coasting(now) and now.last.state is not State.REACHED:
        return _COASTING
    if (now.unlisted or not now.planner_state.reported) and now.planner_state is not PlannerState.ABSENT:
        return _unknown(now)
    return now.last


def _unknown(now: Situation) -> PlannerStatus:
    """Return the status while it is unknown whether the planner has goals."""
    reason = f"it is not known whether {now.planner} has a goal: " + (
        "it has not reported its goals yet" if now.planner_state.reachable else "it is not available"
    )
    if now.base is Base.STANDING:
        return now.last
    if now.base is Base.MOVING:
        return PlannerStatus(State.MOVING, f"{reason}; {MAY_MOVE}", Fault.MAY_MOVE)
    if now.planner_state is PlannerState.UNREACHABLE and now.goals is False:
        return now.last
    return PlannerStatus(State.THINKING, reason, Fault.NO_NAVIGATOR)
