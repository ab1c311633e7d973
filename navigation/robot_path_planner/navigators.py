"""Local navigators, which drive from waypoint to waypoint: behind an action of the hub, or a port of YARP."""

# ruff: noqa: D102 - `LocalNavigator` says what each does

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from bridge.hub.wire.qos import LATCHED
from bridge.messages.actions import GoalState
from bridge.modules.clients import SentGoal
from bridge.modules.host import Host
from navigation.constraints import Constraints
from navigation.messages import NAVIGATE, pose_message
from navigation.pose import Pose
from navigation.status import STATUS, Fault, State
from navigation.yarp import PolledServer
from yarp_compat.dev.inavigation2d import INavigation2DMsgs, statusToString
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.ports.naming import Naming


class LocalNavigator(Protocol):
    """A local navigator: RobotGoto in process, or a client of one."""

    @property
    def state(self) -> State:
        """Of the goal that was sent last, from then on; `State.ERROR` also where there is no navigator."""

    @property
    def reason(self) -> str:
        """Why it waits, failed or is not there."""

    @property
    def fault(self) -> Fault:
        """The same as a number; `Fault.NONE` where it says none."""

    def send(self, pose: Pose, constraints: Constraints) -> None:
        """Drive there, instead of where it was sent before."""

    def cancel(self) -> None:
        """Stand still."""


_OURS = "/planner/robot_goto/"
_TAIL = "/navigate_to_pose"


class ActionNavigator:
    """Sends goals to one action; see `LocalNavigator`. On the module's thread."""

    def __init__(self, host: Host, action: str, frame: str) -> None:
        self._frame, self._action = frame, action
        self._client = host.node.action_client(action, NAVIGATE)
        self._goal: SentGoal | None = None
        self._state, self._reason, self._fault = State.IDLE, "", Fault.NONE
        if action.endswith(_TAIL):
            host.node.subscription(action.removesuffix(_TAIL) + "/status", STATUS, self._told, LATCHED)

    @property
    def state(self) -> State:
        return self._state if self._client.ready else State.ERROR

    @property
    def reason(self) -> str:
        return self._reason if self._client.ready else f"nobody serves {self._action}"

    @property
    def fault(self) -> Fault:
        return self._fault if self._client.ready else Fault.NO_NAVIGATOR

    def send(self, pose: Pose, constraints: Constraints) -> None:
        self._state, self._reason, self._fault = State.PREPARING, "", Fault.NONE
        # without a stamp: how old a goal looks on another machine's clock says nothing
        goal = {"pose": {"header": {"frame_id": self._frame}, "pose": pose_message(pose)}}
        if self._action.startswith(_OURS):
            goal["behavior_tree"] = constraints.to_text()  # type: ignore[assignment]
        self._goal = self._client.send(goal, self._ended, self._driving)

    def cancel(self) -> None:
        goal, self._goal = self._goal, None
        self._state, self._reason, self._fault = State.IDLE, "", Fault.NONE
        if goal is not None and not goal.status.ended:
            goal.cancel()

    def brake(self) -> Callable[[], None]:
        """What has it give up the goal at hand, and no later one. On any thread; `cancel` is to follow."""
        goal = self._goal
        return lambda: goal.cancel() if goal is not None and goal.active else None

    def _driving(self, _feedback: dict[str, Any]) -> None:
        if self._state is State.PREPARING and not self._reason:
            self._state = State.MOVING

    def _told(self, status: dict[str, Any]) -> None:
        """A planner of Midspan's says more than its action: that it waits, and for what."""
        if self._goal is None or bytes(status["goal_id"]) != self._goal.id or self._goal.status.ended:
            return
        try:
            state = State(status["state"])
        except ValueError:
            return
        if not state.ended:
            self._state, self._reason, self._fault = state, status["reason"], Fault.parse(status["error_code"])

    def _ended(self, goal: SentGoal, result: dict[str, Any] | None, why: str) -> None:
        if goal is not self._goal:
            return  # another has taken its place
        said = (result or {}).get("error_msg", "") or why
        ours = self._action.startswith(_OURS)
        self._fault = Fault.parse((result or {}).get("error_code", 0)) if ours else Fault.NONE
        if goal.status is GoalState.SUCCEEDED:
            self._state, self._reason = State.REACHED, said
        elif goal.status is GoalState.CANCELED:
            self._state, self._reason = State.IDLE, said or "somebody else cancelled its goal"
        else:
            self._state, self._reason = State.FAILING, said or f"{self._action} gave the goal up"


_POLL = 0.1
GRACE = 1.0
"""Seconds after a goal was taken for which a server that has not been seen to drive may still tell how the goal before
ended; later its word is believed: a robot that is there already need not move."""
_STATUS = "navigation_status_"
_ENDS = (State.REACHED, State.ABORTED, State.FAILING)


class YarpNavigator(PolledServer[INavigation2DMsgs]):
    """Sends goals to the server at ``<server>/rpc``, and asks it how they are. Safe to use from any thread.

    Speeds and gains of waypoints do not reach it: INavigation2D has no words for them.
    """

    fault = Fault.NONE  #: INavigation2D has no words for one

    def __init__(self, server: str, map_name: Callable[[], str], naming: Naming) -> None:
        port, self._map_name = f"{server}/rpc", map_name
        self.state, self.reason = State.ERROR, f"{port} has not answered yet"
        self._wanted: Map2DLocation | None = None
        self._number = self._sent = 0
        self._taken_at, self._drove, self._denied = -math.inf, False, False
        super().__init__(INavigation2DMsgs, port, naming, "midspan-yarp-navigator")

    def send(self, pose: Pose, constraints: Constraints) -> None:
        theta = math.degrees(pose.theta) if constraints.heading else math.nan
        self._want(Map2DLocation(self._map_name(), pose.x, pose.y, theta), State.PREPARING)

    def cancel(self) -> None:
        self._want(None, State.IDLE)

    def brake(self) -> Callable[[], None]:
        """What has it give up the goal at hand, and no later one; see `ActionNavigator.brake`."""
        number = self._number

        def stop() -> None:
            with self._lock:
                if self._number == number:
                    self.cancel()

        return stop

    def _want(self, place: Map2DLocation | None, state: State) -> None:
        with self._lock:
            self._wanted = place
            self._number += 1
            if self.state is not State.ERROR:
                self.state, self.reason = state, ""
            self._lock.notify()

    def _follow(self, remote: INavigation2DMsgs) -> None:
        while self._step(remote):
            with self._lock:
                self._lock.wait_for(lambda: self._closed or self._number != self._sent, _POLL)

    def _step(self, remote: INavigation2DMsgs) -> bool:
        """Send the wanted goal, and ask for the status; whether to go on."""
        with self._lock:
            number, place = self._number, self._wanted
            due, closed = number != self._sent, self._closed
        if closed and not due:
            return False
        if due:
            done = remote.goto_target_by_absolute_location_RPC(place) if place else remote.stop_navigation_RPC()
            self._sent, self._taken_at, self._drove, self._denied = number, time.monotonic(), False, not done
            if not done:
                self._refused(number)
                return True
        outcome, status = remote.get_navigation_status_RPC()
        if outcome:
            self._heard(number, State(statusToString(status).removeprefix(_STATUS)))
        else:
            self._gone(f"{self._port} does not say how it is getting on")
        return True

    def _refused(self, number: int) -> None:
        with self._lock:
            if number == self._number:
                self.state, self.reason = State.FAILING, f"{self._port} refused the goal"

    def _heard(self, number: int, state: State) -> None:
        with self._lock:
            if number != self._number:
                return  # of a goal before
            if self._wanted is not None:
                if self._denied:
                    return  # whatever it does, it does not do it for us
                self._drove = self._drove or not state.ended
                if not self._drove and time.monotonic() < self._taken_at + GRACE:
                    state = State.PREPARING
                elif state is State.IDLE and self.state in _ENDS:
                    return  # robotGoto becomes idle some time after it has arrived
            self.state, self.reason = state, ""

    def _gone(self, why: str) -> None:
        with self._lock:
            self.state, self.reason = State.ERROR, why
            self._taken_at, self._denied = -math.inf, False
            # a goal is not sent again by itself: the planner does that once the server is back; a stop is
            if self._wanted is not None:
                self._sent = self._number
