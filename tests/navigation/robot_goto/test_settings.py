"""RobotGoto's section, and files of existing robots."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from navigation.ini import laid_under
from navigation.robot_goto.driver import Driver
from navigation.robot_goto.section import RobotGotoSection
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


def read_text(folder: Path, text: str, **values: Any) -> tuple[RobotGotoSection, list[str]]:
    file = folder / "robotGoto.ini"
    file.write_text(text)
    return read(RobotGotoSection(ini=file, **values))


def test_an_empty_section_has_the_drivers_defaults():
    section, notes = read(RobotGotoSection())
    assert section == Driver().settings
    assert notes == []


def test_r1s_file_is_read_unchanged(tmp_path):
    section, _ = read_text(tmp_path, R1)
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
    assert section.speed_reduction_factor == 0.0
    assert (section.base_frame, section.frame) == ("mobile_base_body_link", "map")
    assert (section.laser_port, section.laser_pose.x) == ("/SIM_CER_ROBOT/laser:o", 0.07)
    assert section.prefix == "/robotGoto"


def test_ignored_keys_and_values_out_of_range_are_noted_with_their_line(tmp_path):
    section, notes = read_text(tmp_path, R1)
    assert section.retreat_duration == 0.3
    lines = dict(enumerate(R1.splitlines(), 1))
    for key, reason in (
        ("max_gamma_angle", "upstream ignores it, too"),
        ("retreat_duration", "'retreat_duration 300' is out of range (0 to 2 s); using 0.3"),
        ("autoconnect", "laser_port is always connected"),
        ("speed_reduction_factor", "upstream ignores it, too"),
    ):
        number = next(n for n, line in lines.items() if line.startswith(key))
        (note,) = (note for note in notes if key in note)
        assert note.startswith(f"{tmp_path / 'robotGoto.ini'}:{number}: ")
        assert reason in note
    assert len(notes) == 4


def test_the_section_overrides_the_file_and_upstreams_defaults_fill_gaps(tmp_path):
    section, _ = read_text(tmp_path, R1.replace("max_lin_speed       0.3\n", ""), max_ang_speed=20.0)
    assert section.max_ang_speed == 20.0
    assert section.max_lin_speed == 0.9, "upstream's default"


@pytest.mark.parametrize(
    ("before", "after", "reason"),
    [
        ("[ROBOT_GEOMETRY]", "[ROBOT]", r"the group \[ROBOT_GEOMETRY\] is missing"),
        ("robot_radius     0.30", "", "'robot_radius' is missing"),
        (
            "max_lin_speed       0.3",
            "max_lin_speed fast",
            r"robotGoto.ini:12: 'max_lin_speed' must be a number, not 'fast'",
        ),
    ],
)
def test_invalid_files_are_rejected_with_the_reason(tmp_path, before, after, reason):
    with pytest.raises(RuntimeError, match=reason):
        read_text(tmp_path, R1.replace(before, after))


def test_a_missing_file_is_rejected(tmp_path):
    with pytest.raises(RuntimeError, match="no such file"):
        read(RobotGotoSection(ini=tmp_path / "none.ini"))


@pytest.mark.parametrize("wrong", [{"scan": "my scan"}, {"cmd_vel": "fast!"}, {"cmd_vel": ""}])
def test_invalid_topics_are_rejected(wrong):
    with pytest.raises(ValidationError, match="topic name"):
        RobotGotoSection.model_validate(wrong)
