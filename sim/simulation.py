"""The simulation, without its own clock: the caller advances its time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bridge.config.sections.sim import SimSection
from bridge.messages.scan import Turn
from sim import robot
from sim.base import STEP_NS, Base, BasePose, Differential, Encoders, Floats, Holonomic, Twist
from sim.board import WheelCommands
from sim.depth import DepthCamera, Depths
from sim.environment import SimError
from sim.laser import Laser
from sim.plan import Plan, load_plan
from sim.sensors import Battery, Estimate, Faults, Odometry, WheelEncoders
from sim.world import FloorWorld

TICK_NS = 10_000_000
"""Duration of a tick, the step in which time advances; during a tick commands are constant."""

_STEPS = TICK_NS // STEP_NS
_UPDATE_NS = 50_000_000


class Motors:
    """The wheels' motors, which BaseControl drives: by these methods in one process, by two topics over the hub."""

    def __init__(self, names: tuple[str, ...], timeout: float) -> None:
        self.names = names  # of the wheels' joints, in the order of all velocities and positions
        self._timeout = round(timeout * 1e9)
        self._wanted = np.zeros(len(names))
        self._until = 0
        self.now = 0
        self._encoders = Encoders(0, np.zeros(len(names)), np.zeros(len(names)))

    def drive(self, velocities: Sequence[float]) -> None:
        """Set the wheels' velocities (radians per second); the wheels stop after the motors' time-out.

        Raises `SimError` if there is not one finite velocity per wheel.
        """
        wanted = np.asarray(velocities, float)
        if wanted.shape != (len(self.names),) or not np.isfinite(wanted).all():
            raise SimError(f"invalid velocities {list(velocities)} for the wheels {', '.join(self.names)}")
        self._wanted, self._until = wanted, self.now + self._timeout

    def encoders(self) -> Encoders:
        """Return the last reading of the encoders."""
        return self._encoders

    def read(self, encoders: Encoders) -> None:
        """Store a reading of the encoders."""
        self._encoders = encoders

    def wheels(self) -> np.ndarray:
        """Return the current target velocities."""
        return self._wanted if self.now < self._until else np.zeros(len(self.names))


class Simulation:
    """A robot on a floor.

    Runs with the same section, and the same commands at the same times, are identical bit for bit.

    Args:
        plan: the building, instead of the section's.
        described: the robot, instead of the section's.

    Raises:
        SimError: the plan, the robot or its start pose is invalid, or dartpy is missing.
    """

    def __init__(
        self, section: SimSection, plan: Plan | None = None, described: robot.RobotDescription | None = None
    ) -> None:
        self.section = section
        whole = plan or load_plan(section.plan, section.resolution)
        self.plan = whole if section.people else whole.without_people
        self.robot = described or robot.load(section.robot)
        self.time_ns = 0
        self.begin()

    def begin(self) -> None:
        """Reset the simulation to its start; the time continues."""
        section = self.section
        noise = np.random.default_rng(section.seed)
        encoder_noise, laser_noise = noise.spawn(2)
        self.camera = DepthCamera(section.camera, section.seed) if section.camera.rate else None
        self.pictured = -1  # when the camera took its last picture; `depth` computes only the current one
        self.base: Base = (Differential if self.robot.kinematics == "differential" else Holonomic)(self.robot)
        self.floor = self.plan.first
        self.world = FloorWorld(self.plan.floors[self.floor], self.base, self.robot.lasers.height)
        self.world.place(pose(*(section.start or self.world.floor.start)))
        self.laser = Laser(section.laser, self.robot.lasers, laser_noise)
        self.motors = Motors(self.base.names, self.robot.motor_timeout)
        self.drive = VelocityDrive(self.base)
        self.board = WheelCommands(self.base, self.time_ns)
        self.battery = Battery(self.robot.battery)
        self.stopped = False
        self.faults = Faults()
        self.bumps: list[tuple[float, float]] = []
        self._depth: tuple[int, Depths] | None = None
        self._sensed = WheelEncoders(self.base, section.encoders, encoder_noise)
        self.odometry = Odometry(self.base)
        self._turn_ns = round(1e9 / section.laser.rate / TICK_NS) * TICK_NS or TICK_NS
        self._picture_ns = round(1e9 / (section.camera.rate or 1.0) / TICK_NS) * TICK_NS or TICK_NS
        self._begun = self.time_ns
        self._sense()
        self.scan = self._scan()

    def tick(self) -> None:
        """Advance by 10 ms."""
        seconds = TICK_NS / 1e9
        self.motors.now = self.time_ns
        wheels = self.drive.wheels(self.time_ns, seconds) if self.section.drive == "velocity" else self.motors.wheels()
        self.board.now_ns = self.time_ns
        boarded = self.board.next_velocities(seconds)
        if boarded is not None:
            wheels = boarded
        aims = [0.0] * len(wheels) if self.stopped else wheels.tolist()
        still = not any(aims)
        if not (still and self.world.rests):
            self.base.turn(aims)
        self.world.walk(seconds)
        rested = self.world.rests
        self.world.step(_STEPS, aims_still=still)
        self.time_ns += TICK_NS
        since = self.time_ns - self._begun
        if since % _UPDATE_NS == 0:
            if self.world.people or not self.world.rests:
                self.world.update_near()
            self.battery.use(self.base.load(), _UPDATE_NS / 1e9)
        rests = rested and self.world.rests
        if not rests:
            self.bumps = self.world.bumps()
        self._sense(rests=rests)
        if since % self._turn_ns == 0 and "laser_silent" not in self.faults:
            self.scan = self._scan()
        if self.camera is not None and since % self._picture_ns == 0 and "camera_silent" not in self.faults:
            self.pictured = self.time_ns

    def depth(self) -> Depths:
        """Return the depth camera's current picture, (height, width) meters; computed once per tick, on demand."""
        assert self.camera is not None
        if self._depth is None or self._depth[0] != self.time_ns:
            seen = self.camera.picture(self.time_ns, self.base.pose(), self.world.solids(), self.world.drops)
            if "camera_blind" in self.faults:
                seen[:] = math.nan
            self._depth = self.time_ns, seen
        return self._depth[1]

    def run(self, seconds: float) -> None:
        """Advance by a number of seconds, in whole ticks."""
        for _ in range(round(seconds * 1e9 / TICK_NS)):
            self.tick()

    def command(self, twist: Twist) -> None:
        """Set the velocity until the time-out, if the simulator drives; raises `SimError` if it is invalid."""
        self.drive.command(twist, self.time_ns)

    def stop(self, *, on: bool) -> None:
        """Switch the emergency stop, which cancels all commands and holds the wheels while it is on."""
        self.stopped = on
        self.drive.halt()
        self.board.halt()

    def teleport(self, to: BasePose) -> None:
        """Move the robot without its odometry; raises `SimError` if the place is occupied."""
        self.world.place(to)

    def ride(self, name: str) -> str:
        """Use a link from near one of its ends, and return the new floor; raises `SimError` if no end is near."""
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
        self.world = FloorWorld(self.plan.floors[floor], self.base, self.robot.lasers.height)
        self.floor = floor
        self.world.place(at)

    def _sense(self, *, rests: bool = False) -> None:
        self._sensed.frozen = "encoders_frozen" in self.faults
        before, encoders = self.motors.encoders(), self._sensed.read(self.time_ns, rests=rests)
        self.motors.now = self.time_ns
        self.motors.read(encoders)
        self.board.read(encoders)
        if encoders.positions is before.positions and encoders.velocities is before.velocities:
            self.odometry.repeat(self.time_ns)
        else:
            self.odometry.add(encoders)

    def _scan(self) -> Turn:
        seen = self.laser.scan(self.time_ns, self.base.pose(), *self.world.seen())
        return replace(seen, ranges=np.full_like(seen.ranges, math.nan)) if "laser_blind" in self.faults else seen

    @property
    def estimate(self) -> Estimate:
        """The current odometry."""
        return self.odometry.now


_LINK_REACH = 1.0


def pose(x: float, y: float, degrees: float) -> BasePose:
    """Return a pose of a plan, whose direction is in degrees."""
    return BasePose(x, y, math.radians(degrees))


_ABSURD = 100.0  # greater velocities (meters or radians per second) are rejected as mistakes


class VelocityDrive:
    """Converts velocity commands to wheel velocities within the robot's limits, if the simulator itself drives.

    Each command replaces the one before it, and expires after the time-out.
    """

    def __init__(self, base: Base) -> None:
        self._limits = base.robot.limits
        believed = base.robot.believed
        self._matrix = base.matrix(believed.radius, believed.separation)
        self._greatest = base.robot.wheels.max_velocity
        self._lateral = base.robot.kinematics != "differential"
        self._wanted = np.zeros(3)
        self._until = 0
        self._now = np.zeros(3)

    def command(self, twist: Twist, now_ns: int) -> None:
        """Set the velocity until the time-out; raises `SimError` if it is invalid, and keeps the last command."""
        if not all(math.isfinite(v) and abs(v) <= _ABSURD for v in twist):
            raise SimError(f"velocity {tuple(twist)} rejected: not finite, or greater than {_ABSURD:g}")
        angular = math.radians(self._limits.angular)
        x, y = twist.x, twist.y if self._lateral else 0.0
        speed = math.hypot(x, y)
        share = min(1.0, self._limits.linear / speed) if speed else 1.0
        self._wanted = np.array([x * share, y * share, min(angular, max(-angular, twist.yaw))])
        self._until = now_ns + round(self._limits.timeout * 1e9)

    def halt(self) -> None:
        """Cancel the command; the base brakes."""
        self._until = 0

    def wheels(self, now_ns: int, seconds: float) -> Floats:
        """Return wheel velocities (radians per second) for the next seconds."""
        wanted = self._wanted if now_ns < self._until else np.zeros(3)
        linear = self._limits.linear_acceleration * seconds
        change = wanted - self._now
        along = math.hypot(change[0], change[1])
        if along > linear:
            change[:2] *= linear / along
        angular = math.radians(self._limits.angular_acceleration) * seconds
        change[2] = min(angular, max(-angular, change[2]))
        self._now = self._now + change
        wheels: Floats = self._matrix @ self._now
        fastest = float(np.abs(wheels).max())
        return wheels * (self._greatest / fastest) if fastest > self._greatest else wheels
