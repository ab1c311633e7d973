"""The gateway's states, events and transitions, as tables; ARCHITECTURE.md shows them.

Three machines hold the state of the gateway: that of the planner (`PLANNER`), of the drive for one client (`DRIVE`),
and of a stop or pause that has to be confirmed (`STOP`). `navigation.gateway.words` derives every answer to a client
from these states. Two more are for the velocities of YARP clients: what is published for them (`VELOCITY`), and whether
they have to pause before they drive (`SENDER`). An event that a state does not list changes nothing.
"""

from __future__ import annotations

from enum import Enum

from bridge.state_machine import Table


class PlannerState(Enum):
    """Whether the planner is reachable, and whether it has goals."""

    UNKNOWN = "unknown"  #: not seen since the gateway started; the planner's side has not reported yet
    ABSENT = "absent"  #: the planner's side has reported, and the planner is not on it
    UNREPORTED = "unreported"  #: reachable; its goals are not known yet
    IDLE = "idle"  #: reachable, without goals
    DRIVING = "driving"  #: reachable, with goals
    UNREACHABLE = "unreachable"  #: no longer reachable: a part of its action has gone, or a call to it failed

    @property
    def reachable(self) -> bool:
        """Whether all parts of the planner's action are on the hub."""
        return self in _REACHABLE

    @property
    def reported(self) -> bool:
        """Whether the planner's goals are known."""
        return self in _REPORTED


_REACHABLE = frozenset((PlannerState.UNREPORTED, PlannerState.IDLE, PlannerState.DRIVING))
_REPORTED = frozenset((PlannerState.IDLE, PlannerState.DRIVING))


class PlannerEvent(Enum):
    """What changes `PlannerState`."""

    FOUND = "all parts of its action are on the hub"
    LOST = "a part of its action has left the hub"
    UNREPORTED = "its goal list is no longer valid"
    NO_GOALS = "its goal list has no active goal"
    GOALS = "its goal list has an active goal"
    SIDE_REPORTED = "its side has reported its graph, which does not contain the planner"


class DriveState(Enum):
    """The state of a client's drive."""

    WAITING = "waiting"  #: not sent: the planner cannot accept a goal yet
    SENT = "sent"  #: the planner has not answered yet
    DRIVING = "driving"  #: the planner has accepted the goal
    JUDGING = "judging"  #: the planner rejected the goal, or ended it without a code; its next list may show why
    LOST = "lost"  #: contact with the goal is lost: it may still be executing
    PAUSING = "pausing"  #: canceled for a pause, which is not confirmed yet
    PAUSED = "paused"  #: the robot stands
    STOPPING = "stopping"  #: canceled, which is not confirmed yet
    ENDED = "ended"


class DriveEvent(Enum):
    """What changes `DriveState`."""

    SEND = "the goal is sent"
    ACCEPTED = "the planner accepts the goal"
    RETRY = "the goal has to be sent again"
    NEXT = "an intermediate goal is reached"
    ABORTED = "the planner ended the goal without a code"
    CONTACT_LOST = "the planner is unreachable, or has lost the goal's client"
    RESUMED_CONTACT = "the planner's goal list still has the goal"
    PAUSE = "a client pauses"
    RESUME = "a client resumes, or the pause is over"
    STOP = "a client cancels or stops"
    STANDS = "the pause is confirmed"
    MOVES = "the base moves during the pause, and the planner has not released the goal"
    END = "the drive ends"


class StopState(Enum):
    """The state of a stop or pause."""

    NONE = "none"  #: no stop is requested
    ASKED = "asked"  #: the planner has not released its goals
    RESTING = "resting"  #: the base stands; the planner has not released its goals
    SETTLING = "settling"  #: the planner has released its goals; the base is not known to stand
    CONFIRMED = "confirmed"  #: the planner has released its goals, and the base stands
    EXPIRED = "expired"  #: given up: the planner has been unreachable for long, or something else moves the base

    @property
    def open(self) -> bool:
        """Whether the stop is still to be confirmed."""
        return self in _OPEN

    @property
    def held(self) -> bool:
        """Whether the planner's velocities must not reach the base."""
        return self in (StopState.ASKED, StopState.RESTING)


_OPEN = frozenset((StopState.ASKED, StopState.RESTING, StopState.SETTLING))


class StopEvent(Enum):
    """What changes `StopState`."""

    ASK = "a stop or pause is requested"
    RELEASED = "the planner has no goal left that has to end"
    NOT_RELEASED = "the planner may have a goal left that has to end"
    STANDS = "the base stands"
    MOVES = "the base is not known to stand"
    EXPIRE = "it has not been confirmed in time"


class VelocityState(Enum):
    """What is published for YARP clients that command velocities."""

    SILENT = "silent"  #: nothing
    DRIVING = "driving"  #: a client's velocity, which may be zero
    HALTING = "halting"  #: zero, whoever else commands the base
    ENDING = "ending"  #: zero, unless that would slow the planner or a person


class VelocityEvent(Enum):
    """What changes `VelocityState`."""

    COMMAND = "a client's velocity is accepted"
    HALT = "zero has to override all other sources"
    END = "the time of the velocity or halt is over, it is stopped, or a person drives"
    DONE = "zero has been repeated for long enough, or would slow the planner or a person"


class SenderState(Enum):
    """Whether YARP clients send velocities, and whether they have to pause before they drive."""

    SILENT = "silent"  #: no velocity but zero for a moment
    SENDING = "sending"  #: velocities arrive, and may drive
    DISPLACED = "displaced"  #: velocities arrive, and were refused because the planner or a person drove
    STOPPED = "stopped"  #: velocities arrive, and the robot was stopped
    ENDED = "ended"  #: the gateway is shutting down


class SenderEvent(Enum):
    """What changes `SenderState`."""

    VELOCITY = "a client sends a velocity other than zero"
    DISPLACE = "such a velocity is refused or ended, because the planner or a person drives"
    STOP = "a person stops the robot"
    PAUSE = "no velocity but zero has arrived for a moment"
    END = "the gateway shuts down"


def _planner() -> Table[PlannerState, PlannerEvent]:
    state, event = PlannerState, PlannerEvent
    reachable = {event.LOST: state.UNREACHABLE, event.NO_GOALS: state.IDLE, event.GOALS: state.DRIVING}
    reported = reachable | {event.UNREPORTED: state.UNREPORTED}
    missing = {event.FOUND: state.UNREPORTED}
    return {
        state.UNKNOWN: missing | {event.SIDE_REPORTED: state.ABSENT},
        state.ABSENT: missing,
        state.UNREPORTED: reachable,
        state.IDLE: reported,
        state.DRIVING: reported,
        state.UNREACHABLE: missing | {event.SIDE_REPORTED: state.ABSENT},
    }


def _drive() -> Table[DriveState, DriveEvent]:
    state, event = DriveState, DriveEvent
    always = {event.STOP: state.STOPPING, event.END: state.ENDED}
    active = always | {event.PAUSE: state.PAUSING}
    sent = active | {
        event.SEND: state.SENT,
        event.RETRY: state.WAITING,
        event.NEXT: state.WAITING,
        event.ABORTED: state.JUDGING,
        event.CONTACT_LOST: state.LOST,
    }
    return {
        state.WAITING: active | {event.SEND: state.SENT},
        state.SENT: sent | {event.ACCEPTED: state.DRIVING},
        state.DRIVING: sent,
        state.JUDGING: active | {event.RETRY: state.WAITING, event.CONTACT_LOST: state.LOST},
        state.LOST: active
        | {
            event.RETRY: state.WAITING,
            event.RESUMED_CONTACT: state.DRIVING,
            event.NEXT: state.WAITING,
            event.ABORTED: state.JUDGING,
        },
        state.PAUSING: always | {event.STANDS: state.PAUSED, event.RESUME: state.WAITING},
        state.PAUSED: always | {event.MOVES: state.PAUSING, event.RESUME: state.WAITING},
        state.STOPPING: {event.END: state.ENDED},
        state.ENDED: {},
    }


def _stop() -> Table[StopState, StopEvent]:
    state, event = StopState, StopEvent
    again = {event.ASK: state.ASKED}
    return {
        state.NONE: again,
        state.ASKED: again
        | {event.RELEASED: state.SETTLING, event.STANDS: state.RESTING},
        state.RESTING: again
        | {event.RELEASED: state.CONFIRMED, event.MOVES: state.ASKED, event.EXPIRE: state.EXPIRED},
        state.SETTLING: again
        | {event.STANDS: state.CONFIRMED, event.NOT_RELEASED: state.ASKED, event.EXPIRE: state.EXPIRED},
        state.CONFIRMED: again,
        state.EXPIRED: again,
    }  # fmt: skip


def _velocity() -> Table[VelocityState, VelocityEvent]:
    state, event = VelocityState, VelocityEvent
    begin = {event.COMMAND: state.DRIVING, event.HALT: state.HALTING}
    return {
        state.SILENT: begin,
        state.DRIVING: begin | {event.END: state.ENDING},
        state.HALTING: begin | {event.END: state.ENDING},
        state.ENDING: begin | {event.DONE: state.SILENT},
    }


def _sender() -> Table[SenderState, SenderEvent]:
    state, event = SenderState, SenderEvent
    always = {event.END: state.ENDED}
    stopped = always | {event.PAUSE: state.SILENT}
    displaced = stopped | {event.STOP: state.STOPPED}
    return {
        state.SILENT: always | {event.VELOCITY: state.SENDING},
        state.SENDING: displaced | {event.DISPLACE: state.DISPLACED},
        state.DISPLACED: displaced,
        state.STOPPED: stopped,
        state.ENDED: {},
    }


PLANNER, DRIVE, STOP, VELOCITY, SENDER = _planner(), _drive(), _stop(), _velocity(), _sender()
