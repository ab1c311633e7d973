"""The whole simulation, without a clock of its own: whoever holds it says how far it goes."""

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
from sim.sensors import Battery, Estimate, Faults, Odometry, Sensed
from sim.world import FloorWorld

TICK_NS = 10_000_000
"""Time passes by ticks: between them commands are constant."""

_STEPS = TICK_NS // STEP_NS
_LOOK_NS = 50_000_000


class Motors:
    """The wheels' motors: what BaseControl drives (in process; over the hub it is two topics)."""

    def __init__(self, names: tuple[str, ...], timeout: float) -> None:
        self.names = names  # of the wheels' joints, in the order of all velocities and positions
        self._timeout = round(timeout * 1e9)
        self._wanted = np.zeros(len(names))
        self._until = 0
        self.now = 0
        self._encoders = Encoders(0, np.zeros(len(names)), np.zeros(len(names)))

    def drive(self, velocities: Sequence[float]) -> None:
        """Turn the wheels so (radians per second) from now on; 0.1 s after the last call they stop.

        Raises `SimError` if not as many as there are wheels, or not finite.
        """
        wanted = np.asarray(velocities, float)
        if wanted.shape != (len(self.names),) or not np.isfinite(wanted).all():
            raise SimError(f"{list(velocities)} are no velocities for the wheels {', '.join(self.names)}")
        self._wanted, self._until = wanted, self.now + self._timeout

    def encoders(self) -> Encoders:
        """What the encoders said last."""
        return self._encoders

    def read(self, encoders: Encoders) -> None:
        """Take up what they say now."""
        self._encoders = encoders

    def wheels(self) -> np.ndarray:
        """What the motors are to do now."""
        return self._wanted if self.now < self._until else np.zeros(len(self.names))


class Simulation:
    """A robot on a floor.

    The same section and the same commands at the same times give the same run, bit for bit.

    Args:
        plan: the building, where it is not the section's.
        described: the robot, where it is not the section's.

    Raises:
        SimError: the plan, the robot or where it is to start is wrong; or dartpy is missing.
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
        """Begin anew, as at the start, at the time that it is."""
        section = self.section
        noise = np.random.default_rng(section.seed)
        encoder_noise, laser_noise = noise.spawn(2)
        self.camera = DepthCamera(section.camera, section.seed) if section.camera.rate else None
        self.pictured = -1  # when the camera took its last picture; only then it can be had
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
        self._sensed = Sensed(self.base, section.encoders, encoder_noise)
        self.odometry = Odometry(self.base)
        self._turn_ns = round(1e9 / section.laser.rate / TICK_NS) * TICK_NS or TICK_NS
        self._picture_ns = round(1e9 / (section.camera.rate or 1.0) / TICK_NS) * TICK_NS or TICK_NS
        self._begun = self.time_ns
        self._sense()
        self.scan = self._scan()

    def tick(self) -> None:
        """Let 10 ms pass."""
        seconds = TICK_NS / 1e9
        self.motors.now = self.time_ns
        wheels = self.drive.wheels(self.time_ns, seconds) if self.section.drive == "velocity" else self.motors.wheels()
        self.board.now_ns = self.time_ns
        boarded = self.board.wanted(seconds)
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
        if since % _LOOK_NS == 0:
            if self.world.people or not self.world.rests:
                self.world.look()
            self.battery.use(self.base.load(), _LOOK_NS / 1e9)
        rests = rested and self.world.rests
        if not rests:
            self.bumps = self.world.bumps()
        self._sense(rests=rests)
        if since % self._turn_ns == 0 and "laser_silent" not in self.faults:
            self.scan = self._scan()
        if self.camera is not None and since % self._picture_ns == 0 and "camera_silent" not in self.faults:
            self.pictured = self.time_ns

    def depth(self) -> Depths:
        """What the depth camera sees now, (height, width) metres: computed at the first call after a tick."""
        assert self.camera is not None
        if self._depth is None or self._depth[0] != self.time_ns:
            seen = self.camera.picture(self.time_ns, self.base.pose(), self.world.solids(), self.world.drops)
            if "camera_blind" in self.faults:
                seen[:] = math.nan
            self._depth = self.time_ns, seen
        return self._depth[1]

    def run(self, seconds: float) -> None:
        """Let so much time pass, in whole ticks."""
        for _ in range(round(seconds * 1e9 / TICK_NS)):
            self.tick()

    def command(self, twist: Twist) -> None:
        """Drive so until the time-out, where the simulator drives; raises `SimError` if it is not finite, or absurd."""
        self.drive.command(twist, self.time_ns)

    def stop(self, *, on: bool) -> None:
        """The emergency stop: while it is on, the wheels hold still whatever comes."""
        self.stopped = on
        self.drive.halt()
        self.board.halt()

    def teleport(self, to: BasePose) -> None:
        """Stand the robot elsewhere, unnoticed by its odometry; raises `SimError` if something stands there."""
        self.world.place(to)

    def ride(self, name: str) -> str:
        """Take a link from near one of its ends; the floor that it led to. Raises `SimError` if there is none near."""
        link = next((link for link in self.plan.links if link.name == name), None)
        if link is None:
            msg = f"there is no link {name!r}; links: {', '.join(link.name for link in self.plan.links) or 'none'}"
            raise SimError(msg)
        here = next((i for i, (floor, _) in enumerate(link.split) if floor == self.floor), None)
        at = self.base.pose()
        if here is not None:
            x, y, _ = self.world.floor.places[link.split[here][1]]
            if math.hypot(at.x - x, at.y - y) <= _LINK_REACH:
                floor, place = link.split[1 - here]
                self._enter(floor, pose(*self.plan.floors[floor].places[place]))
                return floor
        raise SimError(f"the robot is not within {_LINK_REACH:g} m of an end of the link {name!r}")

    def _enter(self, floor: str, at: BasePose) -> None:
        old = self.world
        old.leave()
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
            self.odometry.rest(self.time_ns)
        else:
            self.odometry.add(encoders)

    def _scan(self) -> Turn:
        seen = self.laser.scan(self.time_ns, self.base.pose(), *self.world.seen())
        return replace(seen, ranges=np.full_like(seen.ranges, math.nan)) if "laser_blind" in self.faults else seen

    @property
    def estimate(self) -> Estimate:
        """Odometry now."""
        return self.odometry.now


_LINK_REACH = 1.0


def pose(x: float, y: float, degrees: float) -> BasePose:
    """A pose as plans have it."""
    return BasePose(x, y, math.radians(degrees))


_ABSURD = 100.0  # a velocity greater than this, in metres or radians per second, is a mistake and not a wish


class VelocityDrive:
    """Turns velocity commands into wheel velocities, within the robot's limits, when the simulator drives by itself.

    No command outlives its time-out, and none is queued.
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
        """Drive so until the time-out; raises `SimError` if it is not finite, or absurd: the last command stays."""
        if not all(math.isfinite(v) and abs(v) <= _ABSURD for v in twist):
            raise SimError(f"the velocity {tuple(twist)} is refused: it is not finite, or greater than {_ABSURD:g}")
        angular = math.radians(self._limits.angular)
        x, y = twist.x, twist.y if self._lateral else 0.0
        speed = math.hypot(x, y)
        share = min(1.0, self._limits.linear / speed) if speed else 1.0
        self._wanted = np.array([x * share, y * share, min(angular, max(-angular, twist.yaw))])
        self._until = now_ns + round(self._limits.timeout * 1e9)

    def halt(self) -> None:
        """Forget what was wanted; the base brakes."""
        self._until = 0

    def wheels(self, now_ns: int, seconds: float) -> Floats:
        """The wheels' velocities for the next so many seconds, radians per second."""
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
