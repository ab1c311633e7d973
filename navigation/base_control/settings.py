"""A base's kind and limits, from the section of the configuration and from ``baseCtrl`` files of existing robots.

The files' keys are those of robotology/navigation's ``baseControl2`` (and of ``baseControl`` before it), in m/s and
deg/s.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from navigation.base_control.section import FILTERS, INPUTS, WHEELS, BaseControlSection, BaseInput
from navigation.ini import Ini, IniGroup, laid_under, port_name

if TYPE_CHECKING:
    from navigation.base_control.limits import BaseLimits

_GENERAL, _GEOMETRY, _MOTORS, _STICK = "BASECTRL_GENERAL", "ROBOT_GEOMETRY", "MOTORS", "JOYSTICK"
_INPUT = "BASECTRL_INPUTS_{}"
_MOST_INPUTS = 32
_YARP_INPUT = "mobileBaseVelocityControl_nws_yarp"

OTHERS = frozenset({
    "LINEAR_VELOCITY_PID", "ANGULAR_VELOCITY_PID", "HEADING_VELOCITY_PID", "ROS_FOOTPRINT", "ROS_GENERAL", "robot",
    "part", "joystick_connect", "skip_robot_interface_check", "silent", "debug", "no_start", "control_mode",
})  # fmt: skip
"""Groups and keys of motor controllers and of upstream's own program, which Midspan does not need."""

STALE = {
    ("ROBOT_GEOMETRY", "g_angle"): "upstream ignores it, too; the kind defines the wheels' positions",
    ("MOTORS", "max_motor_pwm"): "the motors' driver limits its own current",
}
"""Keys that real files contain and that have no effect, with the reason."""


def resolved(section: BaseControlSection) -> tuple[BaseControlSection, list[str]]:
    """Return a section completed from its file and by defaults for inputs and joints, and notes on the file.

    Raises `RuntimeError` with the place and reason if the file is invalid, or the joints do not fit.
    """
    from navigation.base_control.kinematics import KinematicsError, kinematics  # numpy, without which files are checked

    section, notes = laid_under(section, section.ini, read_file)
    try:
        wheels = kinematics(section.kind, section.wheel_radius, section.wheel_distance).joints
    except KinematicsError as err:
        raise RuntimeError(f"modules.base_control: {err}") from None
    if misfit := next(section.misfits(), None):
        raise RuntimeError(f"modules.base_control.{misfit[0][0]}: {misfit[1]}")
    update = {"joints": section.joints or wheels, "inputs": section.inputs or INPUTS}
    return section.model_copy(update=update), notes


def limits(section: BaseControlSection) -> BaseLimits:
    """Return a section's limits, with angles in radians instead of degrees."""
    from navigation.base_control.limits import BaseLimits

    return BaseLimits(
        linear=section.max_linear_vel,
        angular=math.radians(section.max_angular_vel),
        linear_acceleration=section.max_linear_acc,
        linear_braking=section.max_linear_brake or section.max_linear_acc,
        angular_acceleration=math.radians(section.max_angular_acc),
        angular_braking=math.radians(section.max_angular_brake or section.max_angular_acc),
        wheel=math.radians(section.max_motor_vel),
        ratio=section.linear_angular_ratio,
        filter_hz=section.input_filter,
    )


def read_file(section: BaseControlSection, ini: Ini) -> dict[str, Any]:
    """Return the fields that a file sets; see `navigation.ini.laid_under`."""
    fields: dict[str, Any] = {"period": ini.top.number("period", section.period, 0.001, 0.1, "s")}
    ini.top.add_texts(fields, port_name, prefix="local")
    _read_general(ini, ini.group(_GENERAL, needed=True), fields, section)
    geometry = ini.group(_GEOMETRY, needed=True)
    fields["wheel_radius"] = geometry.number("geom_r", None, 0.01, 1.0, "m")
    fields["wheel_distance"] = geometry.number("geom_L", None, 0.05, 3.0, "m")
    motors = ini.group(_MOTORS)
    fields["max_motor_vel"] = motors.number("max_motor_vel", section.max_motor_vel, 1.0, 3600.0, "deg/s")
    fields["motors_filter"] = motors.choice("motors_filter_enabled", 0, (*FILTERS, 10))
    stick = ini.group(_STICK)
    for key, name, most in (("linear_vel", "linear", 3.0), ("angular_vel", "angular", 360.0)):
        default = float(getattr(section, f"joystick_{name}_vel"))
        fields[f"joystick_{name}_vel"] = stick.number(f"{key}_at_full_control", default, 0.01, most)
    # names for ROS in files of ``baseControl`` from before 2022
    ini.group("ROS_ODOMETRY").add_texts(
        fields, str, odom_frame="odom_frame", base_frame="base_frame", odom="topic_name"
    )
    inputs = _inputs(ini)
    if inputs:
        fields["inputs"] = inputs
    ini.note_unread(STALE, OTHERS)
    return fields


def _read_general(ini: Ini, group: IniGroup, fields: dict[str, Any], section: BaseControlSection) -> None:
    kind = group.text("robot_type", "")
    if kind not in WHEELS:
        ini.errors.append(f"{group.where('robot_type')}: unknown kind of base '{kind}'; use {' or '.join(WHEELS)}")
    fields["kind"] = kind
    fields["max_linear_vel"] = group.number("max_linear_vel", None, 0.01, 3.0, "m/s")
    fields["max_angular_vel"] = group.number("max_angular_vel", None, 1.0, 360.0, "deg/s")
    for axis, most, unit in (("linear", 10.0, "m/s2"), ("angular", 3600.0, "deg/s2")):
        default = group.number(f"max_{axis}_acc", float(getattr(section, f"max_{axis}_acc")), 0.01, most, unit)
        fields[f"max_{axis}_acc"] = group.number(f"max_{axis}_acc_pos", default, 0.01, most, unit)
        fields[f"max_{axis}_brake"] = group.number(f"max_{axis}_acc_neg", default, 0.01, most, unit)
    fields["input_filter"] = group.choice("input_filter_enabled", 0, FILTERS)
    group.number("linear_angular_ratio", 0.7, 0.0, 1.0)
    if group.flag("ratio_limiter_enabled", default=False):
        ini.notes.append(
            f"{group.where('ratio_limiter_enabled')}: 'ratio_limiter_enabled 1' is ignored: upstream's limiter never "
            "acts; set linear_angular_ratio in modules.base_control to use Midspan's"
        )


def _inputs(ini: Ini) -> tuple[BaseInput, ...]:
    """Return the inputs of the groups ``BASECTRL_INPUTS_i``, the highest rank first.

    Without such groups, these are the default inputs with the topic of ``ROS_INPUT``, or none if it has no topic.
    """
    inputs: list[BaseInput] = []
    general = ini.group(_GENERAL)
    count = general.number("number_of_inputs", 0.0, 0.0, _MOST_INPUTS)
    numbers = [number for number in range(_MOST_INPUTS) if _INPUT.format(number) in ini]
    if count and numbers != list(range(int(count))):
        names = ", ".join(_INPUT.format(number) for number in numbers) or "none"
        ini.notes.append(
            f"{general.where('number_of_inputs')}: 'number_of_inputs {count:g}', but the groups are {names}"
        )
    for number in numbers:
        group = ini.group(_INPUT.format(number))
        name = group.text("input_name", f"input {number}")
        timeout = group.number("max_timeout", 0.1, 0.01, 5.0, "s")
        device = group.text("nws_name", _YARP_INPUT)
        for key in ("local", "node_name", "topic_name"):
            group.text(key, "")
        if device == _YARP_INPUT:
            inputs.append(BaseInput(name=name, timeout=timeout, ports=(group.text("local", f"input/{name}"),)))
        else:
            topic = "/" + group.text("topic_name", "cmd_vel").strip("/")
            inputs.append(BaseInput(name=name, timeout=timeout, twist=(topic,)))
    topic = ini.group("ROS_INPUT").text("topic_name", "")
    if topic and not inputs:  # a file from before 2022, whose ports have fixed ranks
        inputs = [*INPUTS[:-1], INPUTS[-1].model_copy(update={"twist": ("/" + topic.strip("/"),)})]
    return tuple(inputs)
