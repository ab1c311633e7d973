"""INavigation2D on the wire, and its server for planners: goals, control, velocities (`INavigation2DMsgs.thrift`).

Requests are the same in all releases from 3.6 on; ``follow_path`` was added in 3.10. Maps and localization are on other
servers, and some results are computed by the client: see `yarp_compat.dev.navigation2d_client`. Like YARP's
``navigation2D_nws_yarp``, ``ServiceServer(port, Navigation2DServer(Mine()))`` offers a planner at a port::

    class Mine:
        def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> None: ...
        def getNavigationStatus(self) -> str: return "moving"
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - the names are those of YARP's .thrift file

from __future__ import annotations

import math

from yarp_compat.dev.fields import VocabEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.server import DeviceCalls
from yarp_compat.dev.service import Service, rpc
from yarp_compat.overriding import override

_STATUS = "navigation_status_"


class NavigationStatusEnum(VocabEnum):
    """The state of a planner."""

    navigation_status_idle = "idle"
    navigation_status_preparing_before_move = "prep"
    navigation_status_moving = "movg"
    navigation_status_waiting_obstacle = "wait"
    navigation_status_goal_reached = "rech"
    navigation_status_aborted = "abrt"
    navigation_status_failing = "fail"
    navigation_status_paused = "paus"
    navigation_status_thinking = "thnk"
    navigation_status_error = "err"

    @property
    def ended(self) -> bool:
        """Whether the robot no longer drives to a target."""
        return self.name.removeprefix(_STATUS) in ("idle", "goal_reached", "aborted", "failing", "error")


class TrajectoryTypeEnum(VocabEnum):
    """The requested kind of waypoints."""

    global_trajectory = "glob"
    local_trajectory = "loca"


class NavigationMapTypeEnum(VocabEnum):
    """The requested kind of map."""

    global_map = "glob"
    local_map = "loca"


def stringToStatus(s: str) -> NavigationStatusEnum:
    """Return the status with a name such as ``navigation_status_moving`` or ``moving``; else the error status."""
    try:
        return NavigationStatusEnum[_STATUS + s.removeprefix(_STATUS)]
    except KeyError:
        return NavigationStatusEnum.navigation_status_error


def statusToString(status: NavigationStatusEnum) -> str:
    """Return the text of a status, as in ``status:o``."""
    return status.name


@rpc
class INavigation2DMsgs(Service):
    """The methods of a planner's port: meters, degrees, seconds; relative targets are in the robot's frame.

    Servers of 3.12 and 4.0 ignore the timeout of a velocity, and assume 0.1 s.
    """

    def stop_navigation_RPC(self) -> ReturnValue: ...
    def resume_navigation_RPC(self) -> ReturnValue: ...
    def suspend_navigation_RPC(self, time_s: float) -> ReturnValue: ...  # infinite: until resumed
    def recompute_current_navigation_path_RPC(self) -> ReturnValue: ...
    def get_navigation_status_RPC(self) -> tuple[ReturnValue, NavigationStatusEnum]: ...
    def get_current_nav_waypoint_RPC(self) -> tuple[ReturnValue, Map2DLocation]: ...
    def get_all_navigation_waypoints_RPC(
        self, trajectory_type: TrajectoryTypeEnum
    ) -> tuple[ReturnValue, Map2DPath]: ...
    def get_current_navigation_map_RPC(self, map_type: NavigationMapTypeEnum) -> tuple[ReturnValue, MapGrid2D]: ...

    def goto_target_by_absolute_location_RPC(self, loc: Map2DLocation) -> ReturnValue: ...
    def follow_path_RPC(self, path: Map2DPath) -> ReturnValue: ...
    def goto_target_by_relative_location1_RPC(self, x: float, y: float) -> ReturnValue: ...  # with any heading
    def goto_target_by_relative_location2_RPC(self, x: float, y: float, theta: float) -> ReturnValue: ...
    def get_absolute_location_of_current_target_RPC(self) -> tuple[ReturnValue, Map2DLocation]: ...
    def get_relative_location_of_current_target_RPC(self) -> tuple[ReturnValue, float, float, float]: ...
    def goto_target_by_absolute_location_and_set_name_RPC(self, loc: Map2DLocation, name: str) -> ReturnValue: ...

    def apply_velocity_command_RPC(
        self, x_vel: float, y_vel: float, theta_vel: float, timeout: float
    ) -> ReturnValue: ...
    def get_last_velocity_command_RPC(self) -> tuple[ReturnValue, float, float, float]: ...
    def get_name_of_current_target_RPC(self) -> tuple[ReturnValue, str]: ...


_NO_TARGET = "no target"
_FARTHEST = 1e7  # meters: beyond any map


class Navigation2DServer(INavigation2DMsgs):
    """Serves a device. It validates arguments first: a goal must be within 10,000 km, a path must have waypoints.

    A heading of NaN means any heading, as for YARP's robotGoto. ``target_name`` is the name of the current target, or
    "".

    Args:
        device: any object with the methods of YARP's INavigation2DTargetActions, ...ControlActions and
            ...VelocityActions, or some of them; see `DeviceCalls`. They are called on the connections' threads,
            several at a time. ``getNavigationStatus`` returns a status or its name (``moving``);
            ``gotoTargetByRelativeLocation`` always receives a heading.
    """

    def __init__(self, device: object) -> None:
        super().__init__()
        self._calls = DeviceCalls(device)
        self.target_name = ""

    @override
    def stop_navigation_RPC(self) -> ReturnValue:
        self.target_name = ""
        return self._calls.done("stopNavigation")

    @override
    def resume_navigation_RPC(self) -> ReturnValue:
        return self._calls.done("resumeNavigation")

    @override
    def suspend_navigation_RPC(self, time_s: float) -> ReturnValue:
        """Pause for ``time_s`` seconds, or until resumed if it is 0 or less, like YARP's robotGoto."""
        return self._calls.done("suspendNavigation", time_s if time_s > 0 else math.inf)

    @override
    def recompute_current_navigation_path_RPC(self) -> ReturnValue:
        return self._calls.done("recomputeCurrentNavigationPath")

    @override
    def get_navigation_status_RPC(self) -> tuple[ReturnValue, NavigationStatusEnum]:
        status = self._calls.result("getNavigationStatus", lacking="no status")
        if isinstance(status, str):
            status = NavigationStatusEnum[f"navigation_status_{status.removeprefix('navigation_status_')}"]
        return OK, status

    @override
    def get_current_nav_waypoint_RPC(self) -> tuple[ReturnValue, Map2DLocation]:
        return OK, self._calls.result("getCurrentNavigationWaypoint", lacking="no waypoint")

    @override
    def get_all_navigation_waypoints_RPC(self, trajectory_type: TrajectoryTypeEnum) -> tuple[ReturnValue, Map2DPath]:
        return OK, self._calls.result("getAllNavigationWaypoints", trajectory_type, lacking="no path")

    @override
    def get_current_navigation_map_RPC(self, map_type: NavigationMapTypeEnum) -> tuple[ReturnValue, MapGrid2D]:
        return OK, self._calls.result("getCurrentNavigationMap", map_type, lacking="no such map")

    @override
    def goto_target_by_absolute_location_RPC(self, loc: Map2DLocation) -> ReturnValue:
        return self.goto_target_by_absolute_location_and_set_name_RPC(loc, "")

    @override
    def goto_target_by_absolute_location_and_set_name_RPC(self, loc: Map2DLocation, name: str) -> ReturnValue:
        _check_goal(loc.x, loc.y, loc.theta)
        outcome = self._calls.done("gotoTargetByAbsoluteLocation", loc)
        if outcome:
            self.target_name = name
        return outcome

    @override
    def goto_target_by_relative_location1_RPC(self, x: float, y: float) -> ReturnValue:
        return self.goto_target_by_relative_location2_RPC(x, y, math.nan)

    @override
    def goto_target_by_relative_location2_RPC(self, x: float, y: float, theta: float) -> ReturnValue:
        _check_goal(x, y, theta)
        outcome = self._calls.done("gotoTargetByRelativeLocation", x, y, theta)
        return self._unnamed(outcome)

    @override
    def follow_path_RPC(self, path: Map2DPath) -> ReturnValue:
        if not path.waypoints:
            raise CallFailed(ReturnCode.METHOD_FAILED, "the path has no waypoints")
        for place in path:
            _check_goal(place.x, place.y, place.theta)
        return self._unnamed(self._calls.done("followPath", path))

    @override
    def get_absolute_location_of_current_target_RPC(self) -> tuple[ReturnValue, Map2DLocation]:
        return OK, self._calls.result("getAbsoluteLocationOfCurrentTarget", lacking=_NO_TARGET)

    @override
    def get_relative_location_of_current_target_RPC(self) -> tuple[ReturnValue, float, float, float]:
        x, y, theta = self._calls.result("getRelativeLocationOfCurrentTarget", lacking=_NO_TARGET)
        return OK, x, y, theta

    @override
    def get_name_of_current_target_RPC(self) -> tuple[ReturnValue, str]:
        return OK, self.target_name

    @override
    def apply_velocity_command_RPC(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> ReturnValue:
        _check_finite(x_vel, y_vel, theta_vel, timeout)
        return self._calls.done("applyVelocityCommand", x_vel, y_vel, theta_vel, timeout)

    @override
    def get_last_velocity_command_RPC(self) -> tuple[ReturnValue, float, float, float]:
        x, y, theta = self._calls.result("getLastVelocityCommand", lacking="no command yet")
        return OK, x, y, theta

    def _unnamed(self, outcome: ReturnValue) -> ReturnValue:
        if outcome:
            self.target_name = ""
        return outcome


def _check_goal(x: float, y: float, theta: float) -> None:
    _check_finite(x, y, 0.0 if math.isnan(theta) else theta)
    if max(abs(x), abs(y)) > _FARTHEST:
        raise CallFailed(ReturnCode.METHOD_FAILED, f"({x:g}, {y:g}) is beyond any map")


def _check_finite(*numbers: float) -> None:
    if not all(map(math.isfinite, numbers)):
        raise CallFailed(ReturnCode.METHOD_FAILED, f"{numbers} are not all finite numbers")
