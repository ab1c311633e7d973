"""What a robot's base is: read from a file, several of which come with Midspan (``sim/robots``)."""

from __future__ import annotations

from pydantic import Field, model_validator

from bridge.config.sections.section import Section
from sim.environment import SimError, checked, document, find

Triple = tuple[float, float, float]
Pair = tuple[float, float]

KINEMATICS = ("differential", "ikart_V1")


class Wheels(Section):
    """The driven wheels.

    Those of a three-wheeled base (ikart_V1) stand at 150, 30 and -90 degrees, ``separation`` from its centre.
    """

    names: tuple[str, ...] = Field(description="The joints' names, the left wheel first.")
    radius: float = Field(gt=0.01, le=1, description="Metres.")
    separation: float = Field(gt=0.01, le=3, description="Between the two wheels, metres; ikart_V1: from the centre.")
    width: float = Field(default=0.03, gt=0, le=1, description="Of a tyre, metres.")
    mass: float = Field(default=3.0, gt=0, description="Of one, kilograms.")
    inertia: Triple = Field(default=(0.02, 0.0376, 0.02), description="Of one, about x, y (its axle) and z, kg m2.")
    damping: float = Field(default=0.5, ge=0, description="Of the joint, N m s/rad.")
    torque: float = Field(default=30.0, gt=0, description="The motor's greatest, N m.")
    friction: float = Field(default=1.0, ge=0, description="Coulomb's coefficient on the floor.")
    max_velocity: float = Field(default=6.28, gt=0, le=100, description="Of the joint, radians per second.")


class Part(Section):
    """A round part of the body above the hull."""

    radius: float = Field(gt=0.02, le=3, description="Metres.")
    low: float = Field(ge=0, description="Where it begins above the floor, metres.")
    high: float = Field(gt=0, le=10, description="Where it ends, metres.")

    @model_validator(mode="after")
    def _is_upright(self) -> Part:
        if self.low >= self.high:
            raise ValueError("low must be less than high")
        return self


class Body(Section):
    """What stands on the wheels."""

    mass: float = Field(gt=0, description="Of the whole robot with its wheels, kilograms.")
    com: Triple = Field(default=(0.0, 0.0, 0.3), description="Centre of mass without wheels, above the axle, metres.")
    inertia: Triple = Field(description="Without wheels, about the centre of mass, kg m2.")
    radius: float = Field(gt=0.02, le=3, description="Of the round hull that meets walls, metres.")
    low: float = Field(default=0.05, ge=0, description="Where the hull begins above the floor, metres.")
    high: float = Field(default=0.5, gt=0, description="Where it ends, metres.")
    friction: float = Field(default=0.0, ge=0, description="Of the hull on walls.")
    upper: tuple[Part, ...] = Field(default=(), description="What stands on the hull, from below.")

    @property
    def tall(self) -> float:
        """Metres from the floor to its top."""
        return max([self.high, *(part.high for part in self.upper)])


class Casters(Section):
    """Passive wheels, as spheres without friction."""

    at: tuple[Pair, ...] = Field(default=(), description="Where they stand, metres from the axle's centre.")
    radius: float = Field(default=0.02, gt=0, description="Metres.")
    gap: float = Field(default=0.0014, ge=0, description="Between them and the floor when the robot stands level.")


class Belief(Section):
    """What the odometry believes of the wheels."""

    radius: float = Field(gt=0, description="Metres.")
    separation: float = Field(gt=0, description="As that of the wheels, metres.")


class Limits(Section):
    """How the base obeys ``/cmd_vel`` where the simulator itself drives it."""

    linear: float = Field(default=0.3, gt=0, description="Metres per second.")
    angular: float = Field(default=30.0, gt=0, description="Degrees per second.")
    linear_acceleration: float = Field(default=0.3, gt=0, description="Metres per second squared.")
    angular_acceleration: float = Field(default=80.0, gt=0, description="Degrees per second squared.")
    timeout: float = Field(default=0.5, gt=0, le=0.5, description="Seconds after which a silent commander means zero.")


class Scanner(Section):
    """One laser on the robot."""

    at: Triple = Field(default=(0.0, 0.0, 0.0), description="x, y (metres) and direction (degrees) on the base.")
    blind: tuple[Pair, ...] = Field(default=(), description="Sectors without values, degrees from and to, open ends.")


class Mount(Section):
    """Where the robot's own scanners are."""

    height: float = Field(default=0.2, ge=0, description="Above the floor, metres: what is lower is not seen.")
    scanners: tuple[Scanner, ...] = Field(default=(Scanner(),), description="They are blended into one.")


class BatteryDescription(Section):
    """The battery."""

    capacity: float = Field(default=960.0, gt=0, description="Watt hours.")
    full: float = Field(default=54.6, gt=0, description="Volts when full.")
    empty: float = Field(default=42.0, gt=0, description="Volts when empty.")
    idle: float = Field(default=60.0, ge=0, description="What the robot takes at rest, watts.")


class FrameNames(Section):
    """Names that differ between robots, for ``names: r1``."""

    base: str = Field(default="mobile_base_body_link", description="The base's own frame.")
    laser: str = Field(default="mobile_base_double_lidar", description="The laser's own frame.")


class RobotDescription(Section):
    """A base."""

    name: str = Field(description="The robot's name.")
    kinematics: str = Field(description="differential or ikart_V1.")
    wheels: Wheels
    body: Body
    casters: Casters = Casters()
    belief: Belief | None = Field(default=None, description="Where it differs from the wheels.")
    motor_timeout: float = Field(default=0.1, gt=0, le=0.5, description="Wheels stop so many seconds after silence.")
    limits: Limits = Limits()
    lasers: Mount = Mount()
    battery: BatteryDescription = BatteryDescription()
    frames: FrameNames = FrameNames()

    @property
    def believed(self) -> Belief:
        """The wheels as the odometry believes them to be."""
        return self.belief or Belief(radius=self.wheels.radius, separation=self.wheels.separation)

    @model_validator(mode="after")
    def _fits(self) -> RobotDescription:
        if self.kinematics not in KINEMATICS:
            msg = f"kinematics {self.kinematics!r} are not written yet; there are {' and '.join(KINEMATICS)}"
            raise ValueError(msg)
        count = 2 if self.kinematics == "differential" else 3
        if len(self.wheels.names) != count:
            raise ValueError(f"{self.kinematics} has {count} wheels, not {len(self.wheels.names)}")
        if self.body.mass <= count * self.wheels.mass:
            raise ValueError("the robot's mass is not more than that of its wheels")
        return self


def load(name: str) -> RobotDescription:
    """A robot that comes with Midspan, or one's own file; raises `SimError` if there is none, or the file is wrong."""
    robot = checked(document(find("robots", name)), RobotDescription)
    if robot.body.low >= robot.body.high:
        raise SimError(f"{name}: body.low must be less than body.high")
    return robot
