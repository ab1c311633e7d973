"""The gateway as YARP's clients know a planner: ``INavigation2D``."""

# ruff: noqa: N802, D102 - YARP's names, and what they do is said in `yarp_compat.dev.inavigation2d`

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

from bridge.modules.host import Host
from navigation.calls import Calls
from navigation.gateway.drive import Target
from navigation.gateway.gateway import Gateway, RefusedError
from navigation.gateway.places import Places
from navigation.gateway.velocity import Commander, Velocity
from navigation.pose import Pose
from yarp_compat.dev.inavigation2d import NavigationMapTypeEnum, TrajectoryTypeEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D

WHO = "a YARP client"
_LETTING_GO_SECONDS = 1.0
_FRESH_SECONDS = 0.3
"""A velocity that waited longer for the module's thread is not obeyed: its client has another one by then, or stops."""


class Device:
    """What `yarp_compat.dev.navigation2d_server.Navigation2DServer` answers with. Called on threads of connections.

    Args:
        host: the module's; all is done on its thread.
        gateway: drives.
        places: knows maps.
        commander: takes velocities.
    """

    def __init__(self, host: Host, gateway: Gateway, places: Places, commander: Commander) -> None:
        self._gateway, self._places, self._commander = gateway, places, commander
        calls = Calls(host.loop, RefusedError, LookupError)
        self._do, self._move = calls.do, calls.move

    # -- targets -------------------------------------------------------------------------------------------------------

    def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> None:
        self._move(lambda: self._begin([self._places.known(loc)]))

    def gotoTargetByRelativeLocation(self, x: float, y: float, theta: float) -> None:
        def relative() -> None:
            place = self._robot() @ Pose(x, y, 0.0 if math.isnan(theta) else math.radians(theta))
            if math.isnan(theta):
                place = place._replace(theta=math.nan)
            self._begin([Target(place, self._gateway.frame)])

        self._move(relative)

    def followPath(self, path: Map2DPath) -> None:
        self._move(lambda: self._begin([self._places.known(place) for place in path.waypoints]))

    def getAbsoluteLocationOfCurrentTarget(self) -> Map2DLocation | None:
        return self._do(self._where_to)

    def getRelativeLocationOfCurrentTarget(self) -> tuple[float, float, float] | None:
        def relative() -> tuple[float, float, float] | None:
            place = self._where_to()
            if place is None:
                return None
            found = self._robot().inverse @ Pose(place.x, place.y, math.radians(place.theta))
            return found.x, found.y, math.degrees(found.theta)

        return self._do(relative)

    # -- control -------------------------------------------------------------------------------------------------------

    def getNavigationStatus(self) -> str:
        return self._do(lambda: self._gateway.state()[0].value)

    def stopNavigation(self) -> None:
        """The answer waits until the planner has let go, so that the status is idle once the client has it."""
        self._do(self._stop)
        until = time.monotonic() + _LETTING_GO_SECONDS
        while self._do(lambda: self._gateway.driving) and time.monotonic() < until:
            time.sleep(0.01)

    def suspendNavigation(self, time_s: float) -> None:
        self._do(lambda: self._gateway.pause(time_s))

    def resumeNavigation(self) -> None:
        self._move(self._gateway.resume)

    def recomputeCurrentNavigationPath(self) -> None:
        self._do(self._gateway.recompute)

    def getAllNavigationWaypoints(self, kind: TrajectoryTypeEnum) -> Map2DPath | None:  # noqa: ARG002
        """YARP's robotPathPlanner answers either kind with its way."""
        return self._do(lambda: Map2DPath(self._way()) if self._gateway.driving else None)

    def getCurrentNavigationWaypoint(self) -> Map2DLocation | None:
        return self._do(self._waypoint)

    def getCurrentNavigationMap(self, kind: NavigationMapTypeEnum) -> MapGrid2D | None:
        if kind is NavigationMapTypeEnum.global_map:
            return self._do(self._places.map)
        return self._do(lambda: self._places.grid(self._gateway.link.local_map))

    # -- velocities ----------------------------------------------------------------------------------------------------

    def applyVelocityCommand(self, x_vel: float, y_vel: float, theta_vel: float, timeout: float) -> None:
        def command() -> None:
            if self._gateway.has_base:
                raise RefusedError("the planner drives; stop or suspend it first")
            self._commander.command(Velocity(x_vel, y_vel, theta_vel), timeout)

        self._move(command, _FRESH_SECONDS)

    def getLastVelocityCommand(self) -> tuple[float, float, float] | None:
        return self._do(lambda: self._commander.last)

    # -- parts ---------------------------------------------------------------------------------------------------------

    def _begin(self, targets: Sequence[Target]) -> None:
        self._gateway.go(targets, WHO)

    def _stop(self) -> None:
        self._commander.stop()
        self._gateway.stop()

    def _robot(self) -> Pose:
        robot = self._gateway.robot()
        if robot is None:
            raise LookupError("it is not known where the robot is")
        return robot

    def _where_to(self) -> Map2DLocation | None:
        drive, link = self._gateway.drive, self._gateway.link
        if drive is not None:
            return self._places.location(drive.targets[-1])
        told = link.pose(link.others[-1]) if link.others else None
        return None if told is None else self._places.location(told)

    def _way(self) -> list[Map2DLocation]:
        """The planner's path, or the goals that are left where it tells none."""
        path = self._gateway.link.path
        poses: Sequence[Any] = path["poses"] if path is not None else []
        drive = self._gateway.drive
        left = [] if drive is None else list(drive.targets[drive.at :])
        return [self._places.location(one) for one in (poses or left)]

    def _waypoint(self) -> Map2DLocation | None:
        """The place of its way that the robot comes to next."""
        way, robot = (self._way() if self._gateway.driving else []), self._gateway.robot()
        if not way or robot is None:
            return way[0] if way else None
        nearest = min(range(len(way)), key=lambda i: math.hypot(way[i].x - robot.x, way[i].y - robot.y))
        return way[min(nearest + 1, len(way) - 1)]
