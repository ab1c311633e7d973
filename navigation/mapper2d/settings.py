"""Reads ``mapper2D`` files of existing robots.

The files' keys are those of the branch ``mapper2D`` of robotology/navigation, in meters and degrees.
"""

from __future__ import annotations

from typing import Any

from navigation.ini import Ini, IniGroup, frame_name, port_name
from navigation.mapper2d.section import Mapper2DSection

OTHERS = frozenset({"robot", "part", "local", "name"})  # keys of upstream's own program
STALE = {("ROBOT_GEOMETRY", "robot_radius"): "the map does not depend on it"}
"""Keys that real files contain and that have no effect, with the reason."""


def read_file(section: Mapper2DSection, ini: Ini) -> dict[str, Any]:
    """Return the fields that a file sets; see `navigation.ini.laid_under`."""
    fields: dict[str, Any] = {}
    general, laser = ini.group("GENERAL"), ini.group("LASER")
    general.add_texts(fields, port_name, prefix="module_name")
    for key, need in (("use_laser", "a laser"), ("use_localization", "a pose")):
        if not general.flag(key, default=True):
            ini.notes.append(f"{general.where(key)}: '{key} 0' is ignored: mapping needs {need}")
    port = laser.text("laser_port", "")
    if port:
        fields["laser_port"], fields["scan"] = port_name(port), ""
    _read_map(ini.group("MAP"), fields, section)
    _read_pose(ini, fields)
    _read_geometry(ini.group("ROBOT_GEOMETRY"), fields)
    _read_topics(ini.group("ROS"), fields, on=general.flag("enable_ros", default=True))
    ini.note_unread(STALE, OTHERS)
    return fields


def _read_map(group: IniGroup, fields: dict[str, Any], section: Mapper2DSection) -> None:
    fields["map_name"] = group.text("map_name", section.map_name)
    for key, name in (("map_width", "width"), ("map_height", "height")):
        fields[name] = group.number(key, float(getattr(section, name)), 0.1, 400.0, "m")
    fields["resolution"] = group.number("map_resolution", section.resolution, 0.005, 1.0, "m")


def _read_pose(ini: Ini, fields: dict[str, Any]) -> None:
    by, frames, odometry = ini.group("LOCALIZATION"), ini.group("TF"), ini.group("ODOMETRY")
    by_port = by.flag("use_localization_from_odometry_port", default=False)
    by_tf = by.flag("use_localization_from_tf", default=not by_port)
    if by_port and by_tf:
        ini.notes.append(f"{by.where('use_localization_from_tf')}: both port and tf are set: using tf")
    fields["pose"] = "tf" if by_tf else "port"
    port = odometry.text("odometry_broadcast_port", "")
    if port and not by_tf:
        fields["pose_port"] = port_name(port)
    frames.add_texts(fields, frame_name, base_frame="robot_frame_id", map_frame="map_frame_id")


def _read_geometry(group: IniGroup, fields: dict[str, Any]) -> None:
    places = [group.number(f"laser_pos_{axis}", 0.0, -10.0, 10.0, "m") for axis in ("x", "y")]
    theta = group.number("laser_pos_theta", 0.0, -360.0, 360.0, "deg")
    if any(map(group.has, ("laser_pos_x", "laser_pos_y", "laser_pos_theta"))):
        fields["laser"] = (*places, theta)


def _read_topics(group: IniGroup, fields: dict[str, Any], *, on: bool) -> None:
    fields["period"] = group.number("map_publish_period", 1.0, 0.05, 60.0, "s")
    for key, name in (("occupancygrid_topic", "topic"), ("initialpose_topic", "initial_pose")):
        text = group.text(key, "")
        if text or not on:
            fields[name] = "/" + text.strip("/") if on else ""
