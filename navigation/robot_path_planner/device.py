"""What YARP's clients of the planner call; see `yarp_compat.dev.navigation2d_server`."""

# ruff: noqa: N802, D102 - YARP's names, and its interface says what each does

from __future__ import annotations

import math
from typing import Protocol

from navigation.calls import Calls
from navigation.goals import Place
from navigation.pose import Pose
from navigation.robot_path_planner.planner import PathPlanner
from navigation.status import State
from yarp_compat.dev.inavigation2d import NavigationMapTypeEnum, TrajectoryTypeEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode


class Asked(Protocol):
    """The module, as it is asked."""

    @property
    def planner(self) -> PathPlanner:
        """What plans."""

    def now(self) -> float:
        """Seconds."""

    def pose(self) -> Pose:
        """The robot's on the map; raises `RuntimeError` with why it is not known."""

    def drive(self, *places: Place) -> None:
        """Drive there, one after the other."""

    def stop_driving(self, reason: str) -> None:
        """Give the goal up."""

    def brake(self) -> None:
        """Have the robot stand still at once, on any thread."""

    def local_map(self) -> MapGrid2D | None:
        """The map with what the laser sees on it."""


class Device:
    """Methods run on the threads of the connections; what they do is done on the module's.

    Args:
        asked: the module.
        calls: does things on its thread.
    """

    def __init__(self, asked: Asked, calls: Calls) -> None:
        self._asked, self._call, self._move = asked, calls.do, calls.move

    def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> None:
        self._move(lambda: self._asked.drive(_place(loc)))

    def followPath(self, path: Map2DPath) -> None:
        self._move(lambda: self._asked.drive(*map(_place, path)))

    def gotoTargetByRelativeLocation(self, x: float, y: float, theta: float) -> None:
        def drive() -> None:
            goal = self._pose() @ Pose(x, y, 0.0 if math.isnan(theta) else math.radians(theta))
            self._asked.drive(Place("", goal._replace(theta=math.nan) if math.isnan(theta) else goal))

        self._move(drive)

    def stopNavigation(self) -> None:
        self._asked.brake()
        self._call(lambda: self._asked.stop_driving("stopped"))

    def suspendNavigation(self, seconds: float) -> None:
        def pause() -> None:
            if not self._asked.planner.active:
                raise CallFailed(ReturnCode.METHOD_FAILED, "there is nothing to suspend")
            self._asked.planner.pause(self._asked.now(), seconds)

        self._asked.brake()
        self._call(pause)

    def resumeNavigation(self) -> None:
        def resume() -> None:
            if self._asked.planner.status.state is not State.PAUSED:
                raise CallFailed(ReturnCode.METHOD_FAILED, "nothing is suspended")
            self._asked.planner.resume()

        self._move(resume)

    def recomputeCurrentNavigationPath(self) -> None:
        def recompute() -> None:
            if not self._asked.planner.active:
                raise CallFailed(ReturnCode.METHOD_FAILED, "there is no goal")
            self._asked.planner.recompute()

        self._call(recompute)

    def getNavigationStatus(self) -> str:
        return self._asked.planner.status.state.value

    def getAbsoluteLocationOfCurrentTarget(self) -> Map2DLocation | None:
        def found() -> Map2DLocation | None:
            target = self._asked.planner.target
            return None if target is None else _location(target.map_name, target.pose)

        return self._call(found)

    def getRelativeLocationOfCurrentTarget(self) -> tuple[float, float, float] | None:
        def found() -> tuple[float, float, float] | None:
            target = self._asked.planner.target
            if target is None:
                return None
            seen = self._pose().inverse @ target.pose
            return seen.x, seen.y, math.degrees(seen.theta) if math.isfinite(seen.theta) else math.nan

        return self._call(found)

    def getCurrentNavigationWaypoint(self) -> Map2DLocation | None:
        def found() -> Map2DLocation | None:
            ground, point = self._asked.planner.ground, self._asked.planner.waypoint
            return None if point is None or ground is None else _location(ground.name, point.pose)

        return self._call(found)

    def getAllNavigationWaypoints(self, kind: TrajectoryTypeEnum) -> Map2DPath | None:  # noqa: ARG002
        """YARP's answers either kind with its way."""

        def found() -> Map2DPath | None:
            ground, points = self._asked.planner.ground, self._asked.planner.waypoints
            return None if ground is None else Map2DPath([_location(ground.name, each.pose) for each in points])

        return self._call(found)

    def getCurrentNavigationMap(self, kind: NavigationMapTypeEnum) -> MapGrid2D | None:
        if kind is NavigationMapTypeEnum.local_map:
            return self._call(self._asked.local_map)
        ground = self._asked.planner.ground
        return None if ground is None else ground.grid

    def _pose(self) -> Pose:
        try:
            return self._asked.pose()
        except RuntimeError as err:
            raise CallFailed(ReturnCode.METHOD_FAILED, str(err)) from None


def _place(loc: Map2DLocation) -> Place:
    return Place(loc.map_id, Pose(loc.x, loc.y, math.radians(loc.theta)))


def _location(map_name: str, pose: Pose) -> Map2DLocation:
    return Map2DLocation(map_name, pose.x, pose.y, math.degrees(pose.theta))
