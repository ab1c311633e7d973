"""Maps and a local navigator for tests of the planner, all on one thread and on one clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bridge.messages.scan import LaserScan
from navigation.constraints import Constraints
from navigation.pose import Pose, wrapped
from navigation.robot_path_planner.atlas import Atlas
from navigation.robot_path_planner.ground import Ground, Zone
from navigation.robot_path_planner.planner import PathPlanner
from navigation.robot_path_planner.section import RobotPathPlannerSection
from navigation.status import Fault, PlannerStatus, State
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D

RES = 0.05
TICK = 0.1
SPEED = 0.5
TURN = 0.5
ROOM = 0.2
"""Distance that the robot keeps from crates, meters."""
SETTINGS = RobotPathPlannerSection(robot_radius=0.2, clearance=0.1)
WEST, EAST = Pose(1.0, 1.0, 0.0), Pose(4.0, 1.0, 1.0)
KEPT = 0.14
"""Minimum distance of the robot's center from obstacles, meters. It is below the radius of 0.2 m, because waypoints are
passed within 0.1 m, which cuts corners by about 0.05 m."""
LOW_DOOR = (2.5, 1.0, 0.5)


def floor(*boxes: tuple[float, float, float, float], name: str = "floor", size: float = 5.0) -> MapGrid2D:
    """Return a square floor with outer walls, and wall boxes (left, bottom, right, top) in meters."""
    cells = round(size / RES)
    flags = np.zeros((cells, cells), np.uint8)
    flags[[0, -1]] = flags[:, [0, -1]] = MapFlag.WALL
    grid = MapGrid2D.of(flags, name=name, resolution=RES)
    for box in boxes:
        paint(grid, box)
    return grid


def paint(grid: MapGrid2D, box: tuple[float, float, float, float], flag: MapFlag = MapFlag.WALL) -> None:
    left, bottom, right, top = (round(edge / RES) for edge in box)
    rows = slice(grid.m_height - top, grid.m_height - bottom)
    grid.flags[rows, left:right] = flag
    grid.occupancy[rows, left:right] = 100 if flag is MapFlag.WALL else 0


ROOMS = ((2.4, 0.0, 2.6, 0.6), (2.4, 1.4, 2.6, 3.6), (2.4, 4.4, 2.6, 5.0))
"""A wall across the floor, with doors of 0.8 m centered at y = 1 and y = 4."""


class Straight:
    """A local navigator that drives straight to its goal, and is stopped by crates."""

    def __init__(self, pose: Pose) -> None:
        self.pose = pose
        self.state, self.reason, self.fault = State.IDLE, "", Fault.NONE
        self.sent: list[tuple[Pose, Constraints]] = []
        self.crates: list[tuple[float, float, float]] = []
        self.patience = 5.0
        self._waits = 0.0
        self.canceled = 0

    def send(self, pose: Pose, constraints: Constraints) -> None:
        self.sent.append((pose, constraints))
        if self.state is not State.ERROR:
            self.state, self.reason, self._waits = State.PREPARING, "", 0.0

    def cancel(self) -> None:
        self.canceled += 1
        if self.state is not State.ERROR:
            self.state = State.IDLE

    def tick(self) -> None:
        if self.state not in (State.PREPARING, State.MOVING, State.WAITING):
            return
        goal, constraints = self.sent[-1]
        away = self.pose.distance(goal)
        if away <= 0.03:
            turn = wrapped(goal.theta - self.pose.theta) if constraints.heading else 0.0
            self.pose = Pose(goal.x, goal.y, self.pose.theta + min(TURN, max(-TURN, turn)))
            if abs(turn) <= TURN:
                self.state = State.REACHED
            return
        step = min(min(SPEED, constraints.max_lin_speed or SPEED) * TICK, away)
        x, y = (start + (end - start) * step / away for start, end in zip(self.pose[:2], goal[:2], strict=True))
        nearer = [crate for crate in self.crates if math.dist((x, y), crate[:2]) < self.pose.distance(Pose(*crate))]
        if any(math.dist((x, y), crate[:2]) < crate[2] + ROOM for crate in nearer):
            self._waits += TICK
            self.state, self.reason = State.WAITING, "obstacles are detected"
            if self._waits > self.patience:
                self.state, self.reason = State.FAILING, "the obstacle did not go away"
            return
        self.state = State.MOVING
        turn = wrapped(math.atan2(goal.y - self.pose.y, goal.x - self.pose.x) - self.pose.theta)
        self.pose = Pose(x, y, self.pose.theta + min(TURN, max(-TURN, turn)))


class Drive:
    """A planner, a local navigator and a clock."""

    def __init__(
        self,
        grid: MapGrid2D | None,
        start: Pose,
        settings: RobotPathPlannerSection = SETTINGS,
        zones: Sequence[Zone] = (),
        atlas: Atlas | None = None,
    ) -> None:
        self.settings, self.zones = settings, zones
        self.planner = PathPlanner(settings, atlas)
        if grid is not None:
            self.use(grid)
        self.local = Straight(start)
        self.now = 0.0
        self.track: list[Pose] = []
        self.statuses: list[PlannerStatus] = []
        self.lost = ""
        self.laser = False

    def use(self, grid: MapGrid2D) -> None:
        self.planner.use_map(Ground(grid, self.settings.robot_radius, self.settings.clearance, self.zones))

    def tick(self) -> PlannerStatus:
        self.now += TICK
        self.local.tick()
        if self.laser:
            self.scan_crates()
        status = self.planner.step(self.now, None if self.lost else self.local.pose, self.local, self.lost)
        self.track.append(self.local.pose)
        if not self.statuses or status != self.statuses[-1]:
            self.statuses.append(status)
        return status

    def scan_crates(self) -> None:
        """Scan with a laser at the robot's center, which sees crates up to 8 m away, but no walls."""
        pose, beams = self.local.pose, 720
        angles = np.arange(beams) * math.tau / beams
        ranges = np.full(beams, np.inf)
        for x, y, radius in self.local.crates:
            dx, dy = x - pose.x, y - pose.y
            along = np.cos(angles) * dx + np.sin(angles) * dy
            across = dx * dx + dy * dy - along * along
            hit = (along > 0) & (across < radius * radius)
            ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(radius * radius - across[hit]))
        turn = LaserScan(round(self.now * 1e9), 0.0, math.tau / beams, 0.05, 8.0, ranges)
        self.planner.scan(self.now, Pose(pose.x, pose.y, 0.0), turn)

    def goto(self, goal: Pose, seconds: float = 120.0, map_name: str = "") -> PlannerStatus:
        """Send a goal, and run until the planner has ended it or ``seconds`` have passed; return the last status."""
        self.planner.goal(goal, map_name, now=self.now)
        return self.run(seconds)

    def run(self, seconds: float) -> PlannerStatus:
        end = self.now + seconds
        status = self.tick()
        while self.planner.active and self.now < end:
            status = self.tick()
        return status

    def until(self, state: State, seconds: float = 60.0) -> PlannerStatus:
        end = self.now + seconds
        while self.now < end:
            status = self.tick()
            if status.state is state:
                return status
        raise AssertionError(f"not {state}: {self.statuses}")


def least_room(drive: Drive, grid: MapGrid2D) -> float:
    """Return the smallest distance between the robot's track and an obstacle, in meters."""
    ground = Ground(grid, 0.2, zones=drive.zones)
    columns, rows = grid.cells_at([pose[:2] for pose in drive.track]).T
    return float(ground.room[rows, columns].min())
