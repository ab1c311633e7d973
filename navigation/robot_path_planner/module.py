"""The module RobotPathPlanner: an action of the hub, ports of YARP, and a local navigator below.

What robotology/navigation's ``robotPathPlannerDev`` is to a YARP robot.
"""

from __future__ import annotations

import base64
import time
from dataclasses import replace
from typing import Any

from bridge.config.sections.robot_path_planner import YARP, RobotPathPlannerSection
from bridge.config.sections.section import Section
from bridge.hub.errands import Errands
from bridge.hub.qos import Durability, Qos
from bridge.modules.action_server import Goal
from bridge.modules.host import Host
from bridge.modules.module import Module
from bridge.stores.kinds import AREA, BEHAVIOUR, CURRENT, MAP
from bridge.worker import Health
from navigation.calls import Calls
from navigation.clients import CUT_OFF, GONE, Clients, FarClients
from navigation.constraints import Constraints
from navigation.current_goal import CurrentGoal, duration, result
from navigation.frames import Frames, FramesError
from navigation.goals import Place, goal_of
from navigation.localized import Localized
from navigation.maps.grid import from_grid
from navigation.messages import pose_message
from navigation.plan_error import PlanError
from navigation.pose import Pose
from navigation.robot_path_planner.action_navigator import ACTION, ActionNavigator
from navigation.robot_path_planner.clicks import goal_of_click
from navigation.robot_path_planner.device import Device
from navigation.robot_path_planner.laser import Laser
from navigation.robot_path_planner.maps import StoreAtlas
from navigation.robot_path_planner.picture import png
from navigation.robot_path_planner.planner import PathPlanner
from navigation.robot_path_planner.settings import settings_of
from navigation.robot_path_planner.told import PREFIX, Told
from navigation.robot_path_planner.words import PlannerServer
from navigation.robot_path_planner.yarp_navigator import YarpNavigator
from navigation.scan import SCAN
from navigation.status import Fault, State
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.pythonic import Received
from yarp_compat.wire.errors import WireError

_GRID = "nav_msgs/msg/OccupancyGrid"
_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)
_FEEDBACK = 0.2
_SPEED = 0.2
"""m/s, from which the time that is left is guessed until the robot has driven for some seconds."""


class RobotPathPlanner(Module):
    """Plans ways and has them driven."""

    name = "robot_path_planner"

    def start(self, host: Host, section: Section) -> None:
        """Open what the section names."""
        assert isinstance(section, RobotPathPlannerSection)
        self._host = host
        settings, section, self._notes = settings_of(section)
        for note in self._notes:
            host.log.warning("%s", note)
        self._section = section
        self._goal = CurrentGoal(host.loop, self.stop_driving)
        self._began, self._length = 0.0, 0.0
        self._fed = float("-inf")
        self._localized, self._trouble = Localized(host), ""
        self._atlas = StoreAtlas(host.store, settings)
        self.planner = PathPlanner(settings, self._atlas)
        self._frames = Frames(host, section.frame, section.base_frame)
        self._laser = Laser(self.planner, self._frames)
        self._told = Told(host, section.frame, section.prefix)
        # links and their locations are looked up whenever a way is planned
        self._closing = [host.store.watch(self._store_changed, MAP, CURRENT, AREA, BEHAVIOUR)]
        self._store_due = False
        self._grid: MapGrid2D | None = None
        self._local = self._navigator()
        self._errands = Errands("midspan-brake")
        self._closing.append(self._errands.close)
        self._listen()
        self._offer()
        self._take_map()
        host.on_jump(self._forget)
        host.every(section.period, self._step)
        if section.image_hz > 0:
            host.every(1.0 / section.image_hz, lambda: self._told.show(self.planner, self._pose_now()))

    def _navigator(self) -> ActionNavigator | YarpNavigator:
        name = self._section.navigator
        if not name.startswith(YARP):
            return ActionNavigator(self._host, name, self._section.frame)
        made = YarpNavigator(name.removeprefix(YARP), self._map_name, self._host.yarp.naming)
        self._closing.append(made.close)
        return made

    def _listen(self) -> None:
        node, section = self._host.node, self._section
        if section.scan:
            node.subscription(section.scan, SCAN, lambda scan: self._laser.take(self.now(), scan), Qos(depth=1))
        if section.map not in (None, "store"):
            node.subscription(str(section.map), _GRID, self._grid_told, _LATCHED)

    def _offer(self) -> None:
        host, prefix = self._host, self._section.prefix
        self._server = host.node.action_server(
            f"{PREFIX}/navigate_to_pose", ACTION, self._take, self._goal.cancel, brake=self._brake
        )
        Clients(host, self._server, lambda: self._give_up(GONE))
        FarClients(host, self._server, lambda goal: self._give_up(CUT_OFF) if goal is self._goal.goal else None)
        host.answer("picture", lambda _params: host.loop.call(self.picture))
        host.answer("halt", self._halt_asked)
        if prefix:
            calls = Calls(host.loop)
            device = Device(self, calls)
            radius = lambda: self.planner.settings.robot_radius  # noqa: E731
            words = PlannerServer(device, radius, lambda value: calls.do(lambda: self.set_radius(value)))
            host.yarp.serve(f"{prefix}/rpc", words)
            host.yarp.input(f"{prefix}/yarpviewTarget:i", self._clicked)

    # what is asked

    def now(self) -> float:
        """The planner's time, seconds: the run's where it is simulated, else of a clock that nobody sets."""
        clock = self._host.clock
        return clock.now_ns() / 1e9 if clock.simulated else time.monotonic()

    def pose(self) -> Pose:
        """The robot's on the map; raises `FramesError` with why it is not known."""
        self._localized.check()
        return self._frames.pose()

    def drive(self, *places: Place, constraints: Constraints | None = None, goal: Goal | None = None) -> None:
        """Drive to places, one after the other, instead of where it is driving."""
        self._goal.replace(goal)
        place, *further = places
        self.planner.goal(place.pose, place.map_name, constraints, now=self.now(), then=further)
        self._began, self._length = self.now(), 0.0
        self._tell()

    def stop_driving(self, reason: str) -> None:
        """Give the goal up."""
        self.planner.cancel(reason)
        self._step()

    def brake(self) -> None:
        """Have the robot stand still at once, on any thread; what is asked for follows on the module's own."""
        task = self.planner.task
        if task is not None:
            self.planner.brake(task)
            self._local.brake()()

    def _brake(self, goal_id: bytes) -> None:
        """On a thread of the hub, which must not wait."""
        task, goal = self.planner.task, self._goal.goal  # in this order: a task that has been replaced does not matter
        if task is not None and goal is not None and (goal.id == goal_id or not any(goal_id)):
            self.planner.brake(task)
            stop = self._local.brake()
            if self.planner.task is task:  # else it is of the goal that took its place
                self._errands.send(stop)

    def _halt_asked(self, _params: dict[str, Any]) -> Any:
        """On a thread of the hub."""
        self.brake()
        return self._host.loop.call(self.halt)

    def halt(self) -> dict[str, Any]:
        """Give the goal up, whoever sent it."""
        self.stop_driving("halted")
        return {"halted": True}

    def local_map(self) -> MapGrid2D | None:
        """The map with what the laser sees as temporary obstacles."""
        ground, clutter = self.planner.ground, self.planner.clutter
        if ground is None or clutter is None:
            return None
        flags = ground.grid.flags.copy()
        rows, columns = clutter.cells.T
        flags[rows, columns] = MapFlag.TEMPORARY_OBSTACLE
        grid = ground.grid
        return MapGrid2D.of(flags, grid.occupancy, name=grid.name, resolution=grid.resolution, origin=grid.origin)

    def set_radius(self, metres: float) -> None:
        """Keep another distance to walls."""
        self.planner.settings = self._atlas.settings = replace(self.planner.settings, robot_radius=metres)
        self._atlas.forget()
        self._use(self._grid)

    def picture(self) -> dict[str, Any]:
        """The map with the way, as PNG in base64."""
        file = png(self.planner, self._pose_now())
        return {"png": base64.b64encode(file).decode() if file else "", "status": self.planner.status.state.value}

    def _give_up(self, why: str) -> None:
        """Stand still although nobody cancelled the goal."""
        self._goal.end(State.ABORTED, Fault.NO_NAVIGATOR, why)
        self.stop_driving(why)

    # the hub's action

    def _take(self, goal: Goal) -> bool:
        try:
            place, wanted = goal_of(goal.goal, self._frames, lambda: self._host.store.names(MAP))
        except PlanError as err:
            goal.abort(result(err.fault, str(err)))
            return True
        self.drive(place, constraints=wanted, goal=goal)
        return True

    def _clicked(self, received: Received) -> None:
        """On the thread of the connection."""
        values = received.values

        def drive() -> None:
            self.drive(Place("", goal_of_click(self.planner.ground, values)))

        try:
            self._host.loop.call(drive, late=False)
        except ValueError as err:
            raise WireError(str(err)) from None  # the port counts it, and tells of it now and then

    # what happens

    def _step(self) -> None:
        try:
            self._drive()
        except Exception as err:
            self._fail(f"RobotPathPlanner failed: {type(err).__name__}: {err}")
            raise

    def _fail(self, why: str) -> None:
        """Stand still, and end the goal: what failed once fails again."""
        self._local.cancel()
        self._goal.end(State.ABORTED, Fault.OTHER, why)
        self.planner.cancel(why)

    def _drive(self) -> None:
        lost, pose = "", None
        try:
            pose = self.pose()
        except FramesError as err:
            lost = str(err)
        self.planner.blind = self._laser.silent(self.now())
        self.planner.step(self.now(), pose, self._local, lost)
        self._tell()
        self._feed(pose)

    def _tell(self) -> None:
        status = self.planner.status
        self._told.tell(self.now(), self.planner, self._goal.id)
        if not self.planner.active:
            self._goal.end(status.state, status.fault, status.reason)

    def _feed(self, pose: Pose | None) -> None:
        """Feedback for the goal's client."""
        now, goal = self.now(), self._goal.goal
        if goal is None or pose is None or 0 <= now - self._fed < _FEEDBACK:
            return
        self._fed = now
        left, passed = self.planner.remaining(pose), max(now - self._began, 0.0)
        self._length = max(self._length, left)
        driven = self._length - left
        speed = driven / passed if driven > 1.0 and passed > 0.0 else _SPEED
        goal.feedback({
            "current_pose": {
                "header": {"stamp": self._host.clock.stamp(), "frame_id": self._section.frame},
                "pose": pose_message(pose),
            },
            "navigation_time": duration(passed),
            "estimated_time_remaining": duration(left / max(speed, 0.01)),
            "number_of_recoveries": self.planner.recoveries,
            "distance_remaining": left,
        })  # fmt: skip

    def _pose_now(self) -> Pose | None:
        try:
            return self.pose()
        except FramesError:
            return None

    def _forget(self) -> None:
        """The clock was set back: what was planned by it is no more."""
        self.stop_driving("the clock was set back")

    # maps

    def _map_name(self) -> str:
        return self.planner.ground.name if self.planner.ground else ""

    def _store_changed(self, _change: object) -> None:
        """On the store's thread; many changes at once are taken up once."""
        if not self._store_due:
            self._store_due = True
            self._host.loop.post(self._take_map)

    def _take_map(self) -> None:
        self._store_due = False
        self._atlas.forget()
        if self._section.map in (None, "store"):
            name = self._host.store.current_map()
            self._grid = self._host.store.get(MAP, name) if name else None
        self._use(self._grid)

    def _grid_told(self, message: dict[str, Any]) -> None:
        try:
            topic = str(self._section.map)
            name = self._host.config.modules.map2d_server.taken_as(topic)
            grid = from_grid(message, name or self._host.store.current_map() or topic.strip("/"))
        except ValueError as err:
            self._trouble = f"{self._section.map}: {err}"
            return
        self._trouble = ""
        self._grid = grid
        self._use(grid)

    def _use(self, grid: MapGrid2D | None) -> None:
        self.planner.use_map(None if grid is None else self._atlas.made(grid))

    # how it is

    def health(self) -> Health:
        """What it is doing, or what it lacks."""
        if self._trouble:
            return Health("waiting", self._trouble)
        if self.planner.ground is None:
            where = "the store has no current map" if self._section.map in (None, "store") else "no map has come"
            return Health("waiting", f"{where}; goals are refused")
        status = self.planner.status
        return Health("running", f"{status.state.value}: {status.reason}" if status.reason else status.state.value)

    def status(self) -> dict[str, Any]:
        """The map, the goal and how it is getting on."""
        status, target = self.planner.status, self.planner.target
        return {
            "planner": {"state": status.state.value, "reason": status.reason, "fault": int(status.fault)},
            "map": self._map_name(),
            "goal": None if target is None else [target.map_name, *target.pose[:3]],
            "waypoints": [[each.pose.x, each.pose.y] for each in self.planner.waypoints],
            "navigator": {"name": self._section.navigator, "state": self._local.state.value},
            "laser": self._laser.trouble,
            "notes": list(self._notes),
        }

    def stop(self) -> None:
        """Have the robot stand still, and hear no more."""
        self._goal.end(State.ABORTED, Fault.NO_NAVIGATOR, "the planner is stopped")
        self.planner.cancel("the planner is stopped")
        self._step()
        for close in self._closing:
            close()
