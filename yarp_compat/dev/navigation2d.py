"""``INavigation2D`` as YARP users know it (`yarp/dev/INavigation2D.h`, `navigation2D_nwc_yarp`).

Metres, degrees, seconds. What is filled in, and what is returned where nothing is: see `yarp_compat.dev.outcome`.
"""

from __future__ import annotations

import math
from typing import Any

from yarp_compat.dev.basecontrol import DEFAULT_TIMEOUT
from yarp_compat.dev.ilocalization2d import ILocalization2DMsgs
from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.inavigation2d import (
    INavigation2DMsgs,
    NavigationMapTypeEnum,
    NavigationStatusEnum,
    TrajectoryTypeEnum,
)
from yarp_compat.dev.localization2d_client import ILocalization2D
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DPath
from yarp_compat.dev.map2d_client import IMap2D
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.outcome import answered, asked, called, given
from yarp_compat.dev.returnvalue import OK, ReturnCode, ReturnValue

_ERROR = NavigationStatusEnum.navigation_status_error


class INavigation2D(IMap2D, ILocalization2D):
    """All that a navigating robot can be asked, of three servers. What YARP's client computes, this computes too.

    Args:
        navigation: the planner.
        maps: the map server.
        localization: the localisation server.
    """

    def __init__(self, navigation: INavigation2DMsgs, maps: IMap2DMsgs, localization: ILocalization2DMsgs) -> None:
        IMap2D.__init__(self, maps)
        ILocalization2D.__init__(self, localization)
        self._navigation = navigation

    # -- INavigation2DTargetActions -----------------------------------------------------------------------------------

    def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> ReturnValue:
        """Drive to a pose on a map."""
        return called(self._navigation.goto_target_by_absolute_location_RPC, loc)

    def followPath(self, path: Map2DPath) -> ReturnValue:
        """Drive along a way."""
        return called(self._navigation.follow_path_RPC, path)

    def getAbsoluteLocationOfCurrentTarget(self, loc: Map2DLocation | None = None) -> Any:
        """Where the robot is going."""
        method = self._navigation.get_absolute_location_of_current_target_RPC
        return asked(method, into=loc, default=Map2DLocation())

    def gotoTargetByRelativeLocation(self, x: float, y: float, theta: float | None = None) -> ReturnValue:
        """Drive to a place in the robot's frame; in any heading where none is given."""
        if theta is None:
            return called(self._navigation.goto_target_by_relative_location1_RPC, x, y)
        return called(self._navigation.goto_target_by_relative_location2_RPC, x, y, theta)

    def getRelativeLocationOfCurrentTarget(self) -> tuple[ReturnValue, float, float, float]:
        """The outcome, and where the robot is going in its own frame: x, y, theta."""
        return _three(answered(self._navigation.get_relative_location_of_current_target_RPC))

    # -- INavigation2DControlActions ----------------------------------------------------------------------------------

    def getNavigationStatus(self, status: list[Any] | None = None) -> Any:
        """How it is getting on."""
        return asked(self._navigation.get_navigation_status_RPC, into=status, default=_ERROR)

    def stopNavigation(self) -> ReturnValue:
        """End it for good."""
        return called(self._navigation.stop_navigation_RPC)

    def suspendNavigation(self, time_s: float = math.inf) -> ReturnValue:
        """Stand still for so long, or until it is resumed."""
        return called(self._navigation.suspend_navigation_RPC, time_s)

    def resumeNavigation(self) -> ReturnValue:
        """Go on where it was suspended."""
        return called(self._navigation.resume_navigation_RPC)

    def recomputeCurrentNavigationPath(self) -> ReturnValue:
        """Find the way anew."""
        return called(self._navigation.recompute_current_navigation_path_RPC)

    def getAllNavigationWaypoints(self, trajectory_type: TrajectoryTypeEnum, waypoints: Map2DPath | None = None) -> Any:
        """The way."""
        method = self._navigation.get_all_navigation_waypoints_RPC
        return asked(method, trajectory_type, into=waypoints, default=Map2DPath())

    def getCurrentNavigationWaypoint(self, curr_waypoint: Map2DLocation | None = None) -> Any:
        """Where it drives to just now."""
        return asked(self._navigation.get_current_nav_waypoint_RPC, into=curr_waypoint, default=Map2DLocation())

    def getCurrentNavigationMap(self, map_type: NavigationMapTypeEnum, themap: MapGrid2D | None = None) -> Any:
        """The map that it goes by."""
        return asked(self._navigation.get_current_navigation_map_RPC, map_type, into=themap, default=MapGrid2D())

    # -- INavigation2DVelocityActions ---------------------------------------------------------------------------------

    def applyVelocityCommand(
        self, x_vel: float, y_vel: float, theta_vel: float, timeout: float = DEFAULT_TIMEOUT
    ) -> ReturnValue:
        """Drive: m/s, m/s, deg/s, for so many seconds."""
        return called(self._navigation.apply_velocity_command_RPC, x_vel, y_vel, theta_vel, timeout)

    def getLastVelocityCommand(self) -> tuple[ReturnValue, float, float, float]:
        """The outcome, and what was commanded last: m/s, m/s, deg/s."""
        return _three(answered(self._navigation.get_last_velocity_command_RPC))

    # -- INavigation2DExtraActions ------------------------------------------------------------------------------------

    def gotoTargetByLocationName(self, location_or_area_name: str) -> ReturnValue:
        """Drive to a location, into an area, or along a path that the map server knows; else stop the robot."""
        name = location_or_area_name
        place, area, path = Map2DLocation(), Map2DArea(), Map2DPath()
        if not self.getLocation(name, place):
            inside = area.getRandomLocation() if self.getArea(name, area) else None
            if inside is None:
                if self.getPath(name, path):
                    return self.followPath(path)
                self.stopNavigation()
                return ReturnValue(ReturnCode.METHOD_FAILED)
            place = inside
        return called(self._navigation.goto_target_by_absolute_location_and_set_name_RPC, place, name)

    def checkNearToLocation(
        self,
        loc: Map2DLocation | str,
        is_near: list[bool] | None,
        linear_tolerance: float,
        angular_tolerance: float = math.inf,
    ) -> Any:
        """Whether the robot is so many metres and degrees from a pose, or a location of the map server, or nearer."""
        place = loc if isinstance(loc, Map2DLocation) else Map2DLocation()
        outcome = OK if place is loc else self.getLocation(str(loc), place)
        here = Map2DLocation()
        outcome = outcome and self.getCurrentPosition(here)
        return given(outcome, bool(outcome) and here.is_near_to(place, linear_tolerance, angular_tolerance), is_near)

    def checkInsideArea(self, area: Map2DArea | str, is_inside: list[bool] | None = None) -> Any:
        """Whether the robot is in an area, or in one of the map server."""
        shape = area if isinstance(area, Map2DArea) else Map2DArea()
        outcome = OK if shape is area else self.getArea(str(area), shape)
        here = Map2DLocation()
        outcome = outcome and self.getCurrentPosition(here)
        return given(outcome, bool(outcome) and shape.checkLocationInsideArea(here), is_inside)

    def findCurrentArea(self, area_name: list[str] | None = None, area: Map2DArea | None = None) -> Any:
        """The first area, by name, that the robot is in, and its name: empty where it is in none."""
        names: list[str] = []
        here, found, name = Map2DLocation(), Map2DArea(), ""
        outcome = self.getCurrentPosition(here)
        outcome = outcome and self.getAreasList(names)
        for each in names:
            shape = Map2DArea()
            outcome = self.getArea(each, shape)
            if not outcome:
                break
            if shape.checkLocationInsideArea(here):
                name, found = each, shape
                break
        if area is not None:
            given(outcome, found, area)
        return given(outcome, name, area_name)

    def getNameOfCurrentTarget(self, location_name: list[str] | None = None) -> Any:
        """The name of the place where the robot is going; empty where it has none."""
        return asked(self._navigation.get_name_of_current_target_RPC, into=location_name, default="")

    def storeCurrentPosition(self, location_name: str) -> ReturnValue:
        """Keep where the robot is as a location of the map server."""
        here = Map2DLocation()
        outcome: ReturnValue = self.getCurrentPosition(here)
        return outcome and self.storeLocation(location_name, here)


def _three(answer: tuple[Any, ...]) -> tuple[ReturnValue, float, float, float]:
    outcome, *numbers = answer
    x, y, theta = numbers if outcome else (0.0, 0.0, 0.0)
    return outcome, x, y, theta
