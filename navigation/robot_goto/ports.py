"""The topics and YARP ports of RobotGoto: its publishers, INavigation2D, and its own commands."""

# ruff: noqa: N802, D102 - YARP's names, documented in its interfaces

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.client.velocity import STOP_SECONDS
from bridge.hub.wire.qos import LATCHED
from bridge.modules.host import Host
from bridge.modules.velocity import velocity_publisher
from navigation.messages import GRID, Message, pose_message
from navigation.planner_module import PlannerDevice, PlannerModule, PlannerTopics
from navigation.pose import Pose
from navigation.robot_goto.driver import Driver
from navigation.robot_goto.local_grid import RESOLUTION, SIDE
from navigation.robot_goto.steering import INFLUENCE, STILL, DriveCommand
from navigation.status import NO_GOAL, Fault, PlanError
from navigation.yarp import Calls
from yarp_compat.dev.inavigation2d import Navigation2DServer, NavigationMapTypeEnum, TrajectoryTypeEnum
from yarp_compat.dev.locations import Map2DLocation, Map2DPath
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.returnvalue import OK, CallFailed, ReturnCode, ReturnValue
from yarp_compat.dev.robotgoto_commands import RobotGotoMsgs
from yarp_compat.os.data.stamp import Stamp

_REPEAT = 1.0  # seconds after which YARP's port repeats the status
_MAP_PERIOD = 0.5  # seconds
_FULL_GAIN = 100.0
_POLAR = 2


class GotoTopics(PlannerTopics):
    """Publishes commands, the status and the local map; no YARP ports without a prefix. On the module's thread.

    ``period`` is the time between two commands, in seconds.
    """

    def __init__(self, host: Host, frame: str, cmd_vel: str, prefix: str, period: float) -> None:
        super().__init__(host, "robot_goto", frame)
        self._velocity = velocity_publisher(host, cmd_vel)
        self._drivers = partial(host.node.hub.graph.drivers, cmd_vel)  # persons who drive manually
        self._map = host.node.publisher(f"{self._prefix}/local_map", GRID, LATCHED, priority="state")
        names = ("control:o", "status:o", "speak:o", "gui:o") if prefix else ()
        self._ports = {name: host.yarp.output(f"{prefix}/{name}") for name in names}
        self._stamp = Stamp()
        self._written = self._mapped = -math.inf
        self._most_zeros = max(1, round(STOP_SECONDS / period))  # a number, because this process may be starved
        self._zeros = 0  # how many of the next silent commands are published

    def command(self, command: DriveCommand, *, silent: bool) -> None:
        """Command the base; of successive ``silent`` commands, only those of the first `STOP_SECONDS` are published.

        If a person drives manually meanwhile, only the first is published.
        """
        if silent and 0 < self._zeros < self._most_zeros and self._drivers():
            self._zeros = 0  # they would slow the person
        if silent and not self._zeros:
            return
        self._zeros = self._zeros - 1 if silent else self._most_zeros
        self._velocity.publish(command.vx, command.vy, command.omega)
        if self._ports:
            control, stop = ([_POLAR, *polar, _FULL_GAIN] for polar in (command.polar, STILL.polar))
            self._ports["control:o"].write_command(control, stop, self._envelope())

    @property
    def resting(self) -> bool:
        """Whether no zero is left to be repeated."""
        return not self._zeros

    def stop_base(self) -> None:
        """Command the base to stop; the next silent commands repeat that."""
        self.command(STILL, silent=False)

    def status(self, now: float, driver: Driver, goal_id: bytes = NO_GOAL) -> None:
        """Publish the status if it has changed; YARP's port repeats it."""
        status, target = driver.status, driver.target
        if (status, goal_id) != self._last:
            self._publish_status(status, target.pose if target else None, goal_id)
            self._written = -math.inf
        if self._ports and not 0.0 <= now - self._written < _REPEAT:
            self._written = now
            self._write("status:o", [f"navigation_status_{status.state.value}"])
        while driver.spoken:
            phrase = driver.spoken.popleft()
            if self._ports:
                self._ports["speak:o"].write([phrase])

    def publish_surroundings(self, now: float, driver: Driver, pose: Pose | None, moved: Pose | None) -> None:
        """Publish the local grid, and with a goal the path ahead, twice a second, and ``gui:o`` at each call."""
        if self._ports and self._ports["gui:o"].has_readers:
            self._write("gui:o", gui(driver))
        if pose is None or moved is None or 0.0 <= now - self._mapped < _MAP_PERIOD:
            return
        self._mapped = now
        self._map.publish(local_map(driver, pose, moved, self._header(), now))
        if driver.target is not None:
            fixed = pose @ moved.inverse
            self._publish_path([pose, *(fixed @ Pose(x, y, 0.0) for x, y in driver.detour), driver.target.pose])

    def _write(self, name: str, values: list[Any]) -> None:
        self._ports[name].write(values, self._envelope())

    def _envelope(self) -> str:
        """Return a time stamp, as YARP's robotGoto writes it on these ports."""
        self._stamp.update(self._host.clock.now_ns() / 1e9)
        return self._stamp.to_text()


def local_map(driver: Driver, pose: Pose, moved: Pose, header: Message, now: float) -> Message:
    """Return the local grid as ``nav_msgs/msg/OccupancyGrid`` on the map, rotated like the odometry frame."""
    x, y = driver.grid.origin
    origin = pose @ moved.inverse @ Pose(x, y, 0.0)
    info = {"resolution": RESOLUTION, "width": SIDE, "height": SIDE, "origin": pose_message(origin)}
    cells = np.ascontiguousarray(driver.grid.occupancy(now)).reshape(-1)
    return {"header": header, "info": info, "data": cells}


def gui(driver: Driver) -> list[float]:
    """Return the nine numbers of ``gui:o``: command, forces and goal, degrees (`robotGotoDev`, ``sendGui``)."""
    aside, angle = float(driver.ahead[3]), math.degrees(float(driver.ahead[4]))
    weight = max(0.0, 1.0 - aside / INFLUENCE) / 2.0
    return [*driver.command.polar, angle, angle + 90.0, weight, 0.0, INFLUENCE, math.degrees(driver.bearing)]


class GotoDevice(PlannerDevice):
    """Serves INavigation2D; the only waypoint is the goal."""

    def recomputeCurrentNavigationPath(self) -> None:
        def recompute() -> None:
            if self._module.target is None:
                raise PlanError(Fault.OTHER, "no active goal")

        self._do(recompute)

    def getCurrentNavigationWaypoint(self) -> Map2DLocation | None:
        return self.getAbsoluteLocationOfCurrentTarget()

    def getAllNavigationWaypoints(self, kind: TrajectoryTypeEnum) -> Map2DPath | None:
        target = self.getAbsoluteLocationOfCurrentTarget()
        return Map2DPath([target]) if kind is TrajectoryTypeEnum.local_trajectory and target is not None else None

    def getCurrentNavigationMap(self, kind: NavigationMapTypeEnum) -> MapGrid2D | None:
        return self._do(self._module.local_map) if kind is NavigationMapTypeEnum.local_map else None


class GotoServer(Navigation2DServer, RobotGotoMsgs):
    """Serves INavigation2D and RobotGoto's own commands on one port; ``approach`` takes radians, m/s and seconds."""

    def __init__(
        self, module: PlannerModule, calls: Calls, driver: Driver, approach: Callable[[float, float, float], None]
    ) -> None:
        super().__init__(GotoDevice(module, calls))
        self._do, self._move, self._driver, self._approach = calls.do, calls.move, driver, approach

    @override
    def ResetParams(self) -> ReturnValue:
        self._do(self._driver.reset)
        return OK

    @override
    def Approach(self, dir: float, speed: float, time: float) -> ReturnValue:
        if not all(map(math.isfinite, (dir, speed, time))) or time < 0.0:
            raise CallFailed(
                ReturnCode.METHOD_FAILED,
                f"approach {dir:g} {speed:g} {time:g}: the values must be finite, the time at least 0",
            )
        self._move(lambda: self._approach(math.radians(dir), speed, time))
        return OK

    @override
    def SetLinearTolerance(self, tol: float) -> ReturnValue:
        return self._number("goal_tolerance_lin", tol, 0.001, 10.0)

    @override
    def SetAngularTolerance(self, tol: float) -> ReturnValue:
        return self._number("goal_tolerance_ang", tol, 0.05, 180.0)

    @override
    def SetMaxLinearSpeed(self, maxLin: float) -> ReturnValue:
        return self._number("max_lin_speed", maxLin, 0.001, 3.0)

    @override
    def SetMaxAngularSpeed(self, maxAng: float) -> ReturnValue:
        return self._number("max_ang_speed", maxAng, 0.1, 360.0)

    @override
    def SetMinLinearSpeed(self, minLin: float) -> ReturnValue:
        return self._number("min_lin_speed", minLin, 0.0, 3.0)

    @override
    def SetMinAngularSpeed(self, minAng: float) -> ReturnValue:
        return self._number("min_ang_speed", minAng, 0.0, 360.0)

    @override
    def SetLinearSpeedGain(self, LinGain: float) -> ReturnValue:
        return self._number("lin_speed_gain", LinGain, 0.001, 100.0)

    @override
    def SetAngularSpeedGain(self, AngGain: float) -> ReturnValue:
        return self._number("ang_speed_gain", AngGain, 0.001, 100.0)

    @override
    def SetObstacoleAvoidance(self, enable: bool) -> ReturnValue:
        return self._change_setting("enable_obstacles_avoidance", enable)

    @override
    def SetObstacoleStop(self, enable: bool) -> ReturnValue:
        return self._change_setting("enable_obstacles_emergency_stop", enable)

    @override
    def GetNavigationStatus(self) -> tuple[ReturnValue, str]:
        return OK, f"navigation_status_{self._driver.status.state.value}"

    def _number(self, name: str, value: float, least: float, most: float) -> ReturnValue:
        if not least <= value <= most:
            raise CallFailed(ReturnCode.METHOD_FAILED, f"{name} must be within {least:g} and {most:g}, not {value:g}")
        return self._change_setting(name, value)

    def _change_setting(self, name: str, value: Any) -> ReturnValue:
        def change() -> None:
            self._driver.settings = self._driver.settings.model_copy(update={name: value})

        self._do(change)
        return OK
