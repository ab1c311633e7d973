"""Descriptions of robot bases, read from files; several come with Midspan (``sim/robots``)."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, model_validator

from bridge.config.sections.section import Section
from sim.environment import SimError, checked, document, find

Triple = tuple[float, float, float]
Pair = tuple[float, float]

KINEMATICS = ("differential", "ikart_V1")


class Wheels(Section):
    """The driven wheels.

    A three-wheeled base (ikart_V1) has them at 150, 30 and -90 degrees, ``separation`` from its center.
    """

    names: tuple[str, ...] = Field(description="The joints' names, the left wheel first.")
    radius: float = Field(gt=0.01, le=1, description="Meters.")
    separation: float = Field(
        gt=0.01, le=3, description="Distance between the two wheels, meters; ikart_V1: from the center."
    )
    width: float = Field(default=0.03, gt=0, le=1, description="Width of a tire, meters.")
    mass: float = Field(default=3.0, gt=0, description="Mass of one wheel, kilograms.")
    inertia: Triple = Field(
        default=(0.02, 0.0376, 0.02), description="Inertia of one wheel about x, y (its axle) and z, kg m2."
    )
    damping: float = Field(default=0.5, ge=0, description="Damping of the joint, N m s/rad.")
    torque: float = Field(default=30.0, gt=0, description="Maximum torque of the motor, N m.")
    friction: float = Field(default=1.0, ge=0, description="Coulomb coefficient on the floor.")
    max_velocity: float = Field(
        default=6.28, gt=0, le=100, description="Maximum velocity of the joint, radians per second."
    )


class Part(Section):
    """A round part of the body above the hull."""

    radius: float = Field(gt=0.02, le=3, description="Meters.")
    low: float = Field(ge=0, description="Height of the part's lower end above the floor, meters.")
    high: float = Field(gt=0, le=10, description="Height of the part's upper end above the floor, meters.")

    @model_validator(mode="after")
    def _is_upright(self) -> Part:
        if self.low >= self.high:
            raise ValueError("low must be less than high")
        return self


class Body(Section):
    """The body on the wheels."""

    mass: float = Field(gt=0, description="Mass of the whole robot including its wheels, kilograms.")
    com: Triple = Field(default=(0.0, 0.0, 0.3), description="Center of mass without wheels, above the axle, meters.")
    inertia: Triple = Field(description="Inertia without wheels, about the center of mass, kg m2.")
    radius: float = Field(gt=0.02, le=3, description="Radius of the round hull that collides with walls, meters.")
    low: float = Field(default=0.05, ge=0, description="Height of the hull's lower end above the floor, meters.")
    high: float = Field(default=0.5, gt=0, description="Height of the hull's upper end above the floor, meters.")
    friction: float = Field(default=0.0, ge=0, description="Friction of the hull on walls.")
    upper: tuple[Part, ...] = Field(default=(), description="Parts above the hull, the lowest first.")

    @property
    def tall(self) -> float:
        """The height of the body's top above the floor, in meters."""
        return max([self.high, *(part.high for part in self.upper)])


class Casters(Section):
    """Passive wheels, as spheres without friction."""

    at: tuple[Pair, ...] = Field(default=(), description="Positions, meters from the axle's center.")
    radius: float = Field(default=0.02, gt=0, description="Meters.")
    gap: float = Field(default=0.0014, ge=0, description="Meters between casters and floor when the robot is level.")


class Belief(Section):
    """The wheel geometry that the odometry assumes."""

    radius: float = Field(gt=0, description="Meters.")
    separation: float = Field(gt=0, description="As for the wheels, meters.")


class Limits(Section):
    """Limits of the base's motion by ``/cmd_vel``, if the simulator itself drives the base."""

    linear: float = Field(default=0.3, gt=0, description="Meters per second.")
    angular: float = Field(default=30.0, gt=0, description="Degrees per second.")
    linear_acceleration: float = Field(default=0.3, gt=0, description="Meters per second squared.")
    angular_acceleration: float = Field(default=80.0, gt=0, description="Degrees per second squared.")
    timeout: float = Field(default=0.5, gt=0, le=0.5, description="Seconds after which a command expires.")


class Scanner(Section):
    """One laser on the robot."""

    at: Triple = Field(default=(0.0, 0.0, 0.0), description="x, y (meters) and direction (degrees) on the base.")
    blind: tuple[Pair, ...] = Field(
        default=(), description="Sectors without values: begin and end in degrees, exclusive."
    )


class Mount(Section):
    """The positions of the robot's own scanners."""

    height: float = Field(
        default=0.2, ge=0, description="Height of the scanners above the floor, meters; lower things are not seen."
    )
    scanners: tuple[Scanner, ...] = Field(default=(Scanner(),), description="The scanners, blended into one scan.")


class BatteryDescription(Section):
    """The battery."""

    capacity: float = Field(default=960.0, gt=0, description="Watt hours.")
    full: float = Field(default=54.6, gt=0, description="Volts when full.")
    empty: float = Field(default=42.0, gt=0, description="Volts when empty.")
    idle: float = Field(default=60.0, ge=0, description="The robot's power at rest, watts.")


class FrameNames(Section):
    """Frame names that differ between robots, for ``names: r1``."""

    base: str = Field(default="mobile_base_body_link", description="The base's own frame.")
    laser: str = Field(default="mobile_base_double_lidar", description="The laser's own frame.")


class RobotDescription(Section):
    """A base."""

    name: str = Field(description="The robot's name.")
    kinematics: str = Field(description="differential or ikart_V1.")
    wheels: Wheels
    body: Body
    casters: Casters = Casters()
    belief: Belief | None = Field(
        default=None, description="The assumed wheel geometry, if it differs from the wheels."
    )
    motor_timeout: float = Field(
        default=0.1, gt=0, le=0.5, description="Seconds after the last command until the wheels stop."
    )
    limits: Limits = Limits()
    lasers: Mount = Mount()
    battery: BatteryDescription = BatteryDescription()
    frames: FrameNames = FrameNames()

    @property
    def believed(self) -> Belief:
        """The wheel geometry that the odometry assumes."""
        return self.belief or Belief(radius=self.wheels.radius, separation=self.wheels.separation)

    @model_validator(mode="after")
    def _fits(self) -> RobotDescription:
        if self.kinematics not in KINEMATICS:
            msg = f"kinematics {self.kinematics!r} are not supported; supported: {', '.join(KINEMATICS)}"
            raise ValueError(msg)
        count = 2 if self.kinematics == "differential" else 3
        if len(self.wheels.names) != count:
            raise ValueError(f"{self.kinematics} has {count} wheels, not {len(self.wheels.names)}")
        if self.body.mass <= count * self.wheels.mass:
            raise ValueError("the robot's mass must be greater than that of its wheels")
        return self


def load(name: str | Path) -> RobotDescription:
    """Load a robot that comes with Midspan, or a file; raises `SimError` if the name is unknown or the file invalid."""
    robot = checked(document(find("robots", name)), RobotDescription)
    if robot.body.low >= robot.body.high:
        raise SimError(f"{name}: body.low must be less than body.high")
    return robot
