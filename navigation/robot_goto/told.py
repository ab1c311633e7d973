"""What RobotGoto tells of itself: topics of the hub, and ports of YARP."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bridge.hub.qos import Durability, Qos
from bridge.modules.host import Host
from navigation.messages import pose_message
from navigation.pose import Pose
from navigation.robot_goto.command import STILL, Command, Status
from navigation.robot_goto.driver import Driver
from navigation.robot_goto.local_grid import RESOLUTION, SIDE
from navigation.robot_goto.steering import INFLUENCE
from navigation.status import NO_GOAL, STATUS, status_message
from yarp_compat.os.stamp import Stamp

PREFIX = "/planner/robot_goto"
_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_SAID_AGAIN = 1.0
_MAP_EVERY = 0.5
_FULL_GAIN = 100.0
_POLAR = 2

Message = dict[str, Any]


class Told:
    """Publishes commands, and what has changed. On the module's thread.

    Args:
        host: the module's.
        frame: the map's.
        cmd_vel: topic of the commands.
        prefix: begins the YARP ports; empty for none.
    """

    def __init__(self, host: Host, frame: str, cmd_vel: str, prefix: str) -> None:
        self._host, self._frame = host, frame
        node = host.node
        self._twist = node.publisher(cmd_vel, "geometry_msgs/msg/Twist", Qos(depth=1), priority="command")
        self._status = node.publisher(f"{PREFIX}/status", STATUS, _LATCHED, priority="state")
        self._path = node.publisher(f"{PREFIX}/path", "nav_msgs/msg/Path", _LATCHED, priority="state")
        self._map = node.publisher(f"{PREFIX}/local_map", "nav_msgs/msg/OccupancyGrid", _LATCHED, priority="state")
        names = ("control:o", "status:o", "speak:o", "gui:o") if prefix else ()
        self._ports = {name: host.yarp.output(f"{prefix}/{name}") for name in names}
        self._stamp = Stamp()
        self._last: tuple[Status, bytes] | None = None
        self._said = self._mapped = -math.inf
        self._silent = True

    def command(self, command: Command, *, silent: bool) -> None:
        """Command the base; once more to stand still before falling silent."""
        if silent and self._silent:
            return
        self._silent = silent
        self._twist.publish({"linear": {"x": command.vx, "y": command.vy}, "angular": {"z": command.omega}})
        if self._ports:
            self._write("control:o", [_POLAR, *command.polar, _FULL_GAIN])

    def stand_still(self) -> None:
        """Command the base to stand still, whatever was commanded before."""
        self._silent = False
        self.command(STILL, silent=True)

    def status(self, now: float, driver: Driver, goal_id: bytes = NO_GOAL) -> None:
        """Tell how the goal is getting on, where that has changed; YARP is told again and again."""
        status, target = driver.status, driver.target
        if (status, goal_id) != self._last:
            self._last = status, goal_id
            goal = None if target is None else {"header": self._header(), "pose": pose_message(target.pose)}
            self._status.publish(
                status_message(
                    self._host.clock.stamp(), status.state, status.reason, status.fault, goal_id=goal_id, goal=goal
                )
            )
            self._said = -math.inf
        if self._ports and not 0.0 <= now - self._said < _SAID_AGAIN:
            self._said = now
            self._write("status:o", [f"navigation_status_{status.state.value}"])
        while driver.spoken:
            words = driver.spoken.popleft()
            if self._ports:
                self._ports["speak:o"].write([words])

    def around(self, now: float, driver: Driver, pose: Pose | None, moved: Pose | None) -> None:
        """Show the local grid, and the way ahead; twice a second while there is a goal."""
        if self._ports and self._ports["gui:o"].heard:
            self._write("gui:o", gui(driver))
        if pose is None or moved is None or 0.0 <= now - self._mapped < _MAP_EVERY:
            return
        self._mapped = now
        self._map.publish(local_map(driver, pose, moved, self._header(), now))
        if driver.target is not None:
            fixed = pose @ moved.inverse
            poses = [pose, *(fixed @ Pose(x, y, 0.0) for x, y in driver.way), driver.target.pose]
            header = self._header()
            self._path.publish({
                "header": header, "poses": [{"header": header, "pose": pose_message(each)} for each in poses]
            })  # fmt: skip

    def _write(self, name: str, values: list[Any]) -> None:
        """Write with a time stamp, as YARP's robotGoto does at these ports."""
        self._stamp.update(self._host.clock.now_ns() / 1e9)
        self._ports[name].write(values, self._stamp.to_text())

    def _header(self) -> Message:
        return {"stamp": self._host.clock.stamp(), "frame_id": self._frame}


def local_map(driver: Driver, pose: Pose, moved: Pose, header: Message, now: float) -> Message:
    """The local grid as ``nav_msgs/msg/OccupancyGrid`` on the map, turned as the odometry's frame lies there."""
    x, y = driver.grid.origin
    origin = pose @ moved.inverse @ Pose(x, y, 0.0)
    info = {"resolution": RESOLUTION, "width": SIDE, "height": SIDE, "origin": pose_message(origin)}
    cells = np.ascontiguousarray(driver.grid.occupancy(now)).reshape(-1)
    return {"header": header, "info": info, "data": cells}


def gui(driver: Driver) -> list[float]:
    """The nine numbers of ``gui:o``: command, forces and goal, degrees (`robotGotoDev`, ``sendGui``)."""
    aside, angle = float(driver.ahead[3]), math.degrees(float(driver.ahead[4]))
    weight = max(0.0, 1.0 - aside / INFLUENCE) / 2.0
    return [*driver.command.polar, angle, angle + 90.0, weight, 0.0, INFLUENCE, math.degrees(driver.bearing)]
