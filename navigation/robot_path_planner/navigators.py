"""Clients of local navigators, which drive to one waypoint at a time: over an action on the hub, or a YARP port."""

# ruff: noqa: D102 - documented in `LocalNavigator`

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from typing_extensions import override

from bridge.client.actions import SentGoal
from bridge.hub.wire.qos import LATCHED
from bridge.messages.actions import GoalState
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
    """A local navigator, or a client of one."""

    @property
    def state(self) -> State:
        """The state of the last goal; `State.ERROR` also if no navigator is available."""

    @property
    def reason(self) -> str:
        """Why the navigator waits, failed or is unavailable."""

    @property
    def fault(self) -> Fault:
        """The reason as a code; `Fault.NONE` without a code."""

    def send(self, pose: Pose, constraints: Constraints) -> None:
        """Drive to a pose instead of the previous one."""

    def cancel(self) -> None:
        """Drop the goal and stop."""


_ROBOT_GOTO = "/planner/robot_goto/"
_ACTION_SUFFIX = "/navigate_to_pose"
_BACK_SECONDS = 0.5
"""Seconds between two checks whether the server of a goal that has to end is back."""


class ActionNavigator:
    """A local navigator that has one action. Used on the module's thread, except for `brake`."""

    def __init__(self, host: Host, action: str, frame: str) -> None:
        self._frame, self._action, self._loop = frame, action, host.loop
        self._client = host.node.action_client(action, NAVIGATE)
        self._goal: SentGoal | None = None
        self._lost = False  # whether contact with the goal's server was lost, which may still execute the goal
        self._state, self._reason, self._fault = State.IDLE, "", Fault.NONE
        if action.endswith(_ACTION_SUFFIX):
            host.node.subscription(action.removesuffix(_ACTION_SUFFIX) + "/status", STATUS, self._on_status, LATCHED)

    @property
    def state(self) -> State:
        return self._state if self._client.ready else State.ERROR

    @property
    def reason(self) -> str:
        return self._reason if self._client.ready else f"no server for {self._action}"

    @property
    def fault(self) -> Fault:
        return self._fault if self._client.ready else Fault.NO_NAVIGATOR

    def send(self, pose: Pose, constraints: Constraints) -> None:
        self._state, self._reason, self._fault, self._lost = State.PREPARING, "", Fault.NONE, False
        # without a stamp, because the clock of another machine may differ
        goal = {"pose": {"header": {"frame_id": self._frame}, "pose": pose_message(pose)}}
        if self._action.startswith(_ROBOT_GOTO):
            goal["behavior_tree"] = constraints.to_text()  # type: ignore[assignment]
        self._goal = self._client.send(goal, self._on_end, self._on_feedback)

    def cancel(self) -> None:
        goal, self._goal = self._goal, None
        self._state, self._reason, self._fault = State.IDLE, "", Fault.NONE
        if goal is not None and self._lost:
            self._cancel_lost(goal)
        elif goal is not None and not goal.status.ended:
            goal.cancel()

    def _cancel_lost(self, goal: SentGoal) -> None:
        """Cancel a goal as soon as its server is back."""
        if self._client.ready:
            self._client.follow(goal)  # the request is repeated while the goal is active
            goal.cancel()
        else:
            self._loop.after(_BACK_SECONDS, lambda: self._cancel_lost(goal))

    def brake(self) -> Callable[[], None]:
        """Return a function that cancels only the current goal. Both may run on any thread; `cancel` has to follow."""
        goal = self._goal
        return lambda: goal.cancel() if goal is not None and goal.active else None

    def _on_feedback(self, _feedback: dict[str, Any]) -> None:
        if self._state is State.PREPARING and not self._reason:
            self._state = State.MOVING

    def _on_status(self, status: dict[str, Any]) -> None:
        """Handle the status of a planner of Midspan, which has the reason for a wait; feedback lacks it."""
        if self._goal is None or bytes(status["goal_id"]) != self._goal.id or self._goal.status.ended:
            return
        try:
            state = State(status["state"])
        except ValueError:
            return
        if not state.ended:
            self._state, self._reason, self._fault = state, status["reason"], Fault.parse(status["error_code"])

    def _on_end(self, goal: SentGoal, result: dict[str, Any] | None, reason: str) -> None:
        if goal is not self._goal:
            return  # another goal replaced it
        self._lost = result is None and goal.accepted is not False
        reason = (result or {}).get("error_msg", "") or reason
        is_robot_goto = self._action.startswith(_ROBOT_GOTO)
        self._fault = Fault.parse((result or {}).get("error_code", 0)) if is_robot_goto else Fault.NONE
        if goal.status is GoalState.SUCCEEDED:
            self._state, self._reason = State.REACHED, reason
        elif goal.status is GoalState.CANCELED:
            self._state, self._reason = State.IDLE, reason or "another client canceled its goal"
        else:
            self._state, self._reason = State.FAILING, reason or f"{self._action} aborted the goal"


_POLL = 0.1
GRACE = 1.0
"""Seconds after accepting a goal for which a server that has not driven yet may still report the end of the previous
goal. After that its status is valid, because a robot that is already at the goal does not move."""
_STATUS = "navigation_status_"
_ENDS = (State.REACHED, State.ABORTED, State.FAILING)


class YarpNavigator(PolledServer[INavigation2DMsgs]):
    """A local navigator at the YARP port ``<server>/rpc``, which it polls for the status. Thread-safe.

    Speeds and gains of waypoints are dropped: INavigation2D cannot express them.
    """

    fault = Fault.NONE  #: INavigation2D has no error codes

    def __init__(self, server: str, map_name: Callable[[], str], naming: Naming) -> None:
        port, self._map_name = f"{server}/rpc", map_name
        self.state, self.reason = State.ERROR, f"waiting for {port}"
        self._wanted: Map2DLocation | None = None
        self._number = self._sent = 0
        self._taken_at, self._drove, self._denied = -math.inf, False, False
        super().__init__(INavigation2DMsgs, port, naming, "midspan-yarp-navigator")

    def send(self, pose: Pose, constraints: Constraints) -> None:
        theta = math.degrees(pose.theta) if constraints.heading else math.nan
        self._request(Map2DLocation(self._map_name(), pose.x, pose.y, theta), State.PREPARING)

    def cancel(self) -> None:
        self._request(None, State.IDLE)

    def brake(self) -> Callable[[], None]:
        """Return a function that cancels the current goal and no later one; see `ActionNavigator.brake`."""
        number = self._number

        def stop() -> None:
            with self._lock:
                if self._number == number:
                    self.cancel()

        return stop

    def _request(self, place: Map2DLocation | None, state: State) -> None:
        with self._lock:
            self._wanted = place
            self._number += 1
            if self.state is not State.ERROR:
                self.state, self.reason = state, ""
            self._lock.notify()

    @override
    def _follow(self, remote: INavigation2DMsgs) -> None:
        while self._step(remote):
            with self._lock:
                self._lock.wait_for(lambda: self._closed or self._number != self._sent, _POLL)

    def _step(self, remote: INavigation2DMsgs) -> bool:
        """Send the wanted goal and request the status; return False to end."""
        with self._lock:
            number, place = self._number, self._wanted
            due, closed = number != self._sent, self._closed
        if closed and not due:
            return False
        if due:
            done = remote.goto_target_by_absolute_location_RPC(place) if place else remote.stop_navigation_RPC()
            self._sent, self._taken_at, self._drove, self._denied = number, time.monotonic(), False, not done
            if not done:
                self._on_refusal(number)
                return True
        outcome, status = remote.get_navigation_status_RPC()
        if outcome:
            self._on_reply(number, State(statusToString(status).removeprefix(_STATUS)))
        else:
            self._on_unreachable(f"{self._port} does not report its status")
        return True

    def _on_refusal(self, number: int) -> None:
        with self._lock:
            if number == self._number:
                self.state, self.reason = State.FAILING, f"{self._port} refused the goal"

    def _on_reply(self, number: int, state: State) -> None:
        with self._lock:
            if number != self._number:
                return  # the reply is about a previous goal
            if self._wanted is not None:
                if self._denied:
                    return  # the status belongs to another client's goal
                self._drove = self._drove or not state.ended
                if not self._drove and time.monotonic() < self._taken_at + GRACE:
                    state = State.PREPARING
                elif state is State.IDLE and self.state in _ENDS:
                    return  # robotGoto becomes idle some time after it arrives
            self.state, self.reason = state, ""

    @override
    def _on_unreachable(self, reason: str) -> None:
        with self._lock:
            self.state, self.reason = State.ERROR, reason
            self._taken_at, self._denied = -math.inf, False
            # a stop is sent again when the server is back; a goal is not, because the planner sends it
            if self._wanted is not None:
                self._sent = self._number
