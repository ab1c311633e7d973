"""INavigation2D on the wire: goals, their control, and velocities (`INavigation2DMsgs.thrift`, `INavigation2D.h`).

Requests are the same in all releases from 3.6 on; ``follow_path`` came with 3.10. Maps, localisation, and what YARP's
client computes from them, are asked of other servers: see `yarp_compat.dev.navigation2d_client`.
"""

# mypy: disable-error-code="empty-body"
# ruff: noqa: D102 - names and arguments are those of YARP's .thrift file, and say what each does

from __future__ import annotations

from enum import Enum

from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import ReturnValue
from yarp_compat.dev.service import Service, rpc

_STATUS = "navigation_status_"


class NavigationStatusEnum(Enum):
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
        """Whether no target is under way any more."""
        return self.name.removeprefix(_STATUS) in ("idle", "goal_reached", "aborted", "failing", "error")


class TrajectoryTypeEnum(Enum):
    """Which waypoints are asked for."""

    global_trajectory = "glob"
    local_trajectory = "loca"


class NavigationMapTypeEnum(Enum):
    """Which map is asked for."""

    global_map = "glob"
    local_map = "loca"


def stringToStatus(s: str) -> NavigationStatusEnum:
    """The status of a text, ``navigation_status_moving`` or ``moving``; of any other, that of an error."""
    try:
        return NavigationStatusEnum[_STATUS + s.removeprefix(_STATUS)]
    except KeyError:
        return NavigationStatusEnum.navigation_status_error


def statusToString(status: NavigationStatusEnum) -> str:
    """The text of a status, as ``status:o`` sends it."""
    return status.name


@rpc
class INavigation2DMsgs(Service):
    """The methods of a planner's port: metres, degrees, seconds; what is relative is in the robot's frame.

    Servers of 3.12 and 4.0 forget how long a velocity holds, and take 0.1 s.
    """

    def stop_navigation_RPC(self) -> ReturnValue: ...
    def resume_navigation_RPC(self) -> ReturnValue: ...
    def suspend_navigation_RPC(self, time_s: float) -> ReturnValue: ...  # infinite: for ever
    def recompute_current_navigation_path_RPC(self) -> ReturnValue: ...
    def get_navigation_status_RPC(self) -> tuple[ReturnValue, NavigationStatusEnum]: ...
    def get_current_nav_waypoint_RPC(self) -> tuple[ReturnValue, Map2DLocation]: ...
    def get_all_navigation_waypoints_RPC(
        self, trajectory_type: TrajectoryTypeEnum
    ) -> tuple[ReturnValue, Map2DPath]: ...
    def get_current_navigation_map_RPC(self, map_type: NavigationMapTypeEnum) -> tuple[ReturnValue, MapGrid2D]: ...

    def goto_target_by_absolute_location_RPC(self, loc: Map2DLocation) -> ReturnValue: ...
    def follow_path_RPC(self, path: Map2DPath) -> ReturnValue: ...
    def goto_target_by_relative_location1_RPC(self, x: float, y: float) -> ReturnValue: ...  # in any heading
    def goto_target_by_relative_location2_RPC(self, x: float, y: float, theta: float) -> ReturnValue: ...
    def get_absolute_location_of_current_target_RPC(self) -> tuple[ReturnValue, Map2DLocation]: ...
    def get_relative_location_of_current_target_RPC(self) -> tuple[ReturnValue, float, float, float]: ...
    def goto_target_by_absolute_location_and_set_name_RPC(self, loc: Map2DLocation, name: str) -> ReturnValue: ...

    def apply_velocity_command_RPC(
        self, x_vel: float, y_vel: float, theta_vel: float, timeout: float
    ) -> ReturnValue: ...
    def get_last_velocity_command_RPC(self) -> tuple[ReturnValue, float, float, float]: ...
    def get_name_of_current_target_RPC(self) -> tuple[ReturnValue, str]: ...
