"""The module RobotGoto: it serves an action on the hub and YARP ports, and commands the base.

It replaces robotology/navigation's ``robotGotoDev``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.config.sections.section import Section
from bridge.hub.wire.qos import Qos
from bridge.messages.point_cloud import CloudError
from bridge.messages.scan import LaserScan
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from bridge.modules.loop import Newest
from bridge.routing.hold import Hold
from bridge.status import Part
from bridge.stores.entry import StoreError
from bridge.stores.kinds import AREA, BEHAVIOR
from bridge.stores.store import MapAreas
from bridge.worker import Health
from navigation.clouds import POINT_CLOUD, read_points, transform_points
from navigation.constraints import Constraints
from navigation.frames import FramesError, RobotFrames, flat, laser_pose, moved_at
from navigation.goals import MapPlace
from navigation.ini import laid_under
from navigation.layers import LayerSubscriptions
from navigation.map_in_use import MapInUse
from navigation.maps.grid import from_grid
from navigation.messages import stamp_ns
from navigation.planner_module import PlannerModule
from navigation.pose import Pose
from navigation.robot_goto.driver import Driver
from navigation.robot_goto.obstacles import MOST
from navigation.robot_goto.ports import GotoServer, GotoTopics, local_map
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_goto.settings import read_file
from navigation.robot_goto.steering import STILL
from navigation.scan import SCAN, ScanError, of_ros, of_yarp
from navigation.status import Fault, PlanError, PlannerStatus, State
from navigation.yarp import Calls, PortConnection
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.pythonic import Received

CLOUD_PERIOD = 0.15  # seconds between two clouds that are used: all clouds of a camera at 30 Hz would occupy a core

_HELD_SECONDS = 0.5
"""Seconds after which a planner that works has canceled its goal when a stop or pause is requested."""


class RobotGoto(PlannerModule):
    """Drives to goals with only a laser and transforms."""

    name = "robot_goto"

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, RobotGotoSection)
        self._section, self._notes = laid_under(section, section.ini, read_file)
        section = self._section
        for note in self._notes:
            host.log.warning("%s", note)
        self.driver = Driver(section)
        self._stopping = False
        self._lost = self._laser_trouble = ""
        self._clouds: dict[str, float] = {}
        self._open(host, RobotFrames(host, section.frame, section.base_frame, section.odom_frame))
        self._yarp_scans = Newest(host.loop, self._on_yarp_scan)
        self._topics = GotoTopics(host, section.frame, section.cmd_vel, section.prefix, section.period)
        self._connection: PortConnection | None = None
        if section.scan:
            host.node.subscription(section.scan, SCAN, self._on_scan, Qos(depth=1))
        for source in section.obstacles:
            if source.type == "cloud":
                host.node.subscription(source.topic, POINT_CLOUD, partial(self._on_cloud, source.topic), Qos(depth=1))
        others = self.driver.obstacles
        self._layers = LayerSubscriptions(host, section.obstacles, self._frames, others.layer, self.now, others.trouble)
        known = section.keep_out_map
        self._areas, self._map_of_goal = MapAreas(), ""
        self._hold, self._held_since = Hold(host.node.hub, ()), math.inf
        self._goal_at = -math.inf
        self._map = MapInUse(host, known, self._use_map, AREA, BEHAVIOR) if known else None
        self._serve()
        host.answer("halt", lambda _params: host.loop.call(self.halt))
        if section.prefix:
            self._serve_yarp(host, section)
        if host.clock.simulated:  # the system clock may be set while the robot drives: `now` does not depend on it
            host.on_jump(self._restart)
        if self._map is not None:
            self._map.update()
        host.every(section.period, self._step)

    def _serve_yarp(self, host: Host, section: RobotGotoSection) -> None:
        calls = Calls(host.loop, PlanError, FramesError)
        host.yarp.serve(f"{section.prefix}/rpc", GotoServer(self, calls, self.driver, self.approach))
        port = f"{section.prefix}/laser:i"
        host.yarp.input(port, self._queue_yarp_scan)
        if section.laser_port:
            self._connection = PortConnection(host.yarp.naming, section.laser_port, port)

    # sensors

    def _moved(self, pose: Pose | None) -> Pose | None:
        try:
            return self._frames.odometry()
        except FramesError:
            return pose

    def _on_scan(self, message: dict[str, Any]) -> None:
        header, frames = message["header"], self._frames
        stamp = stamp_ns(header)
        age = max(self._host.clock.now_ns() - stamp, 0) if stamp else 0

        def read_scan() -> tuple[LaserScan, Pose]:
            frame = header["frame_id"]
            scan = of_ros(message, round(self.now() * 1e9) - age, upside_down=frames.is_upside_down(frame))
            return scan, laser_pose(frames, frame)

        self._see(read_scan, stamp)

    def _queue_yarp_scan(self, received: Received) -> None:
        """Queue a scan, on the thread of the connection."""
        self._yarp_scans.put((self.now(), received.to(LaserScan2D)))

    def _on_yarp_scan(self, received: tuple[float, LaserScan2D]) -> None:
        time_s, scan = received
        if not 0.0 <= self.now() - time_s <= self.driver.settings.laser_timeout:
            return  # it waited too long for the thread, or the clock jumped back
        at = self._section.laser_pose
        self._see(lambda: (of_yarp(scan, round(time_s * 1e9)), Pose(at.x, at.y, math.radians(at.theta))), 0)

    def _see(self, read: Callable[[], tuple[LaserScan, Pose]], stamp: int) -> None:
        """Pass a scan and its laser's pose to the driver."""
        try:
            scan, laser = read()
            self.driver.scan(scan, moved_at(self._frames, stamp), laser)
        except (FramesError, ScanError) as err:
            self._laser_trouble = str(err)
            self.driver.unplaced = str(err) if isinstance(err, FramesError) else ""
        else:
            self._laser_trouble = ""

    def _on_cloud(self, topic: str, message: dict[str, Any]) -> None:
        """Pass a cloud to the driver, at a limited rate."""
        now, last = self.now(), self._clouds.get(topic, -math.inf)
        if 0.0 <= now - last < CLOUD_PERIOD:
            return
        self._clouds[topic] = now
        stamp = stamp_ns(message["header"])
        age = max(self._host.clock.now_ns() - stamp, 0) / 1e9 if stamp else 0.0
        try:
            points = read_points(message, enough=MOST)
            at, moved = self._frames.placed_at(message["header"]["frame_id"], stamp)
        except (FramesError, CloudError) as err:
            self.driver.obstacles.trouble[topic] = str(err)
            return
        up = np.array((0.0, 0.0, moved.translation[2] + self._frames.floor(self._section.floor)))
        points = transform_points(points, at) - up.astype(np.float32)
        self.driver.obstacles.cloud(topic, now - age, points, np.array(at.translation) - up, flat(moved))

    def _use_map(self, grid: MapGrid2D | None) -> None:
        """Stay out of the keep-out cells and areas of a map."""
        areas = MapAreas() if grid is None else self._host.store.areas(grid.name)
        for text in areas.troubles:
            self._host.log.warning("%s", text)
        self.driver.keep_out.use(grid, areas.keep_out)
        self._areas = areas  # last: another thread reads the health, which may be running only with these areas

    @property
    def _closed(self) -> str:
        """Why the robot must stand: the map's keep-out cells or areas are unknown; "" if it may drive."""
        if self._map is not None and self._map.unknown:
            return f"robots keep out of an unknown map: {self._map.trouble}"
        return self._areas.closed

    def _changed_map(self) -> str:
        """Return which map has replaced the goal's map in the store, as the goal's pose is not valid there; else ""."""
        goal, current = self._map_of_goal, self.map_name()
        if "" in (goal, current) or goal == current or self._host.config.navigation.map != "store":
            return ""
        return f"the map changed from {goal} to {current} while driving"

    def _check(self) -> None:
        """Raise `PlanError` if the robot must not drive at all."""
        if self._stopping:
            raise PlanError(Fault.NO_NAVIGATOR, "RobotGoto is stopping")
        self.compiled.check()
        if closed := self._closed:
            raise PlanError(Fault.NO_MAP, closed)

    # requests

    @property
    @override
    def target(self) -> MapPlace | None:
        task = self.driver.target
        return None if task is None else MapPlace(self.map_name(), task.pose)

    @property
    @override
    def progress(self) -> PlannerStatus:
        return self.driver.status

    @override
    def map_name(self) -> str:
        try:
            return self._host.store.current_map() or ""
        except StoreError:
            return ""

    @override
    def drive(self, *places: MapPlace, constraints: Constraints | None = None, goal: Goal | None = None) -> None:
        self._check()
        (place,) = places
        current = self.map_name()
        if place.map_name and current and place.map_name != current:
            raise PlanError(Fault.BAD_GOAL, f"the robot is on the map {current}, not on {place.map_name}")
        self.driver.goal(place.pose, constraints)
        self._map_of_goal, self._goal_at = current, time.monotonic()
        self._goal.replace(goal)
        self._began = self.now()
        self._publish(None)

    def approach(self, direction: float, speed: float, seconds: float) -> None:
        """Move with only the laser: radians, m/s, seconds. Raises `PlanError` if the robot must not drive."""
        self._check()
        self._goal.replace(self._server.begin())
        self._began = self.now()
        self.driver.approach(direction, speed, seconds)

    @override
    def pause(self, seconds: float) -> None:
        if not self.driver.pause(seconds):
            raise PlanError(Fault.OTHER, "no active goal to suspend")

    @override
    def resume(self) -> None:
        if not self.driver.resume():
            raise PlanError(Fault.OTHER, "no suspended goal")

    @override
    def stop_driving(self, reason: str) -> None:
        self.driver.cancel()
        self._topics.stop_base()
        self._goal.end(PlannerStatus(State.IDLE, reason))
        self._publish(None)

    @override
    def local_map(self) -> MapGrid2D | None:
        """Return the local grid; None before the first scan, or if the pose is unknown."""
        pose = self._pose_now()
        moved = self._moved(pose)
        if pose is None or moved is None or self.driver.grid.scanned is None:
            return None
        return from_grid(local_map(self.driver, pose, moved, {}, self.now()), "local_map")

    # steps

    @override
    def on_failure(self, error: BaseException) -> bool:
        """Stop, and end the goal, because another step may fail as well."""
        self._topics.stop_base()
        self._abort(f"RobotGoto failed: {type(error).__name__}: {error}", Fault.OTHER)
        return True

    def _step(self) -> None:
        if self._stopping:
            return
        if (closed := self._closed) and not self.progress.state.ended:
            self._abort(closed, Fault.NO_MAP)
        if (changed := self._changed_map()) and self.driver.target is not None:
            self._abort(changed, Fault.MAP_CHANGED)
        pose = self._pose_now()
        moved = self._moved(pose)
        self.driver.obstacles.silent = self._layers.silent()
        self._end_held()
        command = self.driver.step(self.now(), pose, None if moved is pose else moved, self._lost)
        self._topics.command(STILL if self._hold.held else command, silent=self.driver.silent)
        self._publish(pose)
        self._topics.publish_surroundings(self.now(), self.driver, pose, moved)

    def _end_held(self) -> None:
        """End a goal that the planner still has after a stop or pause: it may hang, and never cancel the goal."""
        now = time.monotonic()
        self._held_since = min(self._held_since, now) if self._hold.held else math.inf
        if now - self._held_since > _HELD_SECONDS and self._goal_at < self._held_since and self.driver.target:
            self._abort("a stop or pause was requested, and the planner has not canceled its goal")

    @override
    def _pose_now(self) -> Pose | None:
        try:
            pose = self.pose()
        except FramesError as err:
            self._lost = str(err)
            return None
        self._lost = ""
        return pose

    def _publish(self, pose: Pose | None) -> None:
        self._topics.status(self.now(), self.driver, self._goal.id)
        status = self.driver.status
        if status.state.ended:
            self._goal.end(status)
        else:
            self._feed(pose)

    @override
    def _remaining(self, pose: Pose, _passed: float) -> tuple[float, float, int]:
        target = self.driver.target
        left = 0.0 if target is None else pose.distance(target.pose)
        return left, self.driver.settings.max_lin_speed, 0

    def _restart(self) -> None:
        """Drop the goal and all observations."""
        self.stop_driving("the clock jumped back")
        self.driver.restart()

    # state

    @override
    def health(self) -> Health:
        trouble = self.compiled.trouble or self._closed
        if trouble:
            return Health("waiting", trouble)
        scanned = self.driver.grid.scanned
        if scanned is None or self.now() - scanned > self.driver.settings.laser_timeout:
            return Health("waiting", self._laser_trouble or "waiting for a scan of the laser")
        self.driver.obstacles.silent = self._layers.silent()
        silence = self.driver.obstacles.silence(self.now())
        if silence or self._lost:
            return Health("waiting", silence or self._lost)
        return Health("running", self.driver.status.words)

    @override
    def status(self) -> Part:
        target = self.driver.target
        return Part(
            **super().status().document(),
            goal=None if target is None else list(target.pose[:3]),
            command=list(self.driver.command),
            laser=self._laser_trouble or (self._connection.trouble if self._connection else ""),
            obstacles=dict(self.driver.obstacles.trouble),
            keep_out=self._keep_out_status(),
        )

    @override
    def warnings(self) -> Iterable[str]:
        return self._areas.warnings

    def _keep_out_status(self) -> str:
        if self._map is None:
            return "keep_out_map is not set"
        known = self.driver.keep_out.known and not self._map.unknown
        return "known" if known else self._map.trouble

    @override
    def begin_stop(self, done: Callable[[], None]) -> None:
        """Stop the robot; zero is repeated first, because a base that was starved for a moment drops a single zero."""
        self._stopping = True
        if not self.driver.silent:
            self._abort("RobotGoto has stopped")

        def repeat() -> None:
            self._topics.command(STILL, silent=True)
            if self._topics.resting:
                timer.close()
                done()

        # not `Host.every`: a simulator that stops, too, also stops the simulated time
        timer = self._host.loop.every(self._section.period, repeat)
        repeat()

    @override
    def stop(self) -> None:
        if not self.driver.silent:  # the thread was busy, or `begin_stop` has failed
            self._abort("RobotGoto has stopped")
        self._hold.close()
        if self._map is not None:
            self._map.close()
        if self._connection is not None:
            self._connection.close()
