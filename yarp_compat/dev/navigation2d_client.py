"""A client of YARP's ``INavigation2D`` (`yarp/dev/INavigation2D.h`, `navigation2D_nwc_yarp`), with a Python interface.

with Navigation2DClient("/navigationServer", "/mapServer", "/localizationServer") as robot:
    robot.go("kitchen")
    while not robot.status.ended: ...
    robot.gotoTargetByLocationName("kitchen")      # as in C++: true if it succeeded

Meters, degrees, seconds. For filled-in and returned results, see `yarp_compat.dev.returnvalue`.
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
from yarp_compat.dev.returnvalue import (
    OK,
    ReturnCode,
    ReturnValue,
    deliver,
    fetch,
    fetch_three,
    invoke,
    outcome_of,
)
from yarp_compat.dev.service import Service
from yarp_compat.overriding import override
from yarp_compat.ports.sockets import Openable
from yarp_compat.pythonic import Server
from yarp_compat.wire.values import Vocab

_PERIOD = 0.1  # seconds between requests for the status

_ERROR = NavigationStatusEnum.navigation_status_error


class INavigation2D(IMap2D, ILocalization2D):
    """The navigation interface on three servers. Like YARP's client, it computes some results itself."""

    def __init__(self, navigation: INavigation2DMsgs, maps: IMap2DMsgs, localization: ILocalization2DMsgs) -> None:
        IMap2D.__init__(self, maps)
        ILocalization2D.__init__(self, localization)
        self._navigation = navigation

    # -- INavigation2DTargetActions -----------------------------------------------------------------------------------

    gotoTargetByAbsoluteLocation = outcome_of(INavigation2DMsgs.goto_target_by_absolute_location_RPC, "_navigation")
    followPath = outcome_of(INavigation2DMsgs.follow_path_RPC, "_navigation")

    def getAbsoluteLocationOfCurrentTarget(self, loc: Map2DLocation | None = None) -> Any:
        """Return the pose of the current target."""
        method = self._navigation.get_absolute_location_of_current_target_RPC
        return fetch(method, into=loc, default=Map2DLocation())

    def gotoTargetByRelativeLocation(self, x: float, y: float, theta: float | None = None) -> ReturnValue:
        """Drive to a pose in the robot's frame; without ``theta``, with any heading."""
        if theta is None:
            return invoke(self._navigation.goto_target_by_relative_location1_RPC, x, y)
        return invoke(self._navigation.goto_target_by_relative_location2_RPC, x, y, theta)

    def getRelativeLocationOfCurrentTarget(self) -> tuple[ReturnValue, float, float, float]:
        """Return the outcome and the current target in the robot's frame: x, y, theta."""
        return fetch_three(self._navigation.get_relative_location_of_current_target_RPC)

    # -- INavigation2DControlActions ----------------------------------------------------------------------------------

    def getNavigationStatus(self, status: list[Any] | None = None) -> Any:
        """Return the state of the navigation."""
        return fetch(self._navigation.get_navigation_status_RPC, into=status, default=_ERROR)

    stopNavigation = outcome_of(INavigation2DMsgs.stop_navigation_RPC, "_navigation")

    def suspendNavigation(self, time_s: float = math.inf) -> ReturnValue:
        """Pause for ``time_s`` seconds, by default until resumed."""
        return invoke(self._navigation.suspend_navigation_RPC, time_s)

    resumeNavigation = outcome_of(INavigation2DMsgs.resume_navigation_RPC, "_navigation")
    recomputeCurrentNavigationPath = outcome_of(INavigation2DMsgs.recompute_current_navigation_path_RPC, "_navigation")

    def getAllNavigationWaypoints(self, trajectory_type: TrajectoryTypeEnum, waypoints: Map2DPath | None = None) -> Any:
        """Return the waypoints of the global or local path."""
        method = self._navigation.get_all_navigation_waypoints_RPC
        return fetch(method, trajectory_type, into=waypoints, default=Map2DPath())

    def getCurrentNavigationWaypoint(self, curr_waypoint: Map2DLocation | None = None) -> Any:
        """Return the waypoint that the robot drives to."""
        return fetch(self._navigation.get_current_nav_waypoint_RPC, into=curr_waypoint, default=Map2DLocation())

    def getCurrentNavigationMap(self, map_type: NavigationMapTypeEnum, themap: MapGrid2D | None = None) -> Any:
        """Return the map that the planner uses."""
        return fetch(self._navigation.get_current_navigation_map_RPC, map_type, into=themap, default=MapGrid2D())

    # -- INavigation2DVelocityActions ---------------------------------------------------------------------------------

    def applyVelocityCommand(
        self, x_vel: float, y_vel: float, theta_vel: float, timeout: float = DEFAULT_TIMEOUT
    ) -> ReturnValue:
        """Drive at a velocity (m/s, m/s, deg/s) for ``timeout`` seconds."""
        return invoke(self._navigation.apply_velocity_command_RPC, x_vel, y_vel, theta_vel, timeout)

    def getLastVelocityCommand(self) -> tuple[ReturnValue, float, float, float]:
        """Return the outcome and the last commanded velocity: m/s, m/s, deg/s."""
        return fetch_three(self._navigation.get_last_velocity_command_RPC)

    # -- INavigation2DExtraActions ------------------------------------------------------------------------------------

    def gotoTargetByLocationName(self, location_or_area_name: str) -> ReturnValue:
        """Drive to a location, into an area, or along a path of the map server; an unknown name stops the robot."""
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
        return invoke(self._navigation.goto_target_by_absolute_location_and_set_name_RPC, place, name)

    def checkNearToLocation(
        self,
        loc: Map2DLocation | str,
        is_near: list[bool] | None,
        linear_tolerance: float,
        angular_tolerance: float = math.inf,
    ) -> Any:
        """Whether the robot is near a pose or a location of the map server, with tolerances in meters and degrees."""
        place = loc if isinstance(loc, Map2DLocation) else Map2DLocation()
        outcome = OK if place is loc else self.getLocation(str(loc), place)
        position = Map2DLocation()
        outcome = outcome and self.getCurrentPosition(position)
        near = bool(outcome) and position.is_near_to(place, linear_tolerance, angular_tolerance)
        return deliver(outcome, near, is_near)

    def checkInsideArea(self, area: Map2DArea | str, is_inside: list[bool] | None = None) -> Any:
        """Whether the robot is in an area, given as an object or by its name on the map server."""
        shape = area if isinstance(area, Map2DArea) else Map2DArea()
        outcome = OK if shape is area else self.getArea(str(area), shape)
        position = Map2DLocation()
        outcome = outcome and self.getCurrentPosition(position)
        return deliver(outcome, bool(outcome) and shape.checkLocationInsideArea(position), is_inside)

    def findCurrentArea(self, area_name: list[str] | None = None, area: Map2DArea | None = None) -> Any:
        """Find the map server's first area that contains the robot, and its name; both are empty if no area does."""
        names: list[str] = []
        position, current, name = Map2DLocation(), Map2DArea(), ""
        outcome = self.getCurrentPosition(position)
        outcome = outcome and self.getAreasList(names)
        for candidate in names:
            shape = Map2DArea()
            outcome = self.getArea(candidate, shape)
            if not outcome:
                break
            if shape.checkLocationInsideArea(position):
                name, current = candidate, shape
                break
        if area is not None:
            deliver(outcome, current, area)
        return deliver(outcome, name, area_name)

    def getNameOfCurrentTarget(self, location_name: list[str] | None = None) -> Any:
        """Return the name of the current target; empty if it has none."""
        return fetch(self._navigation.get_name_of_current_target_RPC, into=location_name, default="")

    def storeCurrentPosition(self, location_name: str) -> ReturnValue:
        """Store the robot's position as a location of the map server."""
        position = Map2DLocation()
        outcome: ReturnValue = self.getCurrentPosition(position)
        return outcome and self.storeLocation(location_name, position)


class Navigation2DClient(Openable, INavigation2D):
    """A client of three servers, open inside a ``with`` block; it reconnects to a server that has restarted.

    With a name, ``<name>/user_commands/rpc`` accepts text commands: ``gotoLocation NAME``, ``listLocations``, ``help``.
    """

    def __init__(
        self,
        navigation: str = "/navigation2D_nws_yarp",  # prefix of the planner's ports
        maps: str = "/map2D_nws_yarp",  # prefix of the map server's ports; empty: methods that need it fail
        # prefix of the localization server's ports; empty: methods that need it fail
        localization: str = "/localization2D_nws_yarp",
        name: str = "",  # prefix of the client's ports; if it is empty, the name server chooses them
        **options: Unpack[ClientOptions],
    ) -> None:
        self._open = ExitStack()
        self._clients: list[ServiceClient[Any]] = []

        def remote(interface: type[Service], server: str, part: str) -> Any:
            if not server:
                return _MissingServer()
            rpc_port = name and f"{name}/{part}/rpc"
            client = ServiceClient(interface, f"{server}/rpc", rpc_port, **options)
            self._clients.append(client)
            return client.remote

        super().__init__(
            remote(INavigation2DMsgs, navigation, "navigation"),
            remote(IMap2DMsgs, maps, "locations"),
            remote(ILocalization2DMsgs, localization, "localization"),
        )
        naming = options.get("naming")
        self._user_commands = Server(f"{name}/user_commands/rpc", self._respond, naming=naming) if name else None

    @override
    def open(self) -> Self:
        with ExitStack() as opened:
            for client in self._clients:
                opened.enter_context(client)
            if self._user_commands is not None:
                opened.enter_context(self._user_commands)
            self._open = opened.pop_all()
        return self

    @override
    def close(self) -> None:
        self._open.close()

    # -- the Python interface: errors are exceptions ------------------------------------------------------------------

    def go(self, place: str | Map2DLocation) -> None:
        """Drive to a location, area or path by its name, or to a pose; raises `CallFailed` if unknown or refused."""
        go = self.gotoTargetByLocationName if isinstance(place, str) else self.gotoTargetByAbsoluteLocation
        succeeded(go(place))  # type: ignore[arg-type] # each takes its own type

    @property
    def status(self) -> NavigationStatusEnum:
        """The planner's state; raises `CallFailed` if it is unknown, `OSError` if the planner does not reply."""
        outcome, status = self._navigation.get_navigation_status_RPC()
        succeeded(outcome)
        return status

    def wait(self, timeout: float | None = None) -> NavigationStatusEnum:
        """Wait until the robot no longer drives, and return its status; raises `TimeoutError`, or like `status`."""
        end = None if timeout is None else time.monotonic() + timeout
        while not (status := self.status).ended:
            if end is not None and time.monotonic() > end:
                raise TimeoutError(f"the robot still drives after {timeout} s: {status.name}")
            time.sleep(_PERIOD)
        return status

    def _respond(self, words: list[Any]) -> list[Any]:
        """Reply to a text command like YARP's client, but ``gotoLocation`` also reports a failure."""
        verb, *arguments = [str(word) for word in words] or [""]
        if verb == "gotoLocation":
            return [Vocab("ok" if arguments and self.gotoTargetByLocationName(arguments[0]) else "fail")]
        if verb == "listLocations":
            names: list[str] = []
            self.getLocationsList(names)
            return [Vocab("many"), *names]
        if verb == "help":
            return [Vocab("many"), "gotoLocation <locationName>", "listLocations"]
        return [Vocab("err")]


class _MissingServer:
    """The stand-in for a server that is not configured; every call fails."""

    def __getattr__(self, name: str) -> Any:
        def call(*_: Any) -> Any:
            raise ConnectionRefusedError(f"{name}: this client has no such server")

        return call
