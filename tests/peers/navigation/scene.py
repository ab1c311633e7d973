"""The driver and a simulated robot, on one thread and on one clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from navigation.constraints import Constraints
from navigation.pose import Pose
from navigation.robot_goto.driver import Driver
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_goto.steering import DriveCommand
from navigation.status import State
from sim.base import BasePose, Twist
from sim.section import CameraSection, LaserSection, SimSection
from sim.simulation import Simulation

RADIUS = {"r1": 0.3, "ikart_v1": 0.4}


class Scene:
    """A simulated robot that the driver drives.

    Attributes:
        driver: the driver.
        sim: the simulation.
        touched: the number of contacts, summed over all ticks.
        states: the driver's states in order, with their reasons.
        commands: all commands, with their times.
        edit: changes a scan's ranges before the driver receives it; None drops the scan.
        known: whether the driver receives the robot's pose.
        depth: whether the points of a camera, if there is one, reach the driver as the source ``/points``.
        odometry: the pose of the map in the odometry frame.
    """

    def __init__(
        self, plan: str = "hall", robot: str = "r1", *, laser: str = "ideal", camera: bool = False, **settings: Any
    ) -> None:
        # a D435's image, reduced to a quarter in each direction
        eye = CameraSection(rate=5.0 if camera else 0.0, width=160, height=120, noise=0.02)
        section = SimSection(plan=plan, robot=robot, laser=LaserSection(kind=laser, noise=0.01), camera=eye)
        self.sim = Simulation(section)
        driven = RobotGotoSection(robot_is_holonomic=robot != "r1", robot_radius=RADIUS[robot])
        self.driver = Driver(driven.model_copy(update=settings))
        self.touched = 0
        self.states: list[tuple[State, str]] = []
        self.commands: list[tuple[float, DriveCommand]] = []
        self.edit: Callable[[np.ndarray], np.ndarray | None] = lambda ranges: ranges
        self.known = self.depth = True
        self._scanned = -1
        self.odometry = Pose(3.0, -2.0, 0.7)
        self._moved = Pose(0.0, 0.0, 0.0)
        self._fault = ""

    @property
    def now(self) -> float:
        return self.sim.time_ns / 1e9

    @property
    def pose(self) -> Pose:
        return Pose(*self.sim.base.pose())

    @property
    def speed(self) -> float:
        twist = self.sim.base.twist()
        return math.hypot(twist.x, twist.y)

    @property
    def reasons(self) -> str:
        return "; ".join(reason for _, reason in self.states)

    def tick(self) -> None:
        """Advance by 10 ms."""
        sim, pose = self.sim, self.pose
        if self._fault == "slipping wheels":
            command = self.driver.command
            self._moved = self._moved @ Pose(command.vx * 0.01, command.vy * 0.01, command.omega * 0.01)
        elif self._fault != "frozen odometry":
            self._moved = self.odometry @ pose
        moved = self._moved
        if sim.scan.time_ns != self._scanned:
            self._scanned = sim.scan.time_ns
            ranges = self.edit(sim.scan.ranges.copy())
            if ranges is not None:
                scan = type(sim.scan)(**{**vars(sim.scan), "ranges": ranges})
                self.driver.scan(scan, moved)
        if self.depth and sim.camera is not None and sim.pictured == sim.time_ns:
            turned, place = sim.camera.optical_frame(BasePose(*moved[:3]))
            points = sim.camera.points(sim.depth()).reshape(-1, 3)
            points = points[np.isfinite(points).all(axis=1)] @ turned.T + place
            self.driver.obstacles.cloud("/points", self.now, points.astype(np.float32), place, moved)
        command = self.driver.step(self.now, pose if self.known else None, moved, "" if self.known else "no localizer")
        self.commands.append((self.now, command))
        status = self.driver.status
        if not self.states or (status.state, status.reason) != self.states[-1]:
            self.states.append((status.state, status.reason))
        sim.command(Twist(*command))
        sim.tick()
        self.touched += len(sim.bumps)

    def fail(self, fault: str) -> None:
        """Set a fault: ``emergency stop``, ``slipping wheels`` or ``frozen odometry``; "" clears it."""
        self.sim.stop(on=fault in ("emergency stop", "slipping wheels"))
        self._fault = fault

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.tick()

    def until(self, done: Callable[[], bool], seconds: float) -> None:
        """Run until a condition holds, for at most ``seconds``."""
        end = self.now + seconds
        while not done():
            assert self.now < end, f"not in {seconds} s: {self.pose}, {self.driver.status}"
            self.tick()

    def goto(self, x: float, y: float, degrees: float = math.nan, seconds: float = 60.0, **constraints: Any) -> State:
        """Drive to a goal, and return the final state."""
        self.driver.goal(Pose(x, y, math.radians(degrees)), Constraints(**constraints))
        self.until(lambda: self.driver.status.state.ended, seconds)
        return self.driver.status.state
