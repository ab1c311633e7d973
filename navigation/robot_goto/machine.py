"""RobotGoto's states, events and transitions, as a table; ARCHITECTURE.md draws it.

An event that a state does not list changes nothing. Each state is published as one `State`.
"""

from __future__ import annotations

from enum import Enum

from bridge.state_machine import Table
from navigation.status import State


class DriverState(Enum):
    """What the robot does."""

    IDLE = "idle"  #: no goal yet, or it was canceled
    APPROACHING = "approaching"  #: moves for a given time, without a goal
    PREPARING = "preparing"  #: has not driven to its goal yet: it backs off, or waits for a sensor or its pose
    DRIVING = "driving"  #: drives to its goal
    WAITING = "waiting"  #: has driven to its goal, and cannot continue now
    PAUSED = "paused"
    PASSING = "passing"  #: has reached a waypoint, and continues for a moment until the next goal arrives
    REACHED = "reached"
    ABORTED = "aborted"
    FAILED = "failed"  #: has waited for too long

    @property
    def published(self) -> State:
        """The state that clients receive."""
        return _PUBLISHED[self]


_PUBLISHED = {
    DriverState.IDLE: State.IDLE,
    DriverState.APPROACHING: State.PREPARING,
    DriverState.PREPARING: State.PREPARING,
    DriverState.DRIVING: State.MOVING,
    DriverState.WAITING: State.WAITING,
    DriverState.PAUSED: State.PAUSED,
    DriverState.PASSING: State.REACHED,
    DriverState.REACHED: State.REACHED,
    DriverState.ABORTED: State.ABORTED,
    DriverState.FAILED: State.FAILING,
}


class DriverEvent(Enum):
    """What changes `DriverState`."""

    GOAL = "a client sends a goal"
    BACK_OFF = "a client sends a goal to a standing robot without one, which first backs off (`enable_retreat`)"
    APPROACH = "a client requests a move without a goal"
    CANCEL = "a client cancels, or the clock jumps back"
    PAUSE = "a client or a deadlock pauses the drive"
    RESUME = "a client resumes, or the pause is over"
    NOT_READY = "a sensor, the pose or the base does not work, and the robot has not driven to the goal yet"
    WAIT = "a sensor, the pose or the base fails after the robot has driven, or an obstacle is on the path"
    GO = "nothing prevents driving"
    WAYPOINT = "a waypoint is reached, which the robot passes without a stop"
    REACH = "the goal is reached"
    FINISH = "the time of a move without a goal, or past a waypoint, is over"
    ABORT = "the robot makes no progress, or a move without a goal cannot continue"
    GIVE_UP = "the robot has waited for too long"


def _driver() -> Table[DriverState, DriverEvent]:
    state, event = DriverState, DriverEvent
    always = {event.GOAL: state.DRIVING, event.APPROACH: state.APPROACHING, event.CANCEL: state.IDLE}
    goalless = always | {event.BACK_OFF: state.PREPARING}
    waiting = always | {
        event.PAUSE: state.PAUSED,
        event.WAIT: state.WAITING,
        event.GO: state.DRIVING,
        event.WAYPOINT: state.PASSING,
        event.REACH: state.REACHED,
        event.GIVE_UP: state.FAILED,
    }
    preparing = waiting | {event.NOT_READY: state.PREPARING}
    return {
        state.IDLE: goalless,
        state.APPROACHING: goalless | {event.FINISH: state.IDLE, event.ABORT: state.ABORTED},
        state.PREPARING: preparing,
        state.DRIVING: preparing | {event.ABORT: state.ABORTED},
        state.WAITING: waiting,
        state.PAUSED: always | {event.PAUSE: state.PAUSED, event.RESUME: state.DRIVING},
        state.PASSING: goalless | {event.FINISH: state.REACHED},
        state.REACHED: goalless,
        state.ABORTED: goalless,
        state.FAILED: goalless,
    }


DRIVER = _driver()
