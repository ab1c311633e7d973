"""``robotPathPlanner`` files of existing robots, of robotology/navigation's releases of 2016 and since.

Older ones have no group ``NAVIGATION``: its keys stand at the top, and one set of speeds holds for waypoints and goal.
"""

from __future__ import annotations

from typing import Any

from bridge.config.sections.planners import DrivenSection, RobotPathPlannerSection
from navigation.ini import Ini, IniGroup, frame_name, port_name

MERGED = ("waypoint", "goal")
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
"""Keys that say where YARP's servers and the laser are: the hub knows both."""

STALE = {
    ("RECOVERY", key): "a blocked robot is led another way; turning in place is not tried"
    for key in ("enable", "lin_tolerance", "ang_tolerance", "time_tolerance", "algorithm_name")
} | {
    ("NAVIGATION", "pathplanner_thinking_timeout"): "a way is found or not, in milliseconds",
    ("INTERNAL_NAVIGATOR", "plugin"): "modules.robot_path_planner.navigator says who drives",
    ("INTERNAL_NAVIGATOR", "context"): "give robotGoto's own file as modules.robot_goto.ini",
    ("INTERNAL_NAVIGATOR", "from"): "give robotGoto's own file as modules.robot_goto.ini",
    ("MAP", "file_name"): "the map is the store's: put it there with 'midspan map import'",
}
"""Keys that real files have and that change nothing, with why."""


def read_file(section: RobotPathPlannerSection, ini: Ini) -> dict[str, Any]:
    """The fields that a file sets; see `navigation.ini.laid_under`."""
    found: dict[str, Any] = {}
    ways = ini.group("NAVIGATION") if "NAVIGATION" in ini else ini.top
    for kind in MERGED:
        said = _driven(ways, kind, named="NAVIGATION" in ini)
        given: DrivenSection = getattr(section, kind)
        own = {} if kind not in section.model_fields_set else given.model_dump(include=given.model_fields_set)
        found[kind] = type(given)(**{**said, **own})
    _take_least(ways, found, section)
    found["use_optimized_path"] = ways.flag("use_optimized_path", default=True)
    if not ways.flag("enable_try_recovery", default=True):
        found["recoveries"] = 0
    name = "PATHPLANNER_GENERAL" if "PATHPLANNER_GENERAL" in ini else "GENERAL"
    general = ini.group(name) if name in ini else ini.top
    found["image_hz"] = general.number("publish_map_image_Hz", section.image_hz, 0.0, 30.0, "Hz")
    general.take_texts(found, port_name, prefix="name")
    geometry = ini.group("ROBOT_GEOMETRY", needed=True)
    found["robot_radius"] = geometry.number("robot_radius", None, 0.01, 3.0, "m")
    ini.group("LOCALIZATION").take_texts(found, frame_name, base_frame="robot_frame_id", frame="map_frame_id")
    for group in ("LASER", "RECOVERY", "INTERNAL_NAVIGATOR", "MAP"):
        ini.group(group)
    ini.note_unread(STALE, OTHERS)
    return found


def _driven(ways: IniGroup, kind: str, *, named: bool) -> dict[str, float]:
    """The keys of one kind that are there; in files without groups the speeds of both."""
    made: dict[str, float] = {}
    for key, low, high, unit in (
        ("tolerance_lin", 0.001, 5.0, "m"),
        ("tolerance_ang", 0.01, 180.0, "deg"),
        *((f"{key}", low, high, unit) for key, low, high, unit in _SPEEDS),
    ):
        speed = not key.startswith("tolerance")
        name = f"{kind}_{key}" if named or not speed else key
        if ways.has(name):
            default = {"waypoint": 0.1, "goal": 0.05}[kind] if key == "tolerance_lin" else None
            made[key] = ways.number(name, default, low, high, unit)
    return made


def _take_least(ways: IniGroup, found: dict[str, Any], section: RobotPathPlannerSection) -> None:
    cells = (
        ways.number("min_waypoint_distance", -1.0, 0.0, 1000.0, "cells") if ways.has("min_waypoint_distance") else -1.0
    )
    found["min_waypoint_distance"] = section.min_waypoint_distance if cells <= 0 else cells * _CELL
    if cells > 0:
        ways.note(
            "min_waypoint_distance",
            f"upstream reads it and uses it nowhere; here it is {cells * _CELL:g} m (cells of {_CELL:g} m)",
        )
