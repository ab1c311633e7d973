"""Midspan's navigation: RobotPathPlanner, RobotGoto and the localizer for one robot, in lock-step, without a hub."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.closedloop.robot import Robot
from benchmarks.closedloop.worlds import World
from bridge.config.sections.obstacles import ObstacleSection
from navigation.constraints import Constraints
from navigation.localization_server.estimate import LocalizationStatus
from navigation.localization_server.localizer import Localizer
from navigation.localization_server.section import LocalizerSection
from navigation.mapper3d.depth import Camera
from navigation.mapper3d.layer import grid_of
from navigation.mapper3d.section import LayerSection, Mapper3DSection
from navigation.mapper3d.space import OPTICAL, FieldOfView, SensorPose, Space
from navigation.pose import Pose
from navigation.robot_goto.driver import Driver
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_path_planner.ground import Ground
from navigation.robot_path_planner.planner import PathPlanner
from navigation.robot_path_planner.section import RobotPathPlannerSection
from navigation.scan import scan_points
from navigation.status import Fault, State
from sim.base import BasePose

RADII = {"r1": 0.3, "ikart_v1": 0.38}
"""The robots' radii for navigation: the R1's from its own files, the iKart's slightly more than its hull."""

_ROOM = 0.05
"""Additional clearance of the planner, meters, which RobotGoto needs."""

_DRIVE_EVERY, _PLAN_EVERY, _SCAN_EVERY = 2, 10, 2
"""Ticks between steps of RobotGoto, and of RobotPathPlanner; scans between two that the planner uses."""


_POINTS, _LAYER = "/camera/depth/points", "/mapper3d/layer"
MAPPING = Mapper3DSection(resolution=0.04, farthest=2.5, layer=LayerSection(height=1.3))
"""``resolution`` is less than half of the step of 10 cm in the plan `tables`. The standard deviation of the camera's
depth is less than ``resolution`` up to ``farthest``."""


class Ours:
    """All three parts, stepped like their modules.

    With a depth camera, RobotGoto receives the points of each image, and the planner uses the layer of a 3D map, which
    Mapper3D's code builds from the images and the poses while the robot drives; the map is empty at first.

    Args:
        robot: the robot.
        world: the floor, whose map they use.
        localized: whether poses come from the localizer; otherwise from the simulator.
        seed: seed of the localizer.
        start: initial pose estimate; None: the true pose.
        keep_out: whether RobotGoto knows the map's keep-out cells.
    """

    def __init__(
        self,
        robot: Robot,
        world: World,
        *,
        localized: bool = True,
        seed: int = 0,
        start: Pose | None = None,
        keep_out: bool = False,
    ) -> None:
        self._robot = robot
        described = robot.simulation.robot
        camera = robot.simulation.camera
        holonomic = described.kinematics != "differential"
        radius, limits = RADII[described.name], described.limits
        self.driver = Driver(
            RobotGotoSection(
                robot_is_holonomic=holonomic,
                robot_radius=radius,
                max_lin_speed=limits.linear,
                max_ang_speed=limits.angular,
                max_lin_acc=limits.linear_acceleration,
                max_ang_acc=limits.angular_acceleration,
                obstacles=() if camera is None else (ObstacleSection(topic=_POINTS, type="cloud"),),
            )
        )
        if keep_out:
            self.driver.keep_out.use(world.map)
        layers = () if camera is None else (ObstacleSection(topic=_LAYER),)
        self.planner = PathPlanner(RobotPathPlannerSection(robot_radius=radius + _ROOM, obstacles=layers))
        self.planner.use_map(Ground(world.map, radius + _ROOM, self.planner.settings.clearance))
        self.space = Space(MAPPING)
        self._pictured, self._layered = -1, -math.inf
        self.localizer: Localizer | None = None
        if localized:
            self.localizer = Localizer(world.map, LocalizerSection(holonomic=holonomic), seed)
            self.localizer.odometry(robot.odometry)
            self.localizer.initial(start or robot.truth)
        self._ticks = self._scans = 0
        self._scanned = -1
        self._silent = True

    # the planner's interface to the local navigator

    @property
    def state(self) -> State:
        return self.driver.status.state

    @property
    def reason(self) -> str:
        return self.driver.status.reason

    @property
    def fault(self) -> Fault:
        return Fault.parse(self.driver.status.fault)

    def send(self, pose: Pose, constraints: Constraints) -> None:
        self.driver.goal(pose, constraints)

    def cancel(self) -> None:
        self.driver.cancel()

    # the loop's interface

    def goal(self, pose: Pose, constraints: Constraints | None = None) -> None:
        """Start driving to a pose on the map."""
        self.planner.goal(pose, constraints=constraints, now=self._robot.now)

    def stop(self) -> None:
        """Cancel the goal."""
        self.planner.cancel()
        self.driver.cancel()

    def put_elsewhere(self) -> None:
        """Cancel the goal, and set the pose estimate to the true pose, after the robot was carried."""
        self.stop()
        self.driver.restart()
        if self.localizer is not None:
            self.localizer.initial(self._robot.truth)

    @property
    def status(self) -> tuple[State, str]:
        """Return the goal's state, and its reason."""
        return self.planner.status.state, self.planner.status.reason

    @property
    def pose(self) -> Pose | None:
        """Return the estimated pose, None if it is unknown."""
        return self._robot.truth if self.localizer is None else self.localizer.pose

    def step(self) -> None:
        """Process the sensor data of the last tick, and run the steps that are due."""
        robot, now = self._robot, self._robot.now
        if self.localizer is not None:
            self.localizer.odometry(robot.odometry)
        if robot.scan.time_ns != self._scanned:
            self._scanned = robot.scan.time_ns
            self._scan()
        if robot.simulation.pictured == robot.simulation.time_ns != self._pictured:
            self._pictured = robot.simulation.time_ns
            self._picture()
        drives, plans = self._ticks % _DRIVE_EVERY == 0, self._ticks % _PLAN_EVERY == 0
        self._ticks += 1
        if not drives:
            return
        pose, reason = self._known()
        if plans:
            self.planner.step(now, pose, self, reason)
        command = self.driver.step(now, pose, robot.odometry, reason)
        # RobotGoto's last command, which is zero, is sent in the first step after it has stopped
        if not (self._silent and self.driver.silent):
            robot.command(*command)
        self._silent = self.driver.silent

    def _scan(self) -> None:
        robot, scan = self._robot, self._robot.scan
        self.driver.scan(scan, robot.odometry)
        if self.localizer is not None:
            self.localizer.scan(scan.time_ns, scan_points(scan))
        pose = self.pose
        self._scans += 1
        if pose is not None and self._scans % _SCAN_EVERY == 0:
            self.planner.scan(robot.now, pose, scan)

    def _picture(self) -> None:
        """Pass the camera's points to RobotGoto, placed by odometry, and map them by the estimated pose."""
        simulation, now, at = self._robot.simulation, self._robot.now, self._robot.odometry
        camera = simulation.camera
        assert camera is not None
        points = camera.points(simulation.depth()).reshape(-1, 3)
        points = points[np.isfinite(points).all(axis=1)]
        turned, eye = camera.optical_frame(BasePose(at.x, at.y, at.theta))
        placed = points @ turned.T.astype(np.float32) + eye.astype(np.float32)
        self.driver.obstacles.cloud(_POINTS, now, placed, eye, at)
        pose, _ = self._known()
        if pose is None:
            return
        turned, eye = camera.optical_frame(BasePose(pose.x, pose.y, pose.theta))
        self.space.add(
            points, SensorPose(turned, tuple(eye)), FieldOfView(OPTICAL, Camera(*camera.size, *camera.lens).view), now
        )
        if now - self._layered >= MAPPING.layer.period:
            self._layered = now
            grid = grid_of(self.space.layer((pose.x, pose.y, 0.0)), "layer", MAPPING.resolution)
            self.planner.layer(_LAYER, grid.centers_of(np.argwhere(grid.occupancy == 100)[:, ::-1]))

    def _known(self) -> tuple[Pose | None, str]:
        """Return the pose for driving, or None with the reason."""
        if self.localizer is None:
            return self._robot.truth, ""
        status, reason = self.localizer.check(self._robot.simulation.time_ns)
        return (self.localizer.pose, "") if status is LocalizationStatus.OK else (None, reason)
