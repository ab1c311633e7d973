"""Configuration sections, and files of existing robots."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from bridge.messages.velocities import TWIST
from navigation.base_control.base import DrivenBase
from navigation.base_control.limits import BaseLimits
from navigation.base_control.section import INPUTS, BaseControlSection
from navigation.base_control.settings import limits, resolved

R1 = """\
local         baseControl   // the module's ports
robot         cer
part          mobile_base
period        0.020
[BASECTRL_GENERAL]
control_mode            velocity_no_pid   // none, velocity_pid, ...
robot_type              cer
linear_angular_ratio    0.7
ratio_limiter_enabled   0
input_filter_enabled    0
max_linear_vel          0.30  // m/s
max_angular_vel         30
max_linear_acc          0.30
max_angular_acc         80.0
number_of_inputs        3

[BASECTRL_INPUTS_0]
input_name    joystick
nws_name      mobileBaseVelocityControl_nws_yarp
local         /baseControl/input/joystick
max_timeout   0.2
[BASECTRL_INPUTS_1]
input_name    aux
local         /baseControl/input/aux
[BASECTRL_INPUTS_2]
input_name    ros2
nws_name      mobileBaseVelocityControl_nws_ros2
node_name     mobile_base
topic_name    /cmd_vel
max_timeout   0.5
[include "geometry.ini"]
[MOTORS]
max_motor_pwm         10000
max_motor_vel         100
motors_filter_enabled 10
[JOYSTICK]
linear_vel_at_full_control    0.25
angular_vel_at_full_control   40
[LINEAR_VELOCITY_PID]
kp 0
"""
GEOMETRY = "[ROBOT_GEOMETRY]\ngeom_r  0.160  # meters\ngeom_L  0.340\ng_angle 0.0\n"
OLD = """\
robot ikart
[BASECTRL_GENERAL]
robot_type ikart_V1
max_linear_vel 0.4
max_angular_vel 50
[ROBOT_GEOMETRY]
geom_r 62.5e-3
geom_L 273.0e-3
[MOTORS]
[JOYSTICK]
[ROS_INPUT]
topic_name /robot/cmd_vel
[ROS_ODOMETRY]
odom_frame odometry
base_frame mobile_base_body_link
topic_name /odometry
"""


def read(folder: Path, text: str, **section: object) -> tuple[BaseControlSection, list[str]]:
    (folder / "geometry.ini").write_text(GEOMETRY)
    file = folder / "baseCtrl.ini"
    file.write_text(text)
    return resolved(BaseControlSection(ini=file, **section))  # type: ignore[arg-type]


def test_the_defaults_are_r1s() -> None:
    section, _ = resolved(BaseControlSection())
    assert limits(section) == BaseLimits()
    assert section.joints == ("mobile_base_l_wheel_joint", "mobile_base_r_wheel_joint")
    assert [source.name for source in section.inputs] == [source.name for source in INPUTS]


def test_a_file_of_r1_is_read(tmp_path: Path) -> None:
    section, notes = read(tmp_path, R1)
    assert DrivenBase(section).limiter.kinematics.matrix[0] == pytest.approx([1 / 0.16, 0.0, -0.17 / 0.16])
    assert limits(section) == BaseLimits(ratio=None)
    assert section.motors_filter == 10
    assert DrivenBase(section).full == (0.25, 40.0)
    inputs = [(source.name, source.timeout, source.ports, source.twist) for source in section.inputs]
    assert inputs == [
        ("joystick", 0.2, ("/baseControl/input/joystick",), ()),
        ("aux", 0.1, ("/baseControl/input/aux",), ()),
        ("ros2", 0.5, (), ("/cmd_vel",)),
    ]
    notes = [note.removeprefix(str(tmp_path)) for note in notes]
    assert [note.split(": ")[0] for note in notes] == ["/geometry.ini:4", "/baseCtrl.ini:33"]
    assert "'g_angle' is ignored" in notes[0]
    assert "'max_motor_pwm' is ignored" in notes[1]


def test_a_file_from_before_2022_is_read(tmp_path: Path) -> None:
    section, notes = read(tmp_path, OLD)
    assert DrivenBase(section).limiter.kinematics.holonomic
    assert (section.odom_frame, section.base_frame, section.odom) == ("odometry", "mobile_base_body_link", "/odometry")
    assert [source.name for source in section.inputs] == [source.name for source in INPUTS]
    assert section.inputs[-1].twist == ("/robot/cmd_vel",)
    assert ("/robot/cmd_vel", TWIST) in BaseControlSection(ini=tmp_path / "baseCtrl.ini").driven
    assert not notes


def test_the_sections_values_override_the_files(tmp_path: Path) -> None:
    section, _ = read(tmp_path, R1, max_linear_vel=0.1, base_frame="mobile_base_body_link")
    assert limits(section).linear == 0.1
    assert limits(section).angular == math.radians(30.0)
    assert section.base_frame == "mobile_base_body_link"


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ("max_linear_vel          0.30", "max_linear_vel 300 // mm/s", ":11: 'max_linear_vel 300' is out of range"),
        (
            "max_timeout   0.2",
            "max_timeout 200",
            ":21: 'max_timeout 200' is out of range (0.01 to 5 s); using 0.1",
        ),
        ("ratio_limiter_enabled   0", "ratio_limiter_enabled 1", ":9: 'ratio_limiter_enabled 1' is ignored"),
        (
            "number_of_inputs        3",
            "number_of_inputs 2",
            ":15: 'number_of_inputs 2', but the groups are BASECTRL_INPUTS_0",
        ),
        ("[JOYSTICK]", "[JOYSTIK]", ": the group [JOYSTIK] is ignored"),
        ("robot         cer", "robott cer", ":2: 'robott' is ignored"),
    ],
)
def test_problems_are_noted_with_file_and_line(tmp_path: Path, old: str, new: str, note: str) -> None:
    assert old in R1
    _, notes = read(tmp_path, R1.replace(old, new, 1))
    assert any(note in line for line in notes), notes


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ("cer\nlinear", "ikart_V2\nlinear", "baseCtrl.ini:7: unknown kind of base 'ikart_V2'"),
        ('[include "geometry.ini"]', "", "the group [ROBOT_GEOMETRY] is missing"),
        ("max_linear_vel          0.30", "", "baseCtrl.ini:5: 'max_linear_vel' is missing"),
        ("max_linear_vel          0.30", "max_linear_vel fast", "baseCtrl.ini:11: 'max_linear_vel' must be a number"),
        (
            "input_filter_enabled    0",
            "input_filter_enabled 3",
            "baseCtrl.ini:10: 'input_filter_enabled' must be one of",
        ),
        (
            "ratio_limiter_enabled   0",
            "ratio_limiter_enabled 7",
            "baseCtrl.ini:9: 'ratio_limiter_enabled' must be 0 or 1",
        ),
    ],
)
def test_errors_are_reported_with_file_and_line(tmp_path: Path, old: str, new: str, note: str) -> None:
    assert old in R1
    with pytest.raises(RuntimeError) as refused:
        read(tmp_path, R1.replace(old, new, 1))
    assert note in str(refused.value)


def test_a_missing_file_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="no such file"):
        resolved(BaseControlSection(ini=tmp_path / "none.ini"))


def test_a_wrong_number_of_joints_is_rejected() -> None:
    with pytest.raises(RuntimeError, match="names 1, but a base of the kind cer has 2 wheels"):
        resolved(BaseControlSection().model_copy(update={"joints": ("one",)}))
