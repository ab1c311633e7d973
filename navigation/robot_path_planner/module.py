"""The module RobotPathPlanner: it serves an action on the hub and YARP ports, and sends waypoints to a local navigator.

It replaces robotology/navigation's ``robotPathPlannerDev``.
"""

from __future__ import annotations

import base64
from collections.abc import Collection, Iterable
from typing import Any

from typing_extensions import override

from bridge.concurrency import SerialExecutor
from bridge.config.sections.section import Section
from bridge.hub.wire.qos import Qos
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from bridge.status import Part
from bridge.stores.kinds import AREA, BEHAVIOR, CURRENT, MAP
from bridge.stores.store import MapAreas
from bridge.worker import Health
from navigation.constraints import Constraints
from navigation.frames import LATE, FramesError, RobotFrames
from navigation.goals import MapPlace
from navigation.ini import laid_under
from navigation.layers import LayerSubscriptions
from navigation.map_in_use import MapInUse
from navigation.messages import THROUGH, stamp_ns
from navigation.planner_module import PlannerModule
from navigation.pose import Pose
from navigation.robot_path_planner.atlas import StoreAtlas
from navigation.robot_path_planner.navigators import ActionNavigator, YarpNavigator
from navigation.robot_path_planner.planner import PathPlanner
from navigation.robot_path_planner.ports import PathPlannerDevice, PathPlannerTopics, PlannerServer, goal_of_click, png
from navigation.robot_path_planner.section import YARP, RobotPathPlannerSection
from navigation.robot_path_planner.settings import read_file
from navigation.scan import SCAN, ScanError, is_blind, of_ros
from navigation.status import Fault, PlanError, PlannerStatus, State
from navigation.yarp import Calls
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.pythonic import Received
from yarp_compat.wire.errors import WireError

_SCAN_PERIOD = 0.2  # seconds
_SILENT = 1.0  # seconds without a usable scan, after which the laser counts as silent


class ObstacleScans:
    """Passes scans to the planner at a limited rate."""

    def __init__(self, planner: PathPlanner, frames: RobotFrames) -> None:
        self._planner, self._frames = planner, frames
        self._last, self._seen = float("-inf"), float("inf")
        self.trouble = ""

    def on_scan(self, now: float, message: dict[str, Any]) -> None:
        """Handle a ``sensor_msgs/LaserScan``."""
        if not self._planner.active:
            self._seen = now
            return
        if 0 <= now - self._last < _SCAN_PERIOD:
            return
        self._last = now
        header = message["header"]
        stamp = stamp_ns(header)
        try:
            turn = of_ros(message, stamp, upside_down=self._frames.is_upside_down(header["frame_id"]))
            if not is_blind(turn):
                self._seen = now
            pose = self._frames.transform(self._frames.map_frame, header["frame_id"], stamp, extrapolate=LATE)
        except (FramesError, ScanError) as err:
            self.trouble = str(err)
            return
        self.trouble = ""
        self._planner.scan(now, pose, turn)

    def silent(self, now: float) -> str:
        """Return a text with the time since the last usable scan; "" up to `_SILENT`, or if no scan was received."""
        silent = now - self._seen
        return f"the laser is silent: no usable scan for {silent:.1f} s" if silent > _SILENT else ""


_SPEED = 0.2  # m/s that the estimate of the remaining time assumes until the robot has driven one meter


class RobotPathPlanner(PlannerModule):
    """Plans paths, which a local navigator drives."""

    name = "robot_path_planner"

    @override
    def start(self, host: Host, section: Section) -> None:
        assert isinstance(section, RobotPathPlannerSection)
        self._section, self._notes = laid_under(section, section.ini, read_file, merged=section.merged)
        section = self._section
        for note in self._notes:
            host.log.warning("%s", note)
        self._length, self._areas = 0.0, MapAreas()
        self._atlas = StoreAtlas(host.store, section)
        self.planner = PathPlanner(section, self._atlas)
        self._open(host, RobotFrames(host, section.frame, section.base_frame))
        self._laser = ObstacleScans(self.planner, self._frames)
        self._topics = PathPlannerTopics(host, section.frame, section.prefix)
        # links and their locations are read for every plan
        self._map = MapInUse(host, section.map, self._use, MAP, CURRENT, AREA, BEHAVIOR)
        self._executor = SerialExecutor("midspan-brake")
        self._closing = [self._map.close, self._executor.close]
        self._local = self._navigator()
        if section.scan:
            on_scan = lambda scan: self._laser.on_scan(self.now(), scan)  # noqa: E731
            host.node.subscription(section.scan, SCAN, on_scan, Qos(depth=1))
        self._layers = LayerSubscriptions(host, section.obstacles, self._frames, self.planner.layer, self.now)
        self._serve(self._brake)
        self._serve(self._brake, "navigate_through_poses", THROUGH)
        host.answer("picture", lambda _params: host.loop.call(self.picture))
        host.answer("halt", self._on_halt)
        if section.prefix:
            self._serve_yarp(host, section.prefix)
        self._map.update()
        if host.clock.simulated:  # setting the system clock does no harm, because `now` does not depend on it
            host.on_jump(lambda: self.stop_driving("the clock jumped back"))
        host.every(section.period, self._step)
        if section.image_hz > 0:
            host.every(1.0 / section.image_hz, lambda: self._topics.show(self.planner, self._pose_now()))

    def _navigator(self) -> ActionNavigator | YarpNavigator:
        name = self._section.navigator
        if not name.startswith(YARP):
            return ActionNavigator(self._host, name, self._section.frame)
        navigator = YarpNavigator(name.removeprefix(YARP), self.map_name, self._host.yarp.naming)
        self._closing.append(navigator.close)
        return navigator

    def _serve_yarp(self, host: Host, prefix: str) -> None:
        calls = Calls(host.loop, PlanError, FramesError)
        device = PathPlannerDevice(self, calls, self.planner, self.brake)
        radius = lambda: self.planner.settings.robot_radius  # noqa: E731
        server = PlannerServer(device, radius, lambda value: calls.do(lambda: self.set_radius(value)))
        host.yarp.serve(f"{prefix}/rpc", server)
        host.yarp.input(f"{prefix}/yarpviewTarget:i", self._clicked)

    # requests

    @property
    @override
    def target(self) -> MapPlace | None:
        return self.planner.target

    @property
    @override
    def progress(self) -> PlannerStatus:
        return self.planner.status

    @override
    def map_name(self) -> str:
        ground = self.planner.ground  # another thread reads this
        return ground.name if ground else ""

    @override
    def _poses_left(self) -> int:
        task = self.planner.task
        return 0 if task is None else 1 + len(task.further)

    @override
    def _map_names(self) -> Collection[str]:
        return self._host.store.names(MAP)

    @override
    def drive(self, *places: MapPlace, constraints: Constraints | None = None, goal: Goal | None = None) -> None:
        self.compiled.check()
        self._goal.replace(goal)
        place, *further = places
        self.planner.goal(place.pose, place.map_name, constraints, now=self.now(), then=further)
        self._began, self._length = self.now(), 0.0
        self._publish()

    @override
    def stop_driving(self, reason: str) -> None:
        self.planner.cancel(reason)
        self._step()

    def brake(self) -> None:
        """Stop the robot at once; called on any thread before the module's thread handles the request."""
        task = self.planner.task
        if task is not None:
            self.planner.brake(task)
            self._local.brake()()

    def _brake(self, goal_id: bytes) -> None:
        """Stop the robot at once; runs on a thread of the hub, which must not block."""
        task, goal = self.planner.task, self._goal.goal  # read in this order, so that a replaced task does no harm
        if task is not None and goal is not None and (goal.id == goal_id or not any(goal_id)):
            self.planner.brake(task)
            stop = self._local.brake()
            if self.planner.task is task:  # else `stop` belongs to the goal that replaced it
                self._executor.submit(stop)

    def _on_halt(self, _params: dict[str, Any]) -> Any:
        """Handle the request "halt"; runs on a thread of the hub."""
        self.brake()
        return self._host.loop.call(self.halt)

    @override
    def pause(self, seconds: float) -> None:
        if not self.planner.active:
            raise PlanError(Fault.OTHER, "no active goal to suspend")
        self.planner.pause(self.now(), seconds)

    @override
    def resume(self) -> None:
        if self.planner.status.state is not State.PAUSED:
            raise PlanError(Fault.OTHER, "no suspended goal")
        self.planner.resume()

    @override
    def local_map(self) -> MapGrid2D | None:
        """Return the map with the laser's obstacles as temporary obstacles."""
        ground, clutter = self.planner.ground, self.planner.clutter
        if ground is None or clutter is None:
            return None
        flags = ground.grid.flags.copy()
        rows, columns = clutter.cells.T
        flags[rows, columns] = MapFlag.TEMPORARY_OBSTACLE
        grid = ground.grid
        return MapGrid2D.of(flags, grid.occupancy, name=grid.name, resolution=grid.resolution, origin=grid.origin)

    def set_radius(self, meters: float) -> None:
        """Set the robot's radius, which is its distance to walls."""
        self.planner.settings = self._atlas.settings = self.planner.settings.model_copy(update={"robot_radius": meters})
        self._use(self._map.grid)

    def picture(self) -> dict[str, Any]:
        """Return the map with the path, as PNG in base64."""
        file = png(self.planner, self._pose_now())
        return {"png": base64.b64encode(file).decode() if file else "", "status": self.planner.status.state.value}

    def _clicked(self, received: Received) -> None:
        """Handle a click on the picture; runs on the connection's thread."""
        values = received.values

        def drive() -> None:
            self.drive_locally(MapPlace("", goal_of_click(self.planner.ground, values)))

        try:
            self._host.loop.call(drive, late=False)
        except ValueError as err:
            raise WireError(str(err)) from None  # the port counts such errors, and logs them at intervals

    # steps

    @override
    def on_failure(self, error: BaseException) -> bool:
        """Stop, and end the goal, because another step may fail as well."""
        reason = f"RobotPathPlanner failed: {type(error).__name__}: {error}"
        self._local.cancel()
        self._goal.end(PlannerStatus(State.ABORTED, reason, Fault.OTHER))
        self.planner.cancel(reason)
        return True

    def _step(self) -> None:
        lost, pose = "", None
        try:
            pose = self.pose()
        except FramesError as err:
            lost = str(err)
        self.planner.blind, self.planner.silent = self._laser.silent(self.now()), self._layers.silent()
        self.planner.step(self.now(), pose, self._local, lost)
        self._publish()
        self._feed(pose)

    def _publish(self) -> None:
        self._topics.publish(self.now(), self.planner, self._goal.id)
        if not self.planner.active:
            self._goal.end(self.planner.status)

    @override
    def _remaining(self, pose: Pose, passed: float) -> tuple[float, float, int]:
        left = self.planner.remaining(pose)
        self._length = max(self._length, left)
        driven = self._length - left
        speed = driven / passed if driven > 1.0 and passed > 0.0 else _SPEED
        return left, max(speed, 0.01), self.planner.recoveries

    def _use(self, grid: MapGrid2D | None) -> None:
        self._atlas.clear()
        areas = MapAreas() if grid is None else self._atlas.areas(grid.name)
        self.planner.use_map(None if grid is None else self._atlas.ground_of(grid, areas))
        self._areas = areas  # last: another thread reads the health, which may be running only with these areas

    # state

    @override
    def health(self) -> Health:
        layers = "; ".join(self._layers.trouble.values())
        trouble = self.compiled.trouble or self._map.trouble or self._areas.closed or layers
        if trouble:
            no_map = self.planner.ground is None and not self.compiled.trouble
            return Health("waiting", trouble + ("; goals wait for a map" if no_map else ""))
        silent = self._layers.silent()
        return (
            Health("waiting", f"{silent}; goals wait for the layer")
            if silent
            else Health("running", self.progress.words)
        )

    @override
    def status(self) -> Part:
        target = self.planner.target
        return Part(
            **super().status().document(),
            map=self.map_name(),
            goal=None if target is None else [target.map_name, *target.pose[:3]],
            waypoints=[[waypoint.pose.x, waypoint.pose.y] for waypoint in self.planner.waypoints],
            navigator={"name": self._section.navigator, "state": self._local.state.value},
            laser=self._laser.trouble,
            layers=dict(self._layers.trouble),
        )

    @override
    def warnings(self) -> Iterable[str]:
        return self._areas.warnings

    @override
    def stop(self) -> None:
        self._goal.end(PlannerStatus(State.ABORTED, "the planner has stopped", Fault.NO_NAVIGATOR))
        self.planner.cancel("the planner has stopped")
        self._step()
        for close in self._closing:
            close()
