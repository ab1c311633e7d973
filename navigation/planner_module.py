"""The base of the modules that drive to goals: their action on the hub, their topics and their YARP device."""

# ruff: noqa: N802, D102 - YARP's names, documented in `yarp_compat.dev.inavigation2d`

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable
from typing import Any

from typing_extensions import override

from bridge.hub.wire.qos import LATCHED
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.status import Part
from navigation.constraints import Constraints
from navigation.frames import FramesError, Localized, RobotFrames
from navigation.goals import GONE, Clients, CurrentGoal, FarClients, MapPlace, places_of, result
from navigation.messages import NAVIGATE, Message, duration, pose_message
from navigation.pose import Pose
from navigation.status import NO_GOAL, STATUS, Compiled, Fault, PlanError, PlannerStatus, State, status_message
from navigation.yarp import Calls, NavigationDevice, location_of
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import MapGrid2D

_FEEDBACK = 0.2  # seconds between two messages of feedback


class PlannerModule(Module):
    """A module that drives to one goal at a time. Used only on the module's thread."""

    def _open(self, host: Host, frames: RobotFrames) -> None:
        """Set up what all planners need."""
        self._host, self._frames = host, frames
        self.compiled, self._localized = Compiled(), Localized(host)  # without compiled kernels, goals are refused
        self._goal = CurrentGoal(host.loop, self.stop_driving)
        self._began, self._fed = 0.0, -math.inf

    def _serve(
        self, brake: Callable[[bytes], None] | None = None, name: str = "navigate_to_pose", kind: str = NAVIGATE
    ) -> None:
        """Serve an action, and abort the goals of clients that are cut off."""
        host, action = self._host, f"/planner/{self.name}/{name}"
        server = host.node.action_server(action, kind, self._on_goal, self._goal.cancel, brake=brake)
        if kind == NAVIGATE:
            self._server = server
        Clients(host, server, lambda: self._abort(GONE))
        FarClients(host, server, lambda goal, reason: self._abort(reason) if goal is self._goal.goal else None)

    @property
    @abstractmethod
    def target(self) -> MapPlace | None:
        """The place to which the module drives."""

    @property
    @abstractmethod
    def progress(self) -> PlannerStatus:
        """The state of the current goal."""

    @abstractmethod
    def map_name(self) -> str:
        """Return the name of the robot's map; empty if unknown."""

    @abstractmethod
    def drive(self, *places: MapPlace, constraints: Constraints | None = None, goal: Goal | None = None) -> None:
        """Drive to places in sequence, instead of the current goal; raises `PlanError` with a reason."""

    def drive_locally(self, *places: MapPlace) -> None:
        """Drive as `drive` does for a request that did not use the action, under a goal of the action.

        Without such a goal, the action's clients, such as the gateway, could neither see nor stop the drive.
        """
        goal = self._server.begin()
        try:
            self.drive(*places, goal=goal)
        except Exception as err:
            goal.abort(result(err.fault if isinstance(err, PlanError) else Fault.OTHER, str(err)))
            raise

    @abstractmethod
    def stop_driving(self, reason: str) -> None:
        """Cancel the goal and stop the robot."""

    @abstractmethod
    def pause(self, seconds: float) -> None:
        """Stop for ``seconds``, then drive on; raises `PlanError` without a goal."""

    @abstractmethod
    def resume(self) -> None:
        """Drive on; raises `PlanError` if the goal is not paused."""

    @abstractmethod
    def local_map(self) -> MapGrid2D | None:
        """Return the map of the laser's obstacles, or None."""

    @abstractmethod
    def _remaining(self, pose: Pose, passed: float) -> tuple[float, float, int]:
        """Return meters to the goal, the expected speed in m/s and the number of recoveries; `passed` in seconds."""

    def _poses_left(self) -> int:
        """Return how many poses of the goal are still to be reached."""
        return 1

    def _map_names(self) -> Collection[str]:
        """Return the names of maps that a goal's frame may have."""
        return ()

    def now(self) -> float:
        """Return the planner's time in seconds: of the simulated clock if there is one, else monotonic."""
        clock = self._host.clock
        return clock.now_ns() / 1e9 if clock.simulated else time.monotonic()

    def pose(self) -> Pose:
        """Return the robot's pose on the map; raises `FramesError` with the reason if it is unknown."""
        self._localized.check()
        return self._frames.pose()

    def _pose_now(self) -> Pose | None:
        try:
            return self.pose()
        except FramesError:
            return None

    def halt(self) -> dict[str, Any]:
        """Cancel the goal of any client."""
        self.stop_driving("halted")
        return {"halted": True}

    def _abort(self, reason: str, fault: Fault = Fault.NO_NAVIGATOR) -> None:
        """Abort the goal and stop the robot."""
        self._goal.end(PlannerStatus(State.ABORTED, reason, fault))
        self.stop_driving(reason)

    def _on_goal(self, goal: Goal) -> bool:
        """Accept a goal of the action; abort an invalid one, since a rejection could not carry the reason."""
        try:
            places, wanted = places_of(goal.goal, self._frames, self._map_names)
            self.drive(*places, constraints=wanted, goal=goal)
        except PlanError as err:
            goal.abort(result(err.fault, str(err)))
        return True

    def _feed(self, pose: Pose | None) -> None:
        """Send feedback to the goal's client."""
        now, goal = self.now(), self._goal.goal
        if goal is None or pose is None or 0.0 <= now - self._fed < _FEEDBACK:
            return
        self._fed, passed = now, max(now - self._began, 0.0)
        left, speed, recoveries = self._remaining(pose, passed)
        header = {"stamp": self._host.clock.stamp(), "frame_id": self._frames.map_frame}
        goal.feedback({
            "current_pose": {"header": header, "pose": pose_message(pose)},
            "navigation_time": duration(passed),
            "estimated_time_remaining": duration(left / speed),
            "number_of_recoveries": recoveries,
            "distance_remaining": left,
            **({"number_of_poses_remaining": self._poses_left()} if "poses" in goal.goal else {}),
        })  # fmt: skip

    @override
    def status(self) -> Part:
        state, reason, fault = self.progress
        planner = {"state": state.value, "reason": reason, "fault": int(fault)}
        return Part(planner=planner, notes=list(self._notes))

    _notes: Iterable[str] = ()


class PlannerTopics:
    """The topics that all planners publish: status and path. Used only on the module's thread."""

    def __init__(self, host: Host, name: str, frame: str) -> None:
        self._host, self._frame, self._prefix = host, frame, f"/planner/{name}"
        self._status = host.node.publisher(f"{self._prefix}/status", STATUS, LATCHED, priority="state")
        self._path = host.node.publisher(f"{self._prefix}/path", "nav_msgs/msg/Path", LATCHED, priority="state")
        self._last: tuple[PlannerStatus, bytes] | None = None

    def _publish_status(self, status: PlannerStatus, target: Pose | None, goal_id: bytes = NO_GOAL) -> None:
        self._last = status, goal_id
        goal = None if target is None else {"header": self._header(), "pose": pose_message(target)}
        self._status.publish(status_message(self._host.clock.stamp(), status, goal_id=goal_id, goal=goal))

    def _publish_path(self, poses: Iterable[Pose]) -> None:
        header = self._header()
        stamped = [{"header": header, "pose": pose_message(pose)} for pose in poses]
        self._path.publish({"header": header, "poses": stamped})

    def _header(self) -> Message:
        return {"stamp": self._host.clock.stamp(), "frame_id": self._frame}


class PlannerDevice(NavigationDevice):
    """The YARP device of a planner; its methods run on connections' threads."""

    def __init__(self, module: PlannerModule, calls: Calls) -> None:
        super().__init__(calls)
        self._module = module

    def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> None:
        self._accept(lambda: self._module.drive_locally(place_of(loc)))

    def stopNavigation(self) -> None:
        self._do(lambda: self._module.stop_driving("stopped"))

    def suspendNavigation(self, seconds: float) -> None:
        self._do(lambda: self._module.pause(seconds))

    def resumeNavigation(self) -> None:
        self._move(self._module.resume)

    def getNavigationStatus(self) -> str:
        return self._module.progress.state.value

    @override
    def _go_to(self, pose: Pose) -> None:
        self._module.drive_locally(MapPlace("", pose))

    @override
    def _robot(self) -> Pose:
        return self._module.pose()

    @override
    def _target(self) -> Map2DLocation | None:
        target = self._module.target
        return None if target is None else location_of(target.map_name, target.pose)


def place_of(loc: Map2DLocation) -> MapPlace:
    """Return a YARP location as a place."""
    return MapPlace(loc.map_id, Pose(loc.x, loc.y, math.radians(loc.theta)))
