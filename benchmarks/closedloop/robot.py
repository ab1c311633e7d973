"""A robot in the simulator, advanced tick by tick; BaseControl's core turns its commands into wheel speeds."""

from __future__ import annotations

import math
from typing import Literal

from bridge.messages.scan import LaserScan
from navigation.base_control.base import DrivenBase
from navigation.base_control.commands import Velocity
from navigation.base_control.section import BaseControlSection
from navigation.base_control.settings import resolved
from navigation.pose import Pose
from sim import robot as robots
from sim.base import TICK_NS
from sim.plan import Plan
from sim.robot import RobotDescription
from sim.section import CameraSection, EncodersSection, LaserSection, SimSection
from sim.simulation import Simulation

LASER = LaserSection(beams=720, rate=10.0, noise=0.005)
SCALES = (0.006, -0.004, 0.005)
"""Scale errors of the encoders, which turn the odometry by about 1.7 degrees per meter.

Drift measured in the apartment (r1, seed 0): 72 degrees and 6.1 m after 270 s and 44 m, 126 degrees after 390 s and
70 m.
"""

CAMERA = CameraSection(rate=5.0, width=160, height=120, noise=0.02)
"""A D435's image at a quarter of its width and height, so that its disparity noise of 0.08 pixels becomes 0.02."""

ENCODER_NOISE = 0.01
_INPUT = "ros"
_KINDS: dict[str, Literal["cer", "ikart_V1"]] = {"differential": "cer", "ikart_V1": "ikart_V1"}


class Robot:
    """A robot on a floor.

    Args:
        plan: one floor.
        base: the robot's name, or a file.
        seed: seed of all noise.
        start: x, y (meters), direction (degrees); None: the plan's start.
        camera: the settings of its depth camera; None if it has none.

    Attributes:
        simulation: the floor with the robot on it.
        odometry: pose estimate of BaseControl, in the odometry frame.
        driven: true driven distance, meters.
        commanded: speed of the last command, m/s.
    """

    def __init__(
        self,
        plan: Plan,
        base: str = "r1",
        *,
        seed: int = 0,
        start: tuple[float, float, float] | None = None,
        camera: CameraSection | None = None,
    ) -> None:
        description = robots.load(base)
        encoders = EncodersSection(scale=SCALES[: len(description.wheels.names)], noise=ENCODER_NOISE)
        section = SimSection(drive="wheels", laser=LASER, encoders=encoders, seed=seed, start=start)
        section = section.model_copy(update={"camera": camera}) if camera else section
        self.simulation = Simulation(section, plan, description)
        settings, _ = resolved(base_section(description))
        self._base = DrivenBase(settings)
        self._every = round(settings.period * 1e9 / TICK_NS)
        self._input = self._base.inputs[_INPUT]
        self._ticks = 0
        self.driven = self.commanded = 0.0
        self.odometry = Pose(0.0, 0.0, 0.0)
        self._measure()

    @property
    def radius(self) -> float:
        """Radius of the hull, meters."""
        return self.simulation.robot.body.radius

    @property
    def now(self) -> float:
        """The simulation's time, seconds."""
        return self.simulation.time_ns / 1e9

    @property
    def truth(self) -> Pose:
        """The true pose."""
        at = self.simulation.base.pose()
        return Pose(at.x, at.y, at.yaw, self.simulation.time_ns)

    @property
    def moving(self) -> float:
        """The true speed, m/s."""
        twist = self.simulation.base.twist()
        return math.hypot(twist.x, twist.y)

    @property
    def turning(self) -> float:
        """The true angular velocity, rad/s."""
        return self.simulation.base.twist().yaw

    @property
    def scan(self) -> LaserScan:
        """The laser's last scan."""
        return self.simulation.scan

    def command(self, x: float, y: float, turn: float) -> None:
        """Command a velocity as on ``/cmd_vel``, in m/s, m/s and rad/s."""
        self.commanded = math.hypot(x, y)
        self._input.command(Velocity(x, y, turn), self.now)

    def tick(self) -> None:
        """Advance by 10 ms."""
        if self._ticks % self._every == 0:
            self.simulation.wheels.motors.drive(self._base.step(self.now).tolist())
        before = self.simulation.base.pose()
        self.simulation.tick()
        self._ticks += 1
        after = self.simulation.base.pose()
        self.driven += math.hypot(after.x - before.x, after.y - before.y)
        self._measure()

    def _measure(self) -> None:
        encoders = self.simulation.wheels.motors.encoders()
        measured = self._base.measured(encoders.positions.tolist(), encoders.time_ns / 1e9)
        self.odometry = Pose(measured.x, measured.y, math.remainder(measured.theta, 2.0 * math.pi), encoders.time_ns)


def base_section(description: RobotDescription) -> BaseControlSection:
    """Return BaseControl's section for a robot of the simulator."""
    wheels, limits = description.wheels, description.limits
    return BaseControlSection(
        kind=_KINDS[description.kinematics],
        wheel_radius=wheels.radius,
        wheel_distance=wheels.separation,
        max_linear_vel=limits.linear,
        max_angular_vel=limits.angular,
        max_linear_acc=limits.linear_acceleration,
        max_angular_acc=limits.angular_acceleration,
        max_motor_vel=math.degrees(wheels.max_velocity),
    )
