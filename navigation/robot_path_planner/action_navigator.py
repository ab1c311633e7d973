"""A local navigator behind an action of the hub: RobotGoto, or any other server of ``NavigateToPose``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bridge.hub.qos import Durability, Qos
from bridge.modules.action_client import SentGoal
from bridge.modules.goal import Status
from bridge.modules.host import Host
from navigation.constraints import Constraints
from navigation.messages import pose_message
from navigation.pose import Pose
from navigation.status import STATUS, Fault, State

ACTION = "nav2_msgs/action/NavigateToPose"
_OURS = "/planner/robot_goto/"
_TAIL = "/navigate_to_pose"


class ActionNavigator:
    """Sends goals to one action; see `navigation.robot_path_planner.local.LocalNavigator`. On the module's thread.

    Args:
        host: the module's.
        action: its name on the hub.
        frame: the map's.
    """

    def __init__(self, host: Host, action: str, frame: str) -> None:
        self._frame, self._action = frame, action
        self._client = host.node.action_client(action, ACTION)
        self._goal: SentGoal | None = None
        self._state, self._reason, self._fault = State.IDLE, "", Fault.NONE
        if action.endswith(_TAIL):
            latched = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
            host.node.subscription(action.removesuffix(_TAIL) + "/status", STATUS, self._told, latched)

    @property
    def state(self) -> State:
        """How the goal that was sent last is getting on."""
        return self._state if self._client.ready else State.ERROR

    @property
    def reason(self) -> str:
        """Why it waits, failed or is not there."""
        return self._reason if self._client.ready else f"nobody serves {self._action}"

    @property
    def fault(self) -> Fault:
        """The same as a number, of a planner of Midspan's."""
        return self._fault if self._client.ready else Fault.NO_NAVIGATOR

    def send(self, pose: Pose, constraints: Constraints) -> None:
        """Drive there, instead of where it was sent before."""
        self._state, self._reason, self._fault = State.PREPARING, "", Fault.NONE
        # without a stamp: how old a goal looks on another machine's clock says nothing
        goal = {"pose": {"header": {"frame_id": self._frame}, "pose": pose_message(pose)}}
        if self._action.startswith(_OURS):
            goal["behavior_tree"] = constraints.to_text()  # type: ignore[assignment]
        self._goal = self._client.send(goal, self._ended, self._driving)

    def cancel(self) -> None:
        """Stand still."""
        goal, self._goal = self._goal, None
        self._state, self._reason, self._fault = State.IDLE, "", Fault.NONE
        if goal is not None and not goal.status.terminal:
            goal.cancel()

    def brake(self) -> Callable[[], None]:
        """What has it give up the goal at hand, and no later one, whatever the module's thread is at.

        `cancel` is to follow. On any thread.
        """
        goal = self._goal
        return lambda: goal.cancel() if goal is not None and goal.active else None

    def _driving(self, _feedback: dict[str, Any]) -> None:
        if self._state is State.PREPARING:
            self._state = State.MOVING

    def _told(self, status: dict[str, Any]) -> None:
        """A planner of Midspan's says more than its action: that it waits, and for what."""
        if self._goal is None or bytes(status["goal_id"]) != self._goal.id or self._goal.status.terminal:
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
        if goal.status is Status.SUCCEEDED:
            self._state, self._reason = State.REACHED, said
        elif goal.status is Status.CANCELED:
            self._state, self._reason = State.IDLE, said or "somebody else cancelled its goal"
        else:
            self._state, self._reason = State.FAILING, said or f"{self._action} gave the goal up"
