"""INavigation2D on the wire: goals, their control, and velocities (`INavigation2DMsgs.thrift`, `INavigation2D.h`).

Requests are the same in all releases from 3.6 on; ``follow_path`` came with 3.10. Maps, localisation, and what YARP's
client computes from them, are asked of other servers: see `yarp_compat.dev.navigation2d_client`.
"""

# mypy: disable-error-code="empty-body"

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
    """The methods of a planner's port, as YARP's service has them. Metres, degrees, seconds."""

    # -- control ------------------------------------------------------------------------------------------------------

    def stop_navigation_RPC(self) -> ReturnValue:
        """End it for good."""

    def resume_navigation_RPC(self) -> ReturnValue:
        """Go on where it was suspended."""

    def suspend_navigation_RPC(self, time_s: float) -> ReturnValue:
        """Stand still for so long; for ever where that is infinite."""

    def recompute_current_navigation_path_RPC(self) -> ReturnValue:
        """Find the way anew."""

    def get_navigation_status_RPC(self) -> tuple[ReturnValue, NavigationStatusEnum]:
        """The state of the navigation."""

    def get_current_nav_waypoint_RPC(self) -> tuple[ReturnValue, Map2DLocation]:
        """The waypoint that it drives to."""

    def get_all_navigation_waypoints_RPC(self, trajectory_type: TrajectoryTypeEnum) -> tuple[ReturnValue, Map2DPath]:
        """Its way."""

    def get_current_navigation_map_RPC(self, map_type: NavigationMapTypeEnum) -> tuple[ReturnValue, MapGrid2D]:
        """The map that it goes by."""

    # -- targets ------------------------------------------------------------------------------------------------------

    def goto_target_by_absolute_location_RPC(self, loc: Map2DLocation) -> ReturnValue:
        """Drive to a place."""

    def follow_path_RPC(self, path: Map2DPath) -> ReturnValue:
        """Drive along a way."""

    def goto_target_by_relative_location1_RPC(self, x: float, y: float) -> ReturnValue:
        """Drive to a place in the robot's frame, in any heading."""

    def goto_target_by_relative_location2_RPC(self, x: float, y: float, theta: float) -> ReturnValue:
        """Drive to a pose in the robot's frame."""

    def get_absolute_location_of_current_target_RPC(self) -> tuple[ReturnValue, Map2DLocation]:
        """The current target's pose."""

    def get_relative_location_of_current_target_RPC(self) -> tuple[ReturnValue, float, float, float]:
        """The current target's pose in the robot's frame: x, y, theta."""

    def goto_target_by_absolute_location_and_set_name_RPC(self, loc: Map2DLocation, name: str) -> ReturnValue:
        """Drive to a place that has a name."""

    # -- velocities ---------------------------------------------------------------------------------------------------

    def apply_velocity_command_RPC(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> ReturnValue:
        """Drive: m/s, m/s, deg/s, for so many seconds. Servers of 3.12 and 4.0 forget the seconds, and take 0.1."""

    def get_last_velocity_command_RPC(self) -> tuple[ReturnValue, float, float, float]:
        """The last command."""

    def get_name_of_current_target_RPC(self) -> tuple[ReturnValue, str]:
        """The name that the target was given; empty where it has none."""
