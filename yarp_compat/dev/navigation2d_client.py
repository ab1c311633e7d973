"""``INavigation2D`` as YARP users know it (`yarp/dev/INavigation2D.h`, `navigation2D_nwc_yarp`), and the Python way.

with Navigation2DClient("/navigationServer", "/mapServer", "/localizationServer") as robot:
    robot.go("kitchen")
    while not robot.status.ended: ...
    robot.gotoTargetByLocationName("kitchen")      # as in C++: true where it succeeded

Metres, degrees, seconds. What is filled in, and what is returned where nothing is: see `yarp_compat.dev.returnvalue`.
"""

from __future__ import annotations

import math
import time
from contextlib import ExitStack
from typing import Any, Self, Unpack

from yarp_compat.dev.basecontrol import DEFAULT_TIMEOUT
from yarp_compat.dev.client import ClientOptions, ServiceClient
from yarp_compat.dev.imap2d import IMap2DMsgs
from yarp_compat.dev.inavigation2d import (
    INavigation2DMsgs,
    NavigationMapTypeEnum,
    NavigationStatusEnum,
    TrajectoryTypeEnum,
)
from yarp_compat.dev.localization2d import ILocalization2D, ILocalization2DMsgs
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DPath
from yarp_compat.dev.map2d_client import IMap2D, succeeded
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import OK, ReturnCode, ReturnValue, asked, called, given, outcome_of, three
from yarp_compat.dev.service import Service
from yarp_compat.ports.sockets import Openable
from yarp_compat.pythonic import Server
from yarp_compat.wire.values import Vocab

_PERIOD = 0.1  # seconds between two questions for the status

_ERROR = NavigationStatusEnum.navigation_status_error


class INavigation2D(IMap2D, ILocalization2D):
    """All that a navigating robot can be asked, of three servers. What YARP's client computes, this computes too."""

    def __init__(self, navigation: INavigation2DMsgs, maps: IMap2DMsgs, localization: ILocalization2DMsgs) -> None:
        IMap2D.__init__(self, maps)
        ILocalization2D.__init__(self, localization)
        self._navigation = navigation

    # -- INavigation2DTargetActions -----------------------------------------------------------------------------------

    gotoTargetByAbsoluteLocation = outcome_of(INavigation2DMsgs.goto_target_by_absolute_location_RPC, "_navigation")
    followPath = outcome_of(INavigation2DMsgs.follow_path_RPC, "_navigation")

    def getAbsoluteLocationOfCurrentTarget(self, loc: Map2DLocation | None = None) -> Any:
        """The current target's pose."""
        method = self._navigation.get_absolute_location_of_current_target_RPC
        return asked(method, into=loc, default=Map2DLocation())

    def gotoTargetByRelativeLocation(self, x: float, y: float, theta: float | None = None) -> ReturnValue:
        """Drive to a place in the robot's frame; in any heading where none is given."""
        if theta is None:
            return called(self._navigation.goto_target_by_relative_location1_RPC, x, y)
        return called(self._navigation.goto_target_by_relative_location2_RPC, x, y, theta)

    def getRelativeLocationOfCurrentTarget(self) -> tuple[ReturnValue, float, float, float]:
        """The outcome, and where the robot is going in its own frame: x, y, theta."""
        return three(self._navigation.get_relative_location_of_current_target_RPC)

    # -- INavigation2DControlActions ----------------------------------------------------------------------------------

    def getNavigationStatus(self, status: list[Any] | None = None) -> Any:
        """The state of the navigation."""
        return asked(self._navigation.get_navigation_status_RPC, into=status, default=_ERROR)

    stopNavigation = outcome_of(INavigation2DMsgs.stop_navigation_RPC, "_navigation")

    def suspendNavigation(self, time_s: float = math.inf) -> ReturnValue:
        """Stand still for so long, or until it is resumed."""
        return called(self._navigation.suspend_navigation_RPC, time_s)

    resumeNavigation = outcome_of(INavigation2DMsgs.resume_navigation_RPC, "_navigation")
    recomputeCurrentNavigationPath = outcome_of(INavigation2DMsgs.recompute_current_navigation_path_RPC, "_navigation")

    def getAllNavigationWaypoints(self, trajectory_type: TrajectoryTypeEnum, waypoints: Map2DPath | None = None) -> Any:
        """The way."""
        method = self._navigation.get_all_navigation_waypoints_RPC
        return asked(method, trajectory_type, into=waypoints, default=Map2DPath())

    def getCurrentNavigationWaypoint(self, curr_waypoint: Map2DLocation | None = None) -> Any:
        """The waypoint that it drives to."""
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
        return three(self._navigation.get_last_velocity_command_RPC)

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


class Navigation2DClient(Openable, INavigation2D):
    """A client of three servers, between ``with`` and its end; each is connected again where it was away.

    With a name, ``<name>/user_commands/rpc`` answers people: ``gotoLocation NAME``, ``listLocations``, ``help``.
    """

    def __init__(
        self,
        navigation: str = "/navigation2D_nws_yarp",  # begins the names of the planner's ports
        maps: str = "/map2D_nws_yarp",  # begins those of the map server; empty: no map server, and what needs it fails
        # begins those of the localisation server; empty: no such server
        localization: str = "/localization2D_nws_yarp",
        name: str = "",  # begins the names of the own ports; empty lets the name server choose names
        **options: Unpack[ClientOptions],  # as of `ClientOptions`
    ) -> None:
        self._open = ExitStack()
        self._clients: list[ServiceClient[Any]] = []

        def reached(interface: type[Service], server: str, own: str) -> Any:
            if not server:
                return _Nobody()
            mine = name and f"{name}/{own}/rpc"
            client = ServiceClient(interface, f"{server}/rpc", mine, **options)
            self._clients.append(client)
            return client.remote

        super().__init__(
            reached(INavigation2DMsgs, navigation, "navigation"),
            reached(IMap2DMsgs, maps, "locations"),
            reached(ILocalization2DMsgs, localization, "localization"),
        )
        naming = options.get("naming")
        self._people = Server(f"{name}/user_commands/rpc", self._respond, naming=naming) if name else None

    def open(self) -> Self:
        """Open the ports and connect them; errors as of `ServiceClient.open`."""
        with ExitStack() as opened:
            for client in self._clients:
                opened.enter_context(client)
            if self._people is not None:
                opened.enter_context(self._people)
            self._open = opened.pop_all()
        return self

    def close(self) -> None:
        """Close the ports."""
        self._open.close()

    # -- the Python way: errors are exceptions ------------------------------------------------------------------------

    def go(self, place: str | Map2DLocation) -> None:
        """Drive to a location, area or path by its name, or to a pose; raises `CallFailed` where none or refused."""
        go = self.gotoTargetByLocationName if isinstance(place, str) else self.gotoTargetByAbsoluteLocation
        succeeded(go(place))  # type: ignore[arg-type] # each takes its own

    @property
    def status(self) -> NavigationStatusEnum:
        """The planner's state; raises `CallFailed` where it does not say, `OSError` where it does not answer."""
        outcome, status = self._navigation.get_navigation_status_RPC()
        succeeded(outcome)
        return status

    def wait(self, timeout: float | None = None) -> NavigationStatusEnum:
        """Wait until the robot is under way no more, for its status then; raises `TimeoutError`, and as `status`."""
        end = None if timeout is None else time.monotonic() + timeout
        while not (status := self.status).ended:
            if end is not None and time.monotonic() > end:
                raise TimeoutError(f"after {timeout} s the robot is still under way: {status.name}")
            time.sleep(_PERIOD)
        return status

    def _respond(self, words: list[Any]) -> list[Any]:
        """Answers people as upstream's client does; unlike there, ``gotoLocation`` reports a failure."""
        verb, *rest = [str(word) for word in words] or [""]
        if verb == "gotoLocation":
            return [Vocab("ok" if rest and self.gotoTargetByLocationName(rest[0]) else "fail")]
        if verb == "listLocations":
            names: list[str] = []
            self.getLocationsList(names)
            return [Vocab("many"), *names]
        if verb == "help":
            return [Vocab("many"), "gotoLocation <locationName>", "listLocations"]
        return [Vocab("err")]


class _Nobody:
    """Stands for a server that was not given."""

    def __getattr__(self, name: str) -> Any:
        def call(*_: Any) -> Any:
            raise ConnectionRefusedError(f"{name}: no such server was given")

        return call
