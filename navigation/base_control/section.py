"""The section ``modules.base_control``: the driver of a mobile base."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, field_validator
from typing_extensions import override

from bridge.config.sections.section import (
    PORT,
    YARP_PORT,
    Mistake,
    Section,
    TopicName,
    differ,
    setting,
    subsection,
)
from bridge.messages.velocities import VELOCITIES
from navigation.file_section import FileSection

JOINTS, JOY = "sensor_msgs/msg/JointState", "sensor_msgs/msg/Joy"

DEGREES = "degrees per second"

WHEELS = {"cer": 2, "ikart_V1": 3}
"""The kinds of base, and how many wheels they have."""

FILTERS = (0, 1, 2, 4, 8)
"""The corner frequencies of filters, Hz; 0 is none."""


def _port_below_prefix(name: str) -> str:
    if not YARP_PORT.fullmatch(f"/{name.removeprefix('/')}"):
        raise ValueError(f"{name!r} is not a name of a YARP port below `prefix`: write it as aux_control:i")
    return name


_InputPort = Annotated[str, AfterValidator(_port_below_prefix)]


class BaseInput(Section):
    """An input of commands for the base: its ports and topics, and for how long a command is valid."""

    name: str = Field(min_length=1, description="Name of the input, for status and logs.")
    timeout: float = setting(0.1, "Seconds after the input's last command until the base stops.", gt=0.0, le=5.0)
    ports: tuple[_InputPort, ...] = setting(
        (),
        "YARP ports below `prefix`: `input/joystick` opens `input/joystick/rpc:i` and `.../data:i`, as YARP's"
        " `mobileBaseVelocityControl_nws_yarp` does; `aux_control:i` takes a `MobileBaseVelocity`; other names that"
        " end in `:i` take the Bottle `(type a b c gain)` of joysticks and RobotGoto.",
    )
    twist: tuple[TopicName, ...] = setting((), "Topics of `Twist` and `TwistStamped`, m/s and rad/s.")
    joy: tuple[TopicName, ...] = setting((), "Topics of `Joy`.")


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

    linear_axis: int = setting(1, "The axis that drives forward.", ge=0, le=63)
    side_axis: int | None = setting(None, "The axis that drives to the left.", ge=0, le=63)
    angular_axis: int = setting(0, "The axis that turns to the left.", ge=0, le=63)
    enable_button: int | None = setting(4, "The button to hold while driving; empty: none.", ge=0, le=63)


class BaseControlSection(FileSection):
    """The driver of a mobile base. Default measures and limits are those of R1."""

    reader: ClassVar[str] = "navigation.base_control.settings:read_file"

    ini: Path | None = setting(None, "A `baseCtrl` file of an existing robot; keys set here override it.")
    kind: Literal["cer", "ikart_V1"] = setting(
        "cer", "`cer`: two wheels, like R1; `ikart_V1`: three omnidirectional wheels."
    )
    wheel_radius: float = setting(0.16416, "Radius of the wheels, meters (`geom_r`).", gt=0.0, lt=10.0)
    wheel_distance: float = setting(
        0.338, "Meters between the two wheels; `ikart_V1`: from the center to a wheel (`geom_L`).", gt=0.0, lt=10.0
    )
    joints: tuple[str, ...] = setting((), "The wheels' joints in the driver's order; empty: R1's or iKart's.")
    period: float = setting(0.02, "Seconds between two commands to the wheels.", ge=0.001, le=0.1)
    max_linear_vel: float = setting(0.3, "Meters per second.", gt=0.0, le=10.0)
    max_angular_vel: float = setting(30.0, f"{DEGREES.capitalize()}.", gt=0.0, le=720.0)
    max_linear_acc: float = setting(0.3, "Meters per second squared.", gt=0.0, le=100.0)
    max_angular_acc: float = setting(80.0, f"{DEGREES.capitalize()} squared.", gt=0.0, le=7200.0)
    max_linear_brake: float | None = setting(
        None, "Deceleration, meters per second squared; empty: the same as `max_linear_acc`.", gt=0.0, le=100.0
    )
    max_angular_brake: float | None = setting(
        None, "Deceleration of turning; empty: the same as `max_angular_acc`.", gt=0.0, le=7200.0
    )
    max_motor_vel: float = setting(
        100.0, f"Maximum of each wheel, {DEGREES}; all wheels slow down together.", gt=0.0, le=7200.0
    )
    linear_angular_ratio: float | None = setting(
        None,
        "Share of driving if driving and turning together exceed 100 percent of their maxima; empty: no sharing.",
        ge=0.0,
        le=1.0,
    )
    input_filter: Literal[0, 1, 2, 4, 8] = setting(0, "Corner frequency of the filter for commands, Hz; 0: no filter.")
    motors_filter: Literal[0, 1, 2, 4, 8, 10] = setting(
        0, "Corner frequency of the filter for the velocities on `velocity:o`, Hz; 0: no filter."
    )
    joystick_linear_vel: float = setting(0.3, "Meters per second at 100 percent of a joystick.", gt=0.0, le=10.0)
    joystick_angular_vel: float = setting(
        30.0, f"{DEGREES.capitalize()} at 100 percent of a joystick.", gt=0.0, le=720.0
    )
    joy: JoySection = subsection(JoySection, "How gamepads drive.")
    odometry: str = setting(
        "/baseControl/odometry",
        "Prefix of the odometry's ports: `/cer/odometry` for `/cer/odometry/odometry:o`, `odometer:o`, `velocity:o`"
        " and `rpc`, as YARP's `odometry2D_nws_yarp` has them.",
        pattern=PORT,
    )
    prefix: str = setting("/baseControl", "Prefix of the module's ports.", pattern=PORT)
    inputs: tuple[BaseInput, ...] = setting(
        (), "The inputs, highest rank first; empty: the list in docs/navigation/base_control.md."
    )
    wheel_command: TopicName = setting("/wheel_command", "Topic of the wheels' velocities (`JointState`, rad/s).")
    joint_states: TopicName = setting("/joint_states", "Topic of the wheels' encoders (`JointState`).")
    odom: TopicName = setting("/odom", "Topic of the odometry (`nav_msgs/Odometry`).")
    odom_frame: str = setting("odom", "The odometry's frame.", min_length=1)
    base_frame: str = setting("base_link", "The base's frame.", min_length=1)
    publish_tf: bool = setting(True, "Whether the odometry is also on `/tf`.")

    @property
    @override
    def driven(self) -> tuple[tuple[str, str], ...]:
        inputs = self.with_file().inputs or INPUTS
        twists = ((topic, kind) for source in inputs for topic in source.twist for kind in VELOCITIES)
        joys = ((topic, JOY) for source in inputs for topic in source.joy)
        return (self.wheel_command, JOINTS), *twists, *joys

    @field_validator("inputs")
    @classmethod
    def _names_differ(cls, value: tuple[BaseInput, ...]) -> tuple[BaseInput, ...]:
        differ([item.name for item in value], "two inputs have the name")
        return value

    @override
    def misfits(self) -> Iterator[Mistake]:
        count, wheels = len(self.joints), WHEELS[self.kind]
        if count not in (0, wheels):
            yield ("joints",), f"names {count}, but a base of the kind {self.kind} has {wheels} wheels"
