"""Reads ``robotPathPlanner`` files of existing robots, of robotology/navigation's releases since 2016.

Older files have no group ``NAVIGATION``: its keys are at the top, with one set of speeds for waypoints and goal.
"""

from __future__ import annotations

from typing import Any

from navigation.ini import Ini, IniGroup, frame_name, port_name
from navigation.robot_path_planner.section import DrivenSection, RobotPathPlannerSection

_CELL = 0.05
_SPEEDS = (
    ("max_lin_speed", 0.01, 3.0, "m/s"),
    ("min_lin_speed", 0.0, 3.0, "m/s"),
    ("max_ang_speed", 0.5, 360.0, "deg/s"),
    ("min_ang_speed", 0.0, 360.0, "deg/s"),
    ("lin_speed_gain", 0.001, 10.0, "(m/s)/m"),
    ("ang_speed_gain", 0.001, 10.0, "(deg/s)/deg"),
)

OTHERS = frozenset({
    "laser_port", "laser_pos_x", "laser_pos_y", "laser_pos_theta", "localizationServer_name", "mapServer_name",
    "localization_server_name", "map_server_name",
})  # fmt: skip
"""Keys with the names of YARP's servers and the laser's pose, for which Midspan uses the hub."""

STALE = {
    ("RECOVERY", key): "a blocked robot takes another path; it does not try to turn in place"
    for key in ("enable", "lin_tolerance", "ang_tolerance", "time_tolerance", "algorithm_name")
} | {
    ("NAVIGATION", "pathplanner_thinking_timeout"): "planning takes milliseconds",
    ("INTERNAL_NAVIGATOR", "plugin"): "set modules.robot_path_planner.navigator instead",
    ("INTERNAL_NAVIGATOR", "context"): "set modules.robot_goto.ini to robotGoto's own file",
    ("INTERNAL_NAVIGATOR", "from"): "set modules.robot_goto.ini to robotGoto's own file",
    ("MAP", "file_name"): "maps are in the store: use 'midspan map import'",
}
"""Keys that real files contain and that have no effect, with the reason."""


def read_file(section: RobotPathPlannerSection, ini: Ini) -> dict[str, Any]:
    """Return the fields that a file sets; see `navigation.ini.laid_under`."""
    fields: dict[str, Any] = {}
    navigation = ini.group("NAVIGATION") if "NAVIGATION" in ini else ini.top
    for kind in RobotPathPlannerSection.merged:
        from_file = _drive_settings(navigation, kind, named="NAVIGATION" in ini)
        given: DrivenSection = getattr(section, kind)
        from_section = {} if kind not in section.model_fields_set else given.model_dump(include=given.model_fields_set)
        fields[kind] = type(given)(**{**from_file, **from_section})
    _take_least(navigation, fields, section)
    fields["use_optimized_path"] = navigation.flag("use_optimized_path", default=True)
    if not navigation.flag("enable_try_recovery", default=True):
        fields["recoveries"] = 0
    name = "PATHPLANNER_GENERAL" if "PATHPLANNER_GENERAL" in ini else "GENERAL"
    general = ini.group(name) if name in ini else ini.top
    fields["image_hz"] = general.number("publish_map_image_Hz", section.image_hz, 0.0, 30.0, "Hz")
    general.add_texts(fields, port_name, prefix="name")
    geometry = ini.group("ROBOT_GEOMETRY", needed=True)
    fields["robot_radius"] = geometry.number("robot_radius", None, 0.01, 3.0, "m")
    ini.group("LOCALIZATION").add_texts(fields, frame_name, base_frame="robot_frame_id", frame="map_frame_id")
    for group in ("LASER", "RECOVERY", "INTERNAL_NAVIGATOR", "MAP"):
        ini.group(group)
    ini.note_unread(STALE, OTHERS)
    return fields


def _drive_settings(navigation: IniGroup, kind: str, *, named: bool) -> dict[str, float]:
    """Return the keys of one kind that are present; in files without groups, the common speeds."""
    values: dict[str, float] = {}
    for key, low, high, unit in (
        ("tolerance_lin", 0.001, 5.0, "m"),
        ("tolerance_ang", 0.01, 180.0, "deg"),
        *((f"{key}", low, high, unit) for key, low, high, unit in _SPEEDS),
    ):
        speed = not key.startswith("tolerance")
        name = f"{kind}_{key}" if named or not speed else key
        if navigation.has(name):
            default = {"waypoint": 0.1, "goal": 0.05}[kind] if key == "tolerance_lin" else None
            values[key] = navigation.number(name, default, low, high, unit)
    return values


def _take_least(navigation: IniGroup, fields: dict[str, Any], section: RobotPathPlannerSection) -> None:
    cells = (
        navigation.number("min_waypoint_distance", -1.0, 0.0, 1000.0, "cells")
        if navigation.has("min_waypoint_distance")
        else -1.0
    )
    fields["min_waypoint_distance"] = section.min_waypoint_distance if cells <= 0 else cells * _CELL
    if cells > 0:
        navigation.note(
            "min_waypoint_distance",
            f"upstream ignores it; here it is {cells * _CELL:g} m (cells of {_CELL:g} m)",
        )
