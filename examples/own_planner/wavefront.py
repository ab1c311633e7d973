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
from bridge.stores.kinds import AREA, BEHAVIOR
from navigation.constraints import Constraints
from navigation.frames import FramesError, RobotFrames
from navigation.goals import GONE, Clients, CurrentGoal, goal_of, result
from navigation.map_in_use import MapInUse
from navigation.messages import NAVIGATE, pose_message
from navigation.pose import Pose
from navigation.robot_path_planner.ground import Ground, Zone
from navigation.status import Fault, PlanError, PlannerStatus, State
from yarp_compat.dev.mapgrid import MapGrid2D


class Wavefront(Module):
    """Option: ``robot_radius``, the distance in meters that the robot's center keeps from walls and keep-out areas."""

    def start(self, host: Host, section: Any) -> None:
        """Open the planner's action, and a client of the driver's action."""
        settings, name = host.config.navigation, f"/planner/{host.name}"
        self._radius, self._frame = float(section.options.get("robot_radius", 0.35)), settings.frame
        self._frames = RobotFrames(host, settings.frame, settings.base_frame)
        self._store = host.store
        self._ground: Ground | None = None
        self._map = MapInUse(host, settings.map, self._use, AREA, BEHAVIOR)
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

    def _use(self, grid: MapGrid2D | None) -> None:
        """Use another map, or the same map with other areas."""
        areas = self._store.areas(grid.name if grid else "")
        zones = [Zone(*area) for area in areas.named.values()]
        self._ground = Ground(grid, self._radius, zones=zones, closed=areas.closed) if grid else None

    def _on_goal(self, goal: Goal) -> bool:
        if self._ground is None or self._map.unknown:
            goal.abort(result(Fault.NO_MAP, self._map.trouble))
            return True
        try:
            place, _constraints = goal_of(goal.goal, self._frames, tuple)
            self._waypoints = plan(self._ground, self._frames.pose(), place.pose)
        except (PlanError, FramesError) as err:
            goal.abort(result(getattr(err, "fault", Fault.NOT_LOCALIZED), str(err)))
            return True
        self._goal.replace(goal)
        poses = [{"pose": pose_message(pose)} for pose in self._waypoints]
        self._path.publish({"header": {"frame_id": self._frame}, "poses": poses})
        self._drive()
        return True

    def _drive(self) -> None:
        """Send the driver the next waypoint, which it passes without a stop, or the goal, which has a heading."""
        waypoint = self._waypoints.pop(0)
        tree = (Constraints(through=True, heading=False) if self._waypoints else Constraints()).to_text()
        goal = {"pose": {"header": {"frame_id": self._frame}, "pose": pose_message(waypoint)}, "behavior_tree": tree}
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
