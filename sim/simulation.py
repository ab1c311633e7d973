"""The simulation, without its own clock: the caller advances its time."""

from __future__ import annotations

import math

from bridge.messages.scan import LaserScan
from sim import robot
from sim.base import STEP_NS, TICK_NS, Base, BasePose, Differential, Holonomic, Twist
from sim.depth import DepthCamera, Depths
from sim.environment import SimError
from sim.fitting import wrong_scale, wrong_start
from sim.plan import Plan, load_plan
from sim.section import SimSection
from sim.sensing import Sensing
from sim.sensors import Battery, Estimate, Faults
from sim.wheels import WheelControls
from sim.world import FloorWorld

_STEPS = TICK_NS // STEP_NS
_UPDATE_NS = 50_000_000  # time between two updates of the battery, and of which things are near


class Simulation:
    """A robot on a floor.

    Two runs with the same section, and the same commands at the same times, are identical bit for bit.

    Args:
        plan: the building, instead of the one that the section names.
        description: the robot, instead of the one that the section names.

    Raises:
        SimError: the plan, the robot or its start pose is invalid, or dartpy is missing.
    """

    def __init__(
        self, section: SimSection, plan: Plan | None = None, description: robot.RobotDescription | None = None
    ) -> None:
        self.section = section
        whole = plan or load_plan(section.plan, section.resolution)
        self.plan = whole if section.people else whole.without_people
        self.robot = description or robot.load(section.robot)
        if reason := wrong_scale(section.encoders.scale, self.robot):
            raise SimError(f"sim.encoders.scale {reason}")
        if reason := wrong_start(section.start, self.plan, self.robot, people=section.people):
            raise SimError(f"the start pose: {reason}")
        self.time_ns = 0
        self.begin()

    def begin(self) -> None:
        """Reset the simulation to its start; the time continues."""
        section = self.section
        self.base: Base = (Differential if self.robot.kinematics == "differential" else Holonomic)(self.robot)
        self.floor = self.plan.first
        self.world = FloorWorld(self.plan.floors[self.floor], self.base, self.robot.lasers.height)
        self.world.place(pose(*(section.start or self.world.floor.start)))
        self.wheels = WheelControls(self.base, self.time_ns, velocity=section.drive == "velocity")
        self.battery = Battery(self.robot.battery)
        self.bumps: list[tuple[float, float]] = []
        self._begun = self.time_ns
        self.sensing = Sensing(section, self.robot, self.base, self.world, self.time_ns)
        self.wheels.read(self.sensing.read(self.time_ns))

    def tick(self) -> None:
        """Advance by 10 ms."""
        seconds = TICK_NS / 1e9
        aims = self.wheels.targets(self.time_ns, seconds)
        still = not any(aims)
        if not (still and self.world.rests):
            self.base.turn(aims)
        self.world.walk(seconds)
        rested = self.world.rests
        self.world.step(_STEPS, aims_still=still)
        self.time_ns += TICK_NS
        if (self.time_ns - self._begun) % _UPDATE_NS == 0:
            if self.world.people or not self.world.rests:
                self.world.update_near()
            self.battery.use(self.base.load(), _UPDATE_NS / 1e9)
        rests = rested and self.world.rests
        if not rests:
            self.bumps = self.world.bumps()
        self.wheels.read(self.sensing.read(self.time_ns, rests=rests))
        self.sensing.observe(self.world, self.time_ns)

    # sensors

    @property
    def estimate(self) -> Estimate:
        """The current odometry."""
        return self.sensing.odometry.now

    @property
    def scan(self) -> LaserScan:
        """The last scan."""
        return self.sensing.scan

    @property
    def camera(self) -> DepthCamera | None:
        return self.sensing.camera

    @property
    def pictured(self) -> int:
        """When the camera took its last picture, ns; `depth` can compute only the picture of the current time."""
        return self.sensing.pictured

    @property
    def faults(self) -> Faults:
        return self.sensing.faults

    def depth(self) -> Depths:
        """Return the depth camera's current picture, (height, width) meters; the first call in a tick computes it."""
        return self.sensing.depth(self.world, self.time_ns)

    # commands

    def run(self, seconds: float) -> None:
        """Advance by a number of seconds, in whole ticks."""
        for _ in range(round(seconds * 1e9 / TICK_NS)):
            self.tick()

    def command(self, twist: Twist) -> None:
        """Set the velocity until the time-out, if the simulator drives; raises `SimError` if it is invalid."""
        self.wheels.drive.command(twist, self.time_ns)

    def stop(self, *, on: bool) -> None:
        """Switch the emergency stop, which cancels all commands and holds the wheels while it is on."""
        self.wheels.stopped = on
        self.wheels.halt()

    def teleport(self, to: BasePose) -> None:
        """Move the robot without changing its odometry; raises `SimError` if the place is occupied."""
        self.world.place(to)

    def ride(self, name: str) -> str:
        """Use a link whose end is near the robot, and return the new floor.

        Raises `SimError` if the link is unknown, neither end is near the robot, or the other end is occupied.
        """
        link = next((link for link in self.plan.links if link.name == name), None)
        if link is None:
            msg = f"unknown link {name!r}; links: {', '.join(link.name for link in self.plan.links) or 'none'}"
            raise SimError(msg)
        near_end = next((i for i, (floor, _) in enumerate(link.split) if floor == self.floor), None)
        robot_pose = self.base.pose()
        if near_end is not None:
            x, y, _ = self.world.floor.places[link.split[near_end][1]]
            if math.hypot(robot_pose.x - x, robot_pose.y - y) <= _LINK_REACH:
                floor, place = link.split[1 - near_end]
                self._enter(floor, pose(*self.plan.floors[floor].places[place]))
                return floor
        raise SimError(f"the robot is not within {_LINK_REACH:g} m of an end of the link {name!r}")

    def _enter(self, floor: str, at: BasePose) -> None:
        old = self.world
        old.release_base()
        world = FloorWorld(self.plan.floors[floor], self.base, self.robot.lasers.height)
        try:
            world.place(at)
        except SimError:
            world.release_base()
            old.take_base()
            raise
        self.world, self.floor = world, floor


_LINK_REACH = 1.0  # maximum distance from the end of a link, meters


def pose(x: float, y: float, degrees: float) -> BasePose:
    """Convert a pose of a plan, with the direction in degrees, to a base's pose."""
    return BasePose(x, y, math.radians(degrees))
