"""A planner of your own: it searches for a path on the map, and RobotGoto drives it, waypoint by waypoint.

Clients of every side send it goals through the gateway. Replace `wave_search.plan`, and keep the rest.
"""

from __future__ import annotations

from typing import Any

from wave_search import plan

from bridge.client.actions import SentGoal
from bridge.hub.wire.qos import LATCHED
from bridge.messages.actions import GoalState
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from bridge.modules.module import Module
from navigation.constraints import Constraints
from navigation.frames import FramesError, RobotFrames
from navigation.goals import GONE, Clients, CurrentGoal, goal_of, result
from navigation.map_in_use import MapInUse
from navigation.messages import NAVIGATE, pose_message
from navigation.pose import Pose
from navigation.status import Fault, PlanError, PlannerStatus, State


class Wavefront(Module):
    """Option: ``robot_radius``, in meters, within which the floor around the robot's center must be free."""

    def start(self, host: Host, section: Any) -> None:
        """Open the planner's action, and a client of the driver's action."""
        settings, name = host.config.navigation, f"/planner/{host.name}"
        self._radius, self._frame = float(section.options.get("robot_radius", 0.35)), settings.frame
        self._frames = RobotFrames(host, settings.frame, settings.base_frame)
        self._map = MapInUse(host, settings.map, lambda _grid: None)
        self._driver = host.node.action_client("/planner/robot_goto/navigate_to_pose", NAVIGATE)
        self._path = host.node.publisher(f"{name}/path", "nav_msgs/msg/Path", LATCHED)
        self._waypoints: list[Pose] = []
        self._sent: SentGoal | None = None
        self._goal = CurrentGoal(host.loop, self._stop)
        server = host.node.action_server(f"{name}/navigate_to_pose", NAVIGATE, self._on_goal, self._goal.cancel)
        Clients(host, server, lambda: self._stop(GONE))
        self._map.update()

    def stop(self) -> None:
        """Stop the robot with the module."""
        self._stop("the planner has stopped")
        self._map.close()

    def _on_goal(self, goal: Goal) -> bool:
        grid = self._map.grid
        if grid is None:
            goal.abort(result(Fault.NO_MAP, self._map.trouble))
            return True
        try:
            place, _constraints = goal_of(goal.goal, self._frames, tuple)
            self._waypoints = plan(grid, self._frames.pose(), place.pose, self._radius)
        except (PlanError, FramesError) as err:
            goal.abort(result(getattr(err, "fault", Fault.NOT_LOCALIZED), str(err)))
            return True
        self._goal.replace(goal)
        stamped = [{"pose": pose_message(pose)} for pose in self._waypoints]
        self._path.publish({"header": {"frame_id": self._frame}, "poses": stamped})
        self._drive()
        return True

    def _drive(self) -> None:
        """Send the driver the next waypoint, which it passes without a stop, or the goal, which has a heading."""
        waypoint = self._waypoints.pop(0)
        passing = Constraints(through=True, heading=False) if self._waypoints else Constraints()
        stamped = {"header": {"frame_id": self._frame}, "pose": pose_message(waypoint)}
        goal = {"pose": stamped, "behavior_tree": passing.to_text()}
        self._sent = self._driver.send(goal, self._on_end, self._goal.goal.feedback if self._goal.goal else None)

    def _on_end(self, sent: SentGoal, result: dict[str, Any] | None, why: str) -> None:
        if sent is not self._sent:
            return  # another goal replaced it
        if sent.status is not GoalState.SUCCEEDED:
            reason = (result or {}).get("error_msg") or why or "the driver has ended the goal"
            self._goal.end(PlannerStatus(State.ABORTED, reason, Fault.NO_NAVIGATOR))
        elif self._waypoints:
            self._drive()
        else:
            self._goal.end(PlannerStatus(State.REACHED))

    def _stop(self, reason: str) -> None:
        sent, self._sent = self._sent, None
        if sent is not None and sent.active:
            sent.cancel()
        self._goal.end(PlannerStatus(State.IDLE, reason, Fault.OTHER))
