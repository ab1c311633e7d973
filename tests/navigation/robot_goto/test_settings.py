"""RobotGoto's section, and files of existing robots."""

from pathlib import Path
from typing import Any

import pytest

from bridge.config.sections.planners import RobotGotoSection
from navigation.ini import laid_under
from navigation.robot_goto.driver import Driver
from navigation.robot_goto.settings import read_file

R1 = """
[ROBOTGOTO_GENERAL]
name /robotGoto
autoconnect 1

[ROBOT_TRAJECTORY]
robot_is_holonomic  0
max_beta_angle      5.0
max_gamma_angle     3.0
ang_speed_gain      0.30
lin_speed_gain      0.10
max_lin_speed       0.3
max_ang_speed       15.0
min_lin_speed       0.01
min_ang_speed       0.5
goal_tolerance_lin  0.05
goal_tolerance_ang  0.6

[ROBOT_GEOMETRY]
robot_radius     0.30
laser_pos_x      0.07
laser_pos_y      0
laser_pos_theta  0

[LOCALIZATION]
robot_frame_id           mobile_base_body_link
map_frame_id             map
localizationServer_name  /localizationServer

[LASER]
laser_port /SIM_CER_ROBOT/laser:o

[OBSTACLES_EMERGENCY_STOP]
enable_obstacles_emergency_stop 1
enable_dynamic_max_distance     1
max_waiting_time                60.0
min_detection_distance          0.35
max_detection_distance          1.2

[OBSTACLES_AVOIDANCE]
enable_obstacles_avoidance 0
frontal_blind_angle 25.0
speed_reduction_factor 0.70

[RETREAT_OPTION]
enable_retreat 0
retreat_duration 300
"""


def read(section: RobotGotoSection) -> tuple[RobotGotoSection, list[str]]:
    return laid_under(section, section.ini, read_file)


def of(folder: Path, text: str, **own: Any) -> tuple[RobotGotoSection, list[str]]:
    file = folder / "robotGoto.ini"
    file.write_text(text)
    return read(RobotGotoSection(ini=file, **own))


def test_the_section_alone_has_the_drivers_defaults():
    made, notes = read(RobotGotoSection())
    assert made == Driver().settings
    assert notes == []


def test_r1s_file_is_read_as_it_is(tmp_path):
    section, _ = of(tmp_path, R1)
    assert (section.max_beta_angle, section.ang_speed_gain, section.lin_speed_gain) == (5.0, 0.3, 0.1)
    assert (section.max_lin_speed, section.max_ang_speed) == (0.3, 15.0)
    assert (section.min_lin_speed, section.min_ang_speed) == (0.01, 0.5)
    assert (section.goal_tolerance_lin, section.goal_tolerance_ang) == (0.05, 0.6)
    assert section.enable_obstacles_emergency_stop
    assert section.enable_dynamic_max_distance
    assert not section.enable_obstacles_avoidance
    assert not section.enable_retreat
    assert (section.min_detection_distance, section.max_detection_distance, section.max_waiting_time) == (
        0.35,
        1.2,
        60.0,
    )
    assert section.speed_reduction_factor == 0.7
    assert (section.base_frame, section.frame) == ("mobile_base_body_link", "map")
    assert (section.laser_port, section.laser_pose.x) == ("/SIM_CER_ROBOT/laser:o", 0.07)
    assert section.prefix == "/robotGoto"


def test_keys_that_nothing_reads_and_values_in_the_wrong_unit_are_named_with_their_place(tmp_path):
    made, notes = of(tmp_path, R1)
    assert made.retreat_duration == 0.3
    lines = dict(enumerate(R1.splitlines(), 1))
    for key, why in (
        ("max_gamma_angle", "upstream does not read it either"),
        ("retreat_duration", "'retreat_duration 300' is not believed: it is within 0 and 2 s; 0.3 is used"),
        ("autoconnect", "laser_port is connected always"),
    ):
        number = next(n for n, line in lines.items() if line.startswith(key))
        (note,) = (each for each in notes if key in each)
        assert note.startswith(f"{tmp_path / 'robotGoto.ini'}:{number}: ")
        assert why in note
    assert len(notes) == 3


def test_what_the_section_says_is_stronger_and_what_is_missing_is_upstreams(tmp_path):
    made, _ = of(tmp_path, R1.replace("max_lin_speed       0.3\n", ""), max_ang_speed=20.0)
    assert made.max_ang_speed == 20.0
    assert made.max_lin_speed == 0.9, "upstream's default"


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        ("[ROBOT_GEOMETRY]", "[ROBOT]", r"the group \[ROBOT_GEOMETRY\] is missing"),
        ("robot_radius     0.30", "", "'robot_radius' is missing"),
        ("max_lin_speed       0.3", "max_lin_speed fast", r"robotGoto.ini:12: 'max_lin_speed' is a number, not 'fast'"),
    ],
)
def test_a_file_that_cannot_be_used_says_why(tmp_path, before, after, why):
    with pytest.raises(RuntimeError, match=why):
        of(tmp_path, R1.replace(before, after))


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(RuntimeError, match="there is no such file"):
        read(RobotGotoSection(ini=tmp_path / "none.ini"))
