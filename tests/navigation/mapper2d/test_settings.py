"""``mapper2D`` files of existing robots."""

from __future__ import annotations

from pathlib import Path

import pytest

from navigation.ini import laid_under
from navigation.mapper2d.mapper import Mapper
from navigation.mapper2d.section import MOST_CELLS, Mapper2DSection
from navigation.mapper2d.settings import read_file
from yarp_compat.dev.mapflag import MAX_CELLS

FILE = """\
[GENERAL]
module_name    mapperA
enable_ros     1
use_laser      1
use_localization 1
[LOCALIZATION]
use_localization_from_odometry_port 1
use_localization_from_tf 0
[MAP]
map_name       testMap
map_width      20
map_height     30.5
map_resolution 0.05
[TF]
robot_frame_id /mobile_base_body_link
map_frame_id   map
[ODOMETRY]
odometry_broadcast_port /baseControl/odometry:o
[LASER]
laser_port     /robot/laser:o
[ROBOT_GEOMETRY]
robot_radius   0.30
laser_pos_x    0.07
laser_pos_y    0
laser_pos_theta 0
[ROS]
map_publish_period 2.0
initialpose_topic /initialpose
occupancygrid_topic /map
speed 3
"""


def read(folder: Path, text: str, **section: object) -> tuple[Mapper2DSection, list[str]]:
    file = folder / "mapper2D.ini"
    file.write_text(text)
    given = Mapper2DSection.model_validate({"ini": file, **section})
    return laid_under(given, given.ini, read_file)


def test_a_file_is_read_unchanged(tmp_path: Path) -> None:
    section, notes = read(tmp_path, FILE)
    assert (section.prefix, section.map_name, section.width, section.height) == ("/mapperA", "testMap", 20.0, 30.5)
    assert (section.pose, section.base_frame, section.map_frame) == ("port", "mobile_base_body_link", "map")
    assert section.laser == (0.07, 0.0, 0.0)
    assert (section.scan, section.laser_port, section.pose_port) == ("", "/robot/laser:o", "/baseControl/odometry:o")
    assert (section.topic, section.initial_pose, section.period) == ("/map", "/initialpose", 2.0)
    text = "\n".join(notes)
    for part in (
        "mapper2D.ini:22: 'robot_radius' is ignored",
        "mapper2D.ini:30: 'speed' is ignored",
    ):
        assert part in text
    assert len(notes) == 2


def test_the_sections_values_override_the_files(tmp_path: Path) -> None:
    section, _ = read(tmp_path, FILE, map_name="mine", pose="tf", laser=(1.0, 2.0, 3.0), scan="/scan")
    assert (section.map_name, section.pose, section.laser) == ("mine", "tf", (1.0, 2.0, 3.0))
    assert (section.scan, section.laser_port) == ("/scan", "/robot/laser:o")


def test_a_short_file_keeps_the_other_defaults(tmp_path: Path) -> None:
    section, notes = read(tmp_path, "[GENERAL]\nenable_ros 0\n[MAP]\nmap_width 9000\n")
    assert (section.pose, section.laser, section.topic, section.width) == ("tf", None, "", 10.0)
    assert "'map_width 9000' is out of range" in "\n".join(notes)


def test_invalid_files_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="no such file"):
        laid_under(Mapper2DSection(), tmp_path / "none.ini", read_file)
    with pytest.raises(RuntimeError, match=r"mapper2D.ini:2: 'map_width' must be a number"):
        read(tmp_path, "[MAP]\nmap_width wide\n")


def test_a_map_with_too_many_cells_is_rejected(tmp_path: Path) -> None:
    assert MOST_CELLS == MAX_CELLS
    [(path, text)] = Mapper2DSection(width=400.0, height=400.0, resolution=0.005).mistakes(None)
    assert path == ("resolution",)
    assert text.startswith("a map of 400 by 400 m with a resolution of 0.005 m has 6400000000 cells")
    section, _ = read(tmp_path, "[MAP]\nmap_width 400\nmap_height 400\nmap_resolution 0.005\n")
    with pytest.raises(ValueError, match="80000 x 80000 cells is too large"):
        Mapper(section)


def test_a_map_does_not_grow_beyond_the_cells_of_a_map() -> None:
    mapper = Mapper(Mapper2DSection(width=1.0, height=1.0, resolution=0.005, largest=400.0))
    with pytest.raises(ValueError, match="or more than 67108864 cells"):
        mapper.enlarge(100.0)
