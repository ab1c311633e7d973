"""The module RobotGoto: an action of the hub, a laser and frames, commands to the base, and ports of YARP.

What robotology/navigation's ``robotGotoDev`` is to a YARP robot.
"""

from __future__ import annotations

import math
import time
from typing import Any

from bridge.config.sections.robot_goto import RobotGotoSection
from bridge.config.sections.section import Section
from bridge.hub.qos import Qos
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.modules.newest import Newest
from bridge.stores.errors import StoreError
from bridge.worker import Health
from navigation.calls import Calls
from navigation.clients import CUT_OFF, GONE, Clients, FarClients
from navigation.connected import Connected
from navigation.constraints import Constraints
from navigation.current_goal import CurrentGoal, duration, result
from navigation.frames import Frames, FramesError
from navigation.goals import goal_of
from navigation.localized import Localized
from navigation.maps.grid import from_grid
from navigation.messages import pose_message
from navigation.plan_error import PlanError
from navigation.pose import Pose
from navigation.robot_goto.beams import laser_pose, moved_at
from navigation.robot_goto.device import GotoServer
from navigation.robot_goto.driver import Driver
from navigation.robot_goto.settings import settings_of
from navigation.robot_goto.told import PREFIX, Told, local_map
from navigation.scan import SCAN, ScanError, of_ros, of_yarp
from navigation.status import Fault, State
from yarp_compat.dev.laserscan import LaserScan2D
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.pythonic import Received

ACTION = "nav2_msgs/action/NavigateToPose"
_FEEDBACK = 0.2


class RobotGoto(Module):
    """Drives to goals by laser and frames alone."""

    name = "robot_goto"

    def start(self, host: Host, section: Section) -> None:
        """Open what the section names."""
        assert isinstance(section, RobotGotoSection)
        self._host = host
        self._settings, section, self._notes = settings_of(section)
        for note in self._notes:
            host.log.warning("%s", note)
        self._section = section
        self.driver = Driver(self._settings)
        self._goal = CurrentGoal(host.loop, self.stop_driving)
        self._began, self._fed = 0.0, -math.inf
        self._localized, self._laser_trouble = Localized(host), ""
        self._lost = ""
        self._frames = Frames(host, section.frame, section.base_frame, section.odom_frame)
        self._yarp_scans = Newest(host.loop, self._take_yarp)
        self._told = Told(host, section.frame, section.cmd_vel, section.prefix)
        self._connected: Connected | None = None
        if section.scan:
            host.node.subscription(section.scan, SCAN, self._scanned, Qos(depth=1))
        self._server = host.node.action_server(f"{PREFIX}/navigate_to_pose", ACTION, self._take, self._goal.cancel)
        Clients(host, self._server, lambda: self._give_up(GONE))
        FarClients(host, self._server, lambda goal: self._give_up(CUT_OFF) if goal is self._goal.goal else None)
        host.answer("halt", lambda _params: host.loop.call(self.halt))
        self._offer(host, section)
        host.on_jump(self._forget)
        host.every(section.period, self._step)

    def _offer(self, host: Host, section: RobotGotoSection) -> None:
        if not section.prefix:
            return
        host.yarp.serve(f"{section.prefix}/rpc", GotoServer(self, Calls(host.loop)))
        mine = f"{section.prefix}/laser:i"
        host.yarp.input(mine, self._yarp_scanned)
        if section.laser_port:
            self._connected = Connected(host.yarp.naming, section.laser_port, mine)

    # the senses

    def now(self) -> float:
        """The driver's time, seconds: the run's where it is simulated, else of a clock that nobody sets."""
        clock = self._host.clock
        return clock.now_ns() / 1e9 if clock.simulated else time.monotonic()

    def pose(self) -> Pose:
        """The robot's on the map; raises `FramesError` with why it is not known."""
        self._localized.check()
        return self._frames.pose()

    def _moved(self, pose: Pose | None) -> Pose | None:
        try:
            return self._frames.odometry()
        except FramesError:
            return pose

    def _scanned(self, message: dict[str, Any]) -> None:
        header = message["header"]
        stamp = header["stamp"]["sec"] * 1_000_000_000 + header["stamp"]["nanosec"]
        age = max(self._host.clock.now_ns() - stamp, 0) if stamp else 0
        try:
            hangs = self._frames.hangs(header["frame_id"])
            turn = of_ros(message, round(self.now() * 1e9) - age, hangs=hangs)
            laser = laser_pose(self._frames, header["frame_id"])
            self.driver.scan(turn, moved_at(self._frames, stamp), laser)
        except (FramesError, ScanError) as err:
            self._laser_trouble = str(err)
            self.driver.unplaced = str(err) if isinstance(err, FramesError) else ""
        else:
            self._laser_trouble = ""

    def _yarp_scanned(self, received: Received) -> None:
        """On the thread of the connection."""
        self._yarp_scans.put((self.now(), received.to(LaserScan2D)))

    def _take_yarp(self, said: tuple[float, LaserScan2D]) -> None:
        came, scan = said
        if not 0.0 <= self.now() - came <= self.driver.settings.laser_timeout:
            return  # it waited for the thread, or came before the clock was set back
        at = self._section.laser_pose
        try:
            turn = of_yarp(scan, round(came * 1e9))
            self.driver.scan(turn, moved_at(self._frames, 0), Pose(at.x, at.y, math.radians(at.theta)))
        except (FramesError, ScanError) as err:
            self._laser_trouble = str(err)
            self.driver.unplaced = str(err) if isinstance(err, FramesError) else ""
        else:
            self._laser_trouble = ""

    # what is asked

    def map_name(self) -> str:
        """The store's current map, where there is one."""
        try:
            return self._host.store.current_map() or ""
        except StoreError:
            return ""

    def drive(self, pose: Pose, constraints: Constraints | None = None, goal: Goal | None = None) -> None:
        """Drive there, instead of where it is driving."""
        self.driver.goal(pose, constraints)
        self._goal.replace(goal)
        self._began = self.now()
        self._tell(None)

    def approach(self, direction: float, speed: float, seconds: float) -> None:
        """Move by the laser alone: radians, m/s."""
        self._goal.replace(None)
        self.driver.approach(direction, speed, seconds)

    def stop_driving(self, reason: str) -> None:
        """Give the goal up, and stand still at once."""
        self.driver.cancel()
        self._told.stand_still()
        self._goal.end(State.IDLE, Fault.NONE, reason)
        self._tell(None)

    def _give_up(self, why: str, fault: Fault = Fault.NO_NAVIGATOR) -> None:
        """Stand still although nobody cancelled the goal."""
        self._goal.end(State.ABORTED, fault, why)
        self.stop_driving(why)

    def halt(self) -> dict[str, Any]:
        """Give the goal up, whoever sent it."""
        self.stop_driving("halted")
        return {"halted": True}

    def reset(self) -> None:
        """Take the parameters of the start again."""
        self.driver.settings = self._settings

    def local_map(self) -> MapGrid2D | None:
        """The local grid; None before the first scan, or where the robot is lost."""
        pose = self._pose_now()
        moved = self._moved(pose)
        if pose is None or moved is None or self.driver.grid.scanned is None:
            return None
        return from_grid(local_map(self.driver, pose, moved, {}, self.now()), "local_map")

    # the hub's action

    def _take(self, goal: Goal) -> bool:
        try:
            place, wanted = goal_of(goal.goal, self._frames, lambda: ())
        except PlanError as err:
            goal.abort(result(err.fault, str(err)))
            return True
        here = self.map_name()
        if place.map_name and here and place.map_name != here:
            goal.abort(result(Fault.BAD_GOAL, f"the robot is on the map {here}, not on {place.map_name}"))
            return True
        self.drive(place.pose, wanted, goal)
        return True

    # what happens

    def _step(self) -> None:
        try:
            self._drive()
        except Exception as err:
            self._told.stand_still()
            self._give_up(f"RobotGoto failed: {type(err).__name__}: {err}", Fault.OTHER)
            raise

    def _drive(self) -> None:
        pose = self._pose_now()
        moved = self._moved(pose)
        command = self.driver.step(self.now(), pose, None if moved is pose else moved, self._lost)
        self._told.command(command, silent=self.driver.silent)
        self._tell(pose)
        self._told.around(self.now(), self.driver, pose, moved)

    def _pose_now(self) -> Pose | None:
        try:
            pose = self.pose()
        except FramesError as err:
            self._lost = str(err)
            return None
        self._lost = ""
        return pose

    def _tell(self, pose: Pose | None) -> None:
        self._told.status(self.now(), self.driver, self._goal.id)
        goal, status = self._goal.goal, self.driver.status
        if status.ended:
            self._goal.end(status.state, status.fault, status.reason)
        elif goal is not None:
            self._feed(goal, pose)

    def _feed(self, goal: Goal, pose: Pose | None) -> None:
        """Feedback for the goal's client."""
        now, target = self.now(), self.driver.target
        if pose is None or target is None or 0.0 <= now - self._fed < _FEEDBACK:
            return
        self._fed = now
        left = pose.distance(target.pose)
        header = {"stamp": self._host.clock.stamp(), "frame_id": self._section.frame}
        goal.feedback({
            "current_pose": {"header": header, "pose": pose_message(pose)},
            "navigation_time": duration(now - self._began),
            "estimated_time_remaining": duration(left / self.driver.settings.max_lin_speed),
            "distance_remaining": left,
        })  # fmt: skip

    def _forget(self) -> None:
        """The clock was set back: what was seen by it is no more."""
        self.stop_driving("the clock was set back")
        self.driver.forget()

    # how it is

    def health(self) -> Health:
        """What it is doing, or what it lacks."""
        status, scanned = self.driver.status, self.driver.grid.scanned
        if scanned is None or self.now() - scanned > self.driver.settings.laser_timeout:
            return Health("waiting", self._laser_trouble or "no scan of the laser comes; goals wait for one")
        if self._lost:
            return Health("waiting", self._lost)
        return Health("running", f"{status.state.value}: {status.reason}" if status.reason else status.state.value)

    def status(self) -> dict[str, Any]:
        """The goal and how it is getting on."""
        status, target = self.driver.status, self.driver.target
        return {
            "planner": {"state": status.state.value, "reason": status.reason, "fault": int(status.fault)},
            "goal": None if target is None else list(target.pose[:3]),
            "command": list(self.driver.command),
            "laser": self._laser_trouble or (self._connected.trouble if self._connected else ""),
            "notes": list(self._notes),
        }

    def stop(self) -> None:
        """Stand still."""
        self._give_up("RobotGoto is stopped")
        if self._connected is not None:
            self._connected.close()
