"""What ``mapper2D`` files of existing robots say.

Their keys are those of the branch ``mapper2D`` of robotology/navigation: metres, degrees.
"""

from __future__ import annotations

from typing import Any

from bridge.config.sections.maps import Mapper2DSection
from navigation.ini import Ini, IniGroup, frame_name, port_name

OTHERS = frozenset({"robot", "part", "local", "name"})  # keys that speak of upstream's own program
STALE = {("ROBOT_GEOMETRY", "robot_radius"): "a map has no robot in it"}
"""Keys that real files have and that change nothing, with why."""


def read_file(section: Mapper2DSection, ini: Ini) -> dict[str, Any]:
    """The fields that a file sets; see `navigation.ini.laid_under`."""
    found: dict[str, Any] = {}
    general, laser = ini.group("GENERAL"), ini.group("LASER")
    general.take_texts(found, port_name, prefix="module_name")
    for key, what in (("use_laser", "no map is made without a laser"), ("use_localization", "nor without a pose")):
        if not general.flag(key, default=True):
            ini.notes.append(f"{general.where(key)}: '{key} 0' is not obeyed: {what}")
    port = laser.text("laser_port", "")
    if port:
        found["laser_port"], found["scan"] = port_name(port), ""
    _take_map(ini.group("MAP"), found, section)
    _take_pose(ini, found)
    _take_geometry(ini.group("ROBOT_GEOMETRY"), found)
    _take_topics(ini.group("ROS"), found, on=general.flag("enable_ros", default=True))
    ini.note_unread(STALE, OTHERS)
    return found


def _take_map(group: IniGroup, found: dict[str, Any], section: Mapper2DSection) -> None:
    found["map_name"] = group.text("map_name", section.map_name)
    for key, name in (("map_width", "width"), ("map_height", "height")):
        found[name] = group.number(key, float(getattr(section, name)), 0.1, 400.0, "m")
    found["resolution"] = group.number("map_resolution", section.resolution, 0.005, 1.0, "m")


def _take_pose(ini: Ini, found: dict[str, Any]) -> None:
    by, frames, odometry = ini.group("LOCALIZATION"), ini.group("TF"), ini.group("ODOMETRY")
    by_port = by.flag("use_localization_from_odometry_port", default=False)
    by_tf = by.flag("use_localization_from_tf", default=not by_port)
    if by_port and by_tf:
        ini.notes.append(f"{by.where('use_localization_from_tf')}: port and tf both say where the robot is: tf is used")
    found["pose"] = "tf" if by_tf else "port"
    port = odometry.text("odometry_broadcast_port", "")
    if port and not by_tf:
        found["pose_port"] = port_name(port)
    frames.take_texts(found, frame_name, base_frame="robot_frame_id", map_frame="map_frame_id")


def _take_geometry(group: IniGroup, found: dict[str, Any]) -> None:
    places = [group.number(f"laser_pos_{axis}", 0.0, -10.0, 10.0, "m") for axis in ("x", "y")]
    theta = group.number("laser_pos_theta", 0.0, -360.0, 360.0, "deg")
    if any(map(group.has, ("laser_pos_x", "laser_pos_y", "laser_pos_theta"))):
        found["laser"] = (*places, theta)


def _take_topics(group: IniGroup, found: dict[str, Any], *, on: bool) -> None:
    found["period"] = group.number("map_publish_period", 1.0, 0.05, 60.0, "s")
    for key, name in (("occupancygrid_topic", "topic"), ("initialpose_topic", "initial_pose")):
        text = group.text(key, "")
        if text or not on:
            found[name] = "/" + text.strip("/") if on else ""
