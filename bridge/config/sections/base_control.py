"""The section ``modules.base_control``: the driver of a mobile base."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator

from bridge.config.sections.module import ModuleSection
from bridge.config.sections.section import Section

DEGREES = "degrees per second"
_PORTS = r"^(/[^\s/\"'*()\[\]{}]+)+$"


class BaseInput(Section):
    """Who may command the base, by which ports and topics, and until when a command holds."""

    name: str = Field(min_length=1, description="As people know it.")
    timeout: float = Field(
        default=0.1, gt=0.0, le=5.0, description="Seconds after its last command in which the base is told to stop."
    )
    ports: tuple[str, ...] = Field(
        default=(),
        description="YARP ports, below `prefix`: `input/joystick` opens `input/joystick/rpc:i` and `.../data:i`, as"
        " YARP's `mobileBaseVelocityControl_nws_yarp` does; `aux_control:i` takes a `MobileBaseVelocity` and any other"
        " name in `:i` the Bottle `(type a b c gain)` of joysticks and RobotGoto.",
    )
    twist: tuple[str, ...] = Field(default=(), description="Topics of `Twist` and `TwistStamped`, m/s and rad/s.")
    joy: tuple[str, ...] = Field(default=(), description="Topics of `Joy`.")


INPUTS = (
    BaseInput(name="joystick", timeout=0.2, ports=("input/joystick",)),
    BaseInput(name="joystick1", timeout=0.2, ports=("joystick1:i",)),
    BaseInput(name="joystick2", timeout=0.2, ports=("joystick2:i",)),
    BaseInput(name="joy", timeout=0.5, joy=("/joy",)),
    BaseInput(name="aux", timeout=0.2, ports=("input/aux", "aux_control:i")),
    BaseInput(name="command", timeout=0.2, ports=("input/command", "control:i")),
    BaseInput(name="ros", timeout=0.5, twist=("/cmd_vel",)),
)


class JoySection(Section):
    """How a gamepad's `Joy` messages drive."""

    linear_axis: int = Field(default=1, ge=0, le=63, description="The axis that drives forward.")
    side_axis: int | None = Field(default=None, ge=0, le=63, description="The axis that drives to the left.")
    angular_axis: int = Field(default=0, ge=0, le=63, description="The axis that turns to the left.")
    enable_button: int | None = Field(
        default=4, ge=0, le=63, description="The button to be held while driving; empty for none."
    )


class BaseControlSection(ModuleSection):
    """The driver of a mobile base. Measures and limits are those of R1 unless told otherwise."""

    ini: Path | None = Field(
        default=None,
        description="A `baseCtrl` file of an existing robot, read as it is; what stands here beside it is stronger.",
    )
    kind: str = Field(default="cer", description="`cer`: two wheels, as R1; `ikart_V1`: three omnidirectional wheels.")
    wheel_radius: float = Field(default=0.16416, gt=0.0, lt=10.0, description="Metres (`geom_r`).")
    wheel_distance: float = Field(
        default=0.338,
        gt=0.0,
        lt=10.0,
        description="Metres between the two wheels, or from the centre to a wheel of `ikart_V1` (`geom_L`).",
    )
    joints: tuple[str, ...] = Field(
        default=(), description="The wheels' joints as the driver names them, in order; empty for R1's or iKart's."
    )
    period: float = Field(default=0.02, ge=0.001, le=0.1, description="Seconds between two commands to the wheels.")
    max_linear_vel: float = Field(default=0.3, gt=0.0, le=10.0, description="Metres per second.")
    max_angular_vel: float = Field(default=30.0, gt=0.0, le=720.0, description=f"{DEGREES.capitalize()}.")
    max_linear_acc: float = Field(default=0.3, gt=0.0, le=100.0, description="Metres per second squared.")
    max_angular_acc: float = Field(default=80.0, gt=0.0, le=7200.0, description=f"{DEGREES.capitalize()} squared.")
    max_linear_brake: float | None = Field(
        default=None, gt=0.0, le=100.0, description="The same while slowing down; empty for the same."
    )
    max_angular_brake: float | None = Field(default=None, gt=0.0, le=7200.0, description="The same for turning.")
    max_motor_vel: float = Field(
        default=100.0,
        gt=0.0,
        le=7200.0,
        description=f"The fastest that any wheel turns, {DEGREES}; all are slowed alike.",
    )
    linear_angular_ratio: float | None = Field(
        default=None,
        ge=0.0,
        le=1.0,
        description="The share of the maxima that driving keeps where driving and turning ask for more than the"
        " whole; empty: each goes to its own maximum.",
    )
    input_filter: Literal[0, 1, 2, 4, 8] = Field(default=0, description="Corner frequency in Hz of a filter; 0: none.")
    motors_filter: Literal[0, 1, 2, 4, 8, 10] = Field(
        default=0, description="The same for the wheels' velocities as they are told by `velocity:o`; 0: none."
    )
    joystick_linear_vel: float = Field(
        default=0.3, gt=0.0, le=10.0, description="Metres per second of a joystick's 100 percent."
    )
    joystick_angular_vel: float = Field(
        default=30.0, gt=0.0, le=720.0, description=f"{DEGREES.capitalize()} of a joystick's 100 percent."
    )
    joy: JoySection = Field(default_factory=JoySection, description="How gamepads drive.")
    odometry: str = Field(
        default="/baseControl/odometry",
        pattern=_PORTS,
        description="Begins the ports of the odometry: `/cer/odometry` for `/cer/odometry/odometry:o`, `odometer:o`,"
        " `velocity:o` and `rpc`, as YARP's `odometry2D_nws_yarp` has them.",
    )
    prefix: str = Field(default="/baseControl", pattern=_PORTS, description="Begins its ports.")
    inputs: tuple[BaseInput, ...] = Field(
        default=(), description="Who commands; the highest rank first. Empty: those of docs/base_control.md."
    )
    wheel_command: str = Field(
        default="/wheel_command", description="Topic that tells the wheels their velocities (`JointState`, rad/s)."
    )
    joint_states: str = Field(default="/joint_states", description="Topic of the wheels' encoders (`JointState`).")
    odom: str = Field(default="/odom", description="Topic of the odometry (`nav_msgs/Odometry`).")
    odom_frame: str = Field(default="odom", min_length=1, description="The odometry's frame.")
    base_frame: str = Field(default="base_link", min_length=1, description="The base's frame.")
    publish_tf: bool = Field(default=True, description="Whether the odometry is on `/tf`, too.")

    @field_validator("inputs")
    @classmethod
    def _names_differ(cls, value: tuple[BaseInput, ...]) -> tuple[BaseInput, ...]:
        names = [one.name for one in value]
        if len(set(names)) < len(names):
            msg = f"two inputs have one name: {', '.join(names)}"
            raise ValueError(msg)
        return value
