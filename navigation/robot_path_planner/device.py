"""YARP's side of RobotPathPlanner: INavigation2D, and a few commands of its own."""

# ruff: noqa: N802, D102 - YARP's names, and its interface says what each does

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from navigation.planner_module import PlannerDevice, PlannerModule, place_of
from navigation.robot_path_planner.planner import PathPlanner
from navigation.status import Fault, PlanError
from navigation.yarp import Calls, location_of
from yarp_compat.dev.inavigation2d import NavigationMapTypeEnum, TrajectoryTypeEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.navigation2d_server import Navigation2DServer

HELP = (
    "help: these lines",
    "get_robot_radius: metres kept to walls",
    "set_robot_radius R: keep R metres to walls; the way is planned anew",
)
_MOST = 3.0


class PathPlannerDevice(PlannerDevice):
    """Answers INavigation2D; ``brake`` makes the robot stand at once, on any thread, before a stop or a pause."""

    def __init__(self, module: PlannerModule, calls: Calls, planner: PathPlanner, brake: Callable[[], None]) -> None:
        super().__init__(module, calls)
        self._planner, self._brake = planner, brake

    def followPath(self, path: Map2DPath) -> None:
        self._move(lambda: self._module.drive(*map(place_of, path)))

    def stopNavigation(self) -> None:
        self._brake()
        super().stopNavigation()

    def suspendNavigation(self, seconds: float) -> None:
        self._brake()
        super().suspendNavigation(seconds)

    def recomputeCurrentNavigationPath(self) -> None:
        def recompute() -> None:
            if not self._planner.active:
                raise PlanError(Fault.OTHER, "there is no goal")
            self._planner.recompute()

        self._do(recompute)

    def getCurrentNavigationWaypoint(self) -> Map2DLocation | None:
        def found() -> Map2DLocation | None:
            ground, point = self._planner.ground, self._planner.waypoint
            return None if point is None or ground is None else location_of(ground.name, point.pose)

        return self._do(found)

    def getAllNavigationWaypoints(self, kind: TrajectoryTypeEnum) -> Map2DPath | None:  # noqa: ARG002
        """YARP's answers either kind with its way."""

        def found() -> Map2DPath | None:
            ground, points = self._planner.ground, self._planner.waypoints
            return None if ground is None else Map2DPath([location_of(ground.name, each.pose) for each in points])

        return self._do(found)

    def getCurrentNavigationMap(self, kind: NavigationMapTypeEnum) -> MapGrid2D | None:
        if kind is NavigationMapTypeEnum.local_map:
            return self._do(self._module.local_map)
        ground = self._planner.ground
        return None if ground is None else ground.grid


class PlannerServer(Navigation2DServer):
    """Answers INavigation2D, and words that get and set the robot's radius, metres."""

    def __init__(self, device: object, get_radius: Callable[[], float], set_radius: Callable[[float], Any]) -> None:
        super().__init__(device)
        self._get, self._set = get_radius, set_radius

    def command(self, words: list[Any]) -> list[Any] | None:
        """The answer to a Bottle, None where it is no command of these; raises `ValueError` if its value cannot be."""
        word, *rest = words or [""]
        if word in ("help", "[help]") and not rest:
            return ["[many]", *HELP]
        if word == "get_robot_radius":
            return [self._get()]
        if word != "set_robot_radius":
            return None
        value = rest[0] if len(rest) == 1 else None
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value <= _MOST:
            told = " ".join(map(str, rest)) or "nothing"
            raise ValueError(f"a robot's radius is one number above 0 and at most {_MOST:g} m, not {told}")
        self._set(float(value))
        return ["[ok]"]
