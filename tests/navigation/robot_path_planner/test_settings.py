"""Configuration sections, and files of existing robots."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from pydantic import ValidationError

from navigation.constraints import Constraints
from navigation.ini import laid_under
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_path_planner.section import RobotPathPlannerSection
from navigation.robot_path_planner.settings import read_file

R1 = """\
[GENERAL]
publish_map_image_Hz   15

[NAVIGATION]
pathplanner_thinking_timeout 30
min_waypoint_distance  4
use_optimized_path     1
enable_try_recovery    0
goal_tolerance_lin     0.05
goal_tolerance_ang     0.6
goal_max_lin_speed     0.45
goal_max_ang_speed     5.0
goal_min_lin_speed     0.1
goal_min_ang_speed     0.1
goal_ang_speed_gain     0.3
goal_lin_speed_gain     0.1
waypoint_tolerance_lin 0.15
waypoint_tolerance_ang 5
waypoint_max_lin_speed 0.45
waypoint_max_ang_speed 500
waypoint_min_lin_speed 0.1
waypoint_min_ang_speed 0.1
waypoint_ang_speed_gain 0.3
waypoint_lin_speed_gain 0.1

[INTERNAL_NAVIGATOR]
plugin                 robotGotoDev
context                freeFloorViewer
from                   robotGoto_cer02.ini

[LOCALIZATION]
robot_frame_id         mobile_base_body_link
map_frame_id           map

[LASER]
laser_port             /cer/laser:o

[ROBOT_GEOMETRY]
robot_radius           0.30
laser_pos_x            0
laser_pos_y            0
laser_pos_theta        0
"""
OLD = """\
goal_tolerance_lin     0.05
goal_tolerance_ang     0.6
waypoint_tolerance_lin 0.1
waypoint_tolerance_ang 5
min_waypoint_distance  0
use_optimized_path     1
max_lin_speed          0.25
min_lin_speed          0.1
publish_map_image_Hz   15
[MAP]
file_name              C:/software/maps/map_test.yaml
[LOCALIZATION]
robot_frame_id         mobile_base_body
[LASER]
laser_port             /ikart/laser:o
[ROBOT_GEOMETRY]
robot_radius           0.35
laser_pos_x            0.245
laser_pos_y            0
laser_pos_theta        -135
"""


def read(folder: Path, text: str, **section: object) -> tuple[RobotPathPlannerSection, list[str]]:
    file = folder / "robotPathPlanner.ini"
    file.write_text(text)
    given = RobotPathPlannerSection.model_validate({"ini": file, **section})
    return laid_under(given, given.ini, read_file, merged=RobotPathPlannerSection.merged)


def test_a_file_of_r1_is_read_unchanged(tmp_path: Path) -> None:
    section, notes = read(tmp_path, R1)
    assert Constraints(**section.waypoint.model_dump()) == Constraints(0.45, 0.1, 360.0, 0.1, 0.1, 0.3, 0.15, 5.0)
    assert Constraints(**section.goal.model_dump()) == Constraints(0.45, 0.1, 5.0, 0.1, 0.1, 0.3, 0.05, 0.6)
    assert (section.robot_radius, section.recoveries, section.min_waypoint_distance) == (0.3, 0, 0.2)
    assert (section.base_frame, section.frame, section.image_hz) == ("mobile_base_body_link", "map", 15.0)
    lines = sorted(int(line) for note in notes for line in re.findall(r"\.ini:(\d+): ", note))
    assert lines == [5, 6, 20, 27, 28, 29]
    assert "waypoint_max_ang_speed 500" in "".join(notes)
    assert "upstream ignores it" in "".join(notes)


def test_a_file_of_2016_has_its_keys_outside_groups(tmp_path: Path) -> None:
    section, notes = read(tmp_path, OLD)
    assert Constraints(**section.waypoint.model_dump()) == Constraints(0.25, 0.1, tolerance_lin=0.1, tolerance_ang=5.0)
    assert Constraints(**section.goal.model_dump()) == Constraints(0.25, 0.1, tolerance_lin=0.05, tolerance_ang=0.6)
    assert (section.robot_radius, section.recoveries, section.base_frame) == (0.35, 5, "mobile_base_body")
    assert len(notes) == 1
    assert "ini:11: 'file_name' is ignored: maps are in the store" in notes[0]


def test_the_goals_default_tolerances_are_those_of_robot_goto() -> None:
    goal, local = RobotPathPlannerSection().goal, RobotGotoSection()
    assert (goal.tolerance_lin, goal.tolerance_ang) == (local.goal_tolerance_lin, local.goal_tolerance_ang)


def test_the_sections_values_override_the_files(tmp_path: Path) -> None:
    section, _ = read(tmp_path, R1, robot_radius=0.2, recoveries=2, base_frame="base", goal={"tolerance_lin": 0.2})
    assert (section.robot_radius, section.recoveries, section.base_frame) == (0.2, 2, "base")
    assert (section.goal.tolerance_lin, section.goal.max_lin_speed) == (0.2, 0.45)


def test_invalid_files_are_rejected_with_place_and_reason(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"group \[ROBOT_GEOMETRY\] is missing"):
        read(tmp_path, OLD.split("[ROBOT_GEOMETRY]", maxsplit=1)[0])
    with pytest.raises(RuntimeError, match=r"ini:17: 'robot_radius' must be a number, not 'wide'"):
        read(tmp_path, OLD.replace("0.35", "wide"))
    with pytest.raises(RuntimeError, match="no such file"):
        laid_under(RobotPathPlannerSection(), tmp_path / "none.ini", read_file, merged=RobotPathPlannerSection.merged)


@pytest.mark.parametrize(
    "navigator",
    ["/planner/robot_path_planner/navigate_to_pose", "/navigate_to_pose", "yarp:/robotPathPlanner"],
)
def test_the_planner_is_not_its_own_local_navigator(navigator: str) -> None:
    [(path, text)] = RobotPathPlannerSection(navigator=navigator).mistakes(None)
    assert path == ("navigator",)
    assert "leads back to RobotPathPlanner itself" in text


@pytest.mark.parametrize("wrong", [{"map": "map"}, {"navigator": "robot_goto"}, {"navigator": "yarp:x"}, {"scan": "s"}])
def test_invalid_names_are_rejected(wrong: dict[str, str]) -> None:
    with pytest.raises(ValidationError):
        RobotPathPlannerSection.model_validate(wrong)
