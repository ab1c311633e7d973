"""YARP's side of RobotGoto: INavigation2D, and the commands of its own port."""

# ruff: noqa: N802, D102 - YARP's names, and its interfaces say what each does

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from navigation.planner_module import PlannerDevice, PlannerModule
from navigation.robot_goto.driver import Driver
from navigation.status import Fault, PlanError
from navigation.yarp import Calls
from yarp_compat.dev.inavigation2d import NavigationMapTypeEnum, TrajectoryTypeEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.navigation2d_server import Navigation2DServer
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.robotgoto_commands import RobotGotoMsgs


class GotoDevice(PlannerDevice):
    """Answers INavigation2D: the way of a local navigator is a straight line to its goal."""

    def recomputeCurrentNavigationPath(self) -> None:
        def recompute() -> None:
            if self._module.target is None:
                raise PlanError(Fault.OTHER, "there is no goal")

        self._do(recompute)

    def getCurrentNavigationWaypoint(self) -> Map2DLocation | None:
        return self.getAbsoluteLocationOfCurrentTarget()

    def getAllNavigationWaypoints(self, kind: TrajectoryTypeEnum) -> Map2DPath | None:
        target = self.getAbsoluteLocationOfCurrentTarget()
        return Map2DPath([target]) if kind is TrajectoryTypeEnum.local_trajectory and target is not None else None

    def getCurrentNavigationMap(self, kind: NavigationMapTypeEnum) -> MapGrid2D | None:
        return self._do(self._module.local_map) if kind is NavigationMapTypeEnum.local_map else None


class GotoServer(Navigation2DServer, RobotGotoMsgs):
    """Answers INavigation2D and RobotGoto's own commands at one port; ``approach`` takes radians, m/s and seconds."""

    def __init__(
        self, module: PlannerModule, calls: Calls, driver: Driver, approach: Callable[[float, float, float], None]
    ) -> None:
        super().__init__(GotoDevice(module, calls))
        self._do, self._move, self._driver, self._approach = calls.do, calls.move, driver, approach

    def ResetParams(self) -> ReturnValue:
        self._do(self._driver.reset)
        return OK

    def Approach(self, dir: float, speed: float, time: float) -> ReturnValue:  # noqa: A002 - its name
        if not all(map(math.isfinite, (dir, speed, time))) or time < 0.0:
            raise CallFailed(ReturnCode.METHOD_FAILED, f"approach {dir:g} {speed:g} {time:g}: these are no numbers")
        self._move(lambda: self._approach(math.radians(dir), speed, time))
        return OK

    def SetLinearTolerance(self, tol: float) -> ReturnValue:
        return self._number("goal_tolerance_lin", tol, 0.001, 10.0)

    def SetAngularTolerance(self, tol: float) -> ReturnValue:
        return self._number("goal_tolerance_ang", tol, 0.05, 180.0)

    def SetMaxLinearSpeed(self, maxLin: float) -> ReturnValue:  # noqa: N803
        return self._number("max_lin_speed", maxLin, 0.001, 3.0)

    def SetMaxAngularSpeed(self, maxAng: float) -> ReturnValue:  # noqa: N803
        return self._number("max_ang_speed", maxAng, 0.1, 360.0)

    def SetMinLinearSpeed(self, minLin: float) -> ReturnValue:  # noqa: N803
        return self._number("min_lin_speed", minLin, 0.0, 3.0)

    def SetMinAngularSpeed(self, minAng: float) -> ReturnValue:  # noqa: N803
        return self._number("min_ang_speed", minAng, 0.0, 360.0)

    def SetLinearSpeedGain(self, LinGain: float) -> ReturnValue:  # noqa: N803
        return self._number("lin_speed_gain", LinGain, 0.001, 100.0)

    def SetAngularSpeedGain(self, AngGain: float) -> ReturnValue:  # noqa: N803
        return self._number("ang_speed_gain", AngGain, 0.001, 100.0)

    def SetObstacoleAvoidance(self, enable: bool) -> ReturnValue:
        return self._take("enable_obstacles_avoidance", enable)

    def SetObstacoleStop(self, enable: bool) -> ReturnValue:
        return self._take("enable_obstacles_emergency_stop", enable)

    def GetNavigationStatus(self) -> tuple[ReturnValue, str]:
        return OK, f"navigation_status_{self._driver.status.state.value}"

    def _number(self, name: str, value: float, least: float, most: float) -> ReturnValue:
        if not least <= value <= most:
            raise CallFailed(ReturnCode.METHOD_FAILED, f"{name} is within {least:g} and {most:g}, not {value:g}")
        return self._take(name, value)

    def _take(self, name: str, value: Any) -> ReturnValue:
        def take() -> None:
            self._driver.settings = self._driver.settings.model_copy(update={name: value})

        self._do(take)
        return OK
