"""What YARP's clients of RobotGoto call: INavigation2D, and the commands of its own port."""

# ruff: noqa: N802, D102 - YARP's names, and its interfaces say what each does

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Protocol

from navigation.calls import Calls
from navigation.pose import Pose
from navigation.robot_goto.driver import Driver
from yarp_compat.dev.inavigation2d import NavigationMapTypeEnum, TrajectoryTypeEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.navigation2d_server import Navigation2DServer
from yarp_compat.dev.returnvalue import CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.robotgoto_commands import RobotGotoMsgs

_OK, _FAILED = ReturnValue(ReturnCode.OK), ReturnValue(ReturnCode.METHOD_FAILED)


class Asked(Protocol):
    """The module, as it is asked; all on its thread."""

    @property
    def driver(self) -> Driver:
        """What drives."""

    def pose(self) -> Pose:
        """The robot's on the map; raises `RuntimeError` with why it is not known."""

    def map_name(self) -> str:
        """The map that it is on; empty where nobody says."""

    def drive(self, pose: Pose) -> None:
        """Drive there."""

    def approach(self, direction: float, speed: float, seconds: float) -> None:
        """Move by the laser alone: radians, m/s."""

    def stop_driving(self, reason: str) -> None:
        """Give the goal up."""

    def local_map(self) -> MapGrid2D | None:
        """The local grid."""

    def reset(self) -> None:
        """Take the parameters of the start again."""


class Device:
    """What `Navigation2DServer` answers with. Methods run on the threads of connections, what they do on the module's.

    Args:
        asked: the module.
        calls: does things on its thread.
    """

    def __init__(self, asked: Asked, calls: Calls) -> None:
        self._asked, self._call, self._move = asked, calls.do, calls.move

    def gotoTargetByAbsoluteLocation(self, loc: Map2DLocation) -> None:
        def drive() -> None:
            here = self._asked.map_name()
            if here and loc.map_id and loc.map_id != here:
                raise CallFailed(ReturnCode.METHOD_FAILED, f"the robot is on the map {here}, not on {loc.map_id}")
            self._asked.drive(Pose(loc.x, loc.y, math.radians(loc.theta)))

        self._move(drive)

    def gotoTargetByRelativeLocation(self, x: float, y: float, theta: float) -> None:
        def drive() -> None:
            goal = self._pose() @ Pose(x, y, 0.0 if math.isnan(theta) else math.radians(theta))
            self._asked.drive(goal._replace(theta=math.nan) if math.isnan(theta) else goal)

        self._move(drive)

    def stopNavigation(self) -> None:
        self._call(lambda: self._asked.stop_driving("stopped"))

    def suspendNavigation(self, seconds: float) -> ReturnValue:
        return _OK if self._call(lambda: self._asked.driver.pause(seconds)) else _FAILED

    def resumeNavigation(self) -> ReturnValue:
        return _OK if self._move(self._asked.driver.resume) else _FAILED

    def recomputeCurrentNavigationPath(self) -> ReturnValue:
        return _OK if self._call(lambda: self._asked.driver.target is not None) else _FAILED

    def getNavigationStatus(self) -> str:
        return self._asked.driver.status.state.value

    def getAbsoluteLocationOfCurrentTarget(self) -> Map2DLocation | None:
        def found() -> Map2DLocation | None:
            target = self._asked.driver.target
            return None if target is None else _location(self._asked.map_name(), target.pose)

        return self._call(found)

    def getRelativeLocationOfCurrentTarget(self) -> tuple[float, float, float] | None:
        def found() -> tuple[float, float, float] | None:
            target = self._asked.driver.target
            if target is None:
                return None
            seen = self._pose().inverse @ target.pose
            return seen.x, seen.y, math.degrees(seen.theta)

        return self._call(found)

    def getCurrentNavigationWaypoint(self) -> Map2DLocation | None:
        return self.getAbsoluteLocationOfCurrentTarget()

    def getAllNavigationWaypoints(self, kind: TrajectoryTypeEnum) -> Map2DPath | None:
        target = self.getAbsoluteLocationOfCurrentTarget()
        if kind is not TrajectoryTypeEnum.local_trajectory or target is None:
            return None
        return Map2DPath([target])

    def getCurrentNavigationMap(self, kind: NavigationMapTypeEnum) -> MapGrid2D | None:
        if kind is not NavigationMapTypeEnum.local_map:
            return None
        return self._call(self._asked.local_map)

    def _pose(self) -> Pose:
        try:
            return self._asked.pose()
        except RuntimeError as err:
            raise CallFailed(ReturnCode.METHOD_FAILED, str(err)) from None


class GotoServer(Navigation2DServer, RobotGotoMsgs):
    """Answers INavigation2D and RobotGoto's own commands at one port, in every release's way.

    Args:
        asked: the module.
        calls: does things on its thread.
    """

    def __init__(self, asked: Asked, calls: Calls) -> None:
        super().__init__(Device(asked, calls))
        self._asked, self._call, self._move = asked, calls.do, calls.move

    def ResetParams(self) -> ReturnValue:
        self._call(self._asked.reset)
        return _OK

    def Approach(self, dir: float, speed: float, time: float) -> ReturnValue:  # noqa: A002 - its name
        if not all(map(math.isfinite, (dir, speed, time))) or time < 0.0:
            raise CallFailed(ReturnCode.METHOD_FAILED, f"approach {dir:g} {speed:g} {time:g}: these are no numbers")
        self._move(lambda: self._asked.approach(math.radians(dir), speed, time))
        return _OK

    def SetLinearTolerance(self, tol: float) -> ReturnValue:
        return self._number("goal_tolerance_lin", tol, 0.001, 10.0)

    def SetAngularTolerance(self, tol: float) -> ReturnValue:
        return self._number("goal_tolerance_ang", tol, 0.05, 180.0, degrees=True)

    def SetMaxLinearSpeed(self, maxLin: float) -> ReturnValue:  # noqa: N803
        return self._number("max_lin_speed", maxLin, 0.001, 3.0)

    def SetMaxAngularSpeed(self, maxAng: float) -> ReturnValue:  # noqa: N803
        return self._number("max_ang_speed", maxAng, 0.1, 360.0, degrees=True)

    def SetMinLinearSpeed(self, minLin: float) -> ReturnValue:  # noqa: N803
        return self._number("min_lin_speed", minLin, 0.0, 3.0)

    def SetMinAngularSpeed(self, minAng: float) -> ReturnValue:  # noqa: N803
        return self._number("min_ang_speed", minAng, 0.0, 360.0, degrees=True)

    def SetLinearSpeedGain(self, LinGain: float) -> ReturnValue:  # noqa: N803
        return self._number("lin_speed_gain", LinGain, 0.001, 100.0)

    def SetAngularSpeedGain(self, AngGain: float) -> ReturnValue:  # noqa: N803
        return self._number("ang_speed_gain", AngGain, 0.001, 100.0)

    def SetObstacoleAvoidance(self, enable: bool) -> ReturnValue:
        return self._take("avoidance", enable)

    def SetObstacoleStop(self, enable: bool) -> ReturnValue:
        return self._take("obstacle_stop", enable)

    def GetNavigationStatus(self) -> tuple[ReturnValue, str]:
        return _OK, f"navigation_status_{self._asked.driver.status.state.value}"

    def _number(self, name: str, value: float, least: float, most: float, *, degrees: bool = False) -> ReturnValue:
        if not least <= value <= most:
            raise CallFailed(ReturnCode.METHOD_FAILED, f"{name} is within {least:g} and {most:g}, not {value:g}")
        return self._take(name, math.radians(value) if degrees else value)

    def _take(self, name: str, value: Any) -> ReturnValue:
        def take() -> None:
            driver = self._asked.driver
            driver.settings = replace(driver.settings, **{name: value})

        self._call(take)
        return _OK


def _location(map_name: str, pose: Pose) -> Map2DLocation:
    return Map2DLocation(map_name, pose.x, pose.y, math.degrees(pose.theta))
