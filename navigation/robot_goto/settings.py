"""Reads ``robotGoto`` files of existing robots, of robotology/navigation's releases since 2016."""

from __future__ import annotations

from typing import Any

from navigation.ini import Ini, IniGroup, frame_name, port_name
from navigation.robot_goto.section import LaserPose, RobotGotoSection

_TRAJECTORY = (
    ("max_beta_angle", 5.0, 0.1, 180.0, "deg"),
    ("ang_speed_gain", 0.05, 0.001, 100.0, "(deg/s)/deg"),
    ("lin_speed_gain", 0.1, 0.001, 100.0, "(m/s)/m"),
    ("max_lin_speed", 0.9, 0.01, 3.0, "m/s"),
    ("max_ang_speed", 10.0, 0.5, 360.0, "deg/s"),
    ("min_lin_speed", 0.0, 0.0, 3.0, "m/s"),
    ("min_ang_speed", 0.0, 0.0, 360.0, "deg/s"),
    ("goal_tolerance_lin", 0.05, 0.001, 5.0, "m"),
    ("goal_tolerance_ang", 0.6, 0.05, 180.0, "deg"),
)
_STOP = (
    ("max_waiting_time", 60.0, 0.0, 86400.0, "s"),
    ("max_detection_distance", 1.5, 0.05, 10.0, "m"),
    ("min_detection_distance", 0.4, 0.05, 10.0, "m"),
)
_AVOIDANCE = (("frontal_blind_angle", 25.0, 0.0, 180.0, "deg"),)

OTHERS = frozenset({"localizationServer_name", "localization_server_name"})
"""Keys that name YARP's servers, instead of which Midspan uses the hub."""

STALE = {
    ("ROBOT_TRAJECTORY", "max_gamma_angle"): "upstream ignores it, too; use goal_tolerance_ang",
    ("OBSTACLES_AVOIDANCE", "speed_reduction_factor"): "upstream ignores it, too; set it in modules.robot_goto",
    ("ROBOTGOTO_GENERAL", "autoconnect"): "laser_port is always connected",
} | {
    (group, key): "neither upstream nor Midspan computes forces from it"
    for group in ("OBSTACLES_AVOIDANCE", "OBSTACLES_EMERGENCY_STOP")
    for key in ("max_obstacle_distance", "w_f", "w_t", "max_obst_distance")
}
"""Keys that real files contain and that have no effect, with the reason."""


def read_file(_section: RobotGotoSection, ini: Ini) -> dict[str, Any]:
    """Return the fields that a file sets; see `navigation.ini.laid_under`."""
    fields: dict[str, Any] = {}
    general = ini.group("ROBOTGOTO_GENERAL") if "ROBOTGOTO_GENERAL" in ini else ini.top
    fields["prefix"] = port_name(general.text("name", "/robotGoto"))
    trajectory = ini.group("ROBOT_TRAJECTORY", needed=True)
    fields["robot_is_holonomic"] = trajectory.flag("robot_is_holonomic", default=False)
    _read_numbers(trajectory, _TRAJECTORY, fields)
    _read_geometry(ini, fields)
    _read_obstacles(ini, fields)
    ini.group("LOCALIZATION").add_texts(fields, frame_name, base_frame="robot_frame_id", frame="map_frame_id")
    ini.group("LASER").add_texts(fields, port_name, laser_port="laser_port")
    ini.note_unread(STALE, OTHERS)
    return fields


def _read_numbers(
    group: IniGroup, keys: tuple[tuple[str, float, float, float, str], ...], fields: dict[str, Any]
) -> None:
    for key, default, low, high, unit in keys:
        fields[key] = group.number(key, default, low, high, unit)


def _read_geometry(ini: Ini, fields: dict[str, Any]) -> None:
    geometry = ini.group("ROBOT_GEOMETRY", needed=True)
    fields["robot_radius"] = geometry.number("robot_radius", None, 0.01, 3.0, "m")
    fields["laser_pose"] = LaserPose(
        x=geometry.number("laser_pos_x", 0.0, -10.0, 10.0, "m"),
        y=geometry.number("laser_pos_y", 0.0, -10.0, 10.0, "m"),
        theta=geometry.number("laser_pos_theta", 0.0, -360.0, 360.0, "deg"),
    )


def _read_obstacles(ini: Ini, fields: dict[str, Any]) -> None:
    stop = ini.group("OBSTACLES_EMERGENCY_STOP")
    for key in ("enable_obstacles_emergency_stop", "enable_dynamic_max_distance"):
        fields[key] = stop.flag(key, default=False)
    _read_numbers(stop, _STOP, fields)
    avoidance = ini.group("OBSTACLES_AVOIDANCE")
    fields["enable_obstacles_avoidance"] = avoidance.flag("enable_obstacles_avoidance", default=False)
    _read_numbers(avoidance, _AVOIDANCE, fields)
    retreat = ini.group("RETREAT_OPTION")
    fields["enable_retreat"] = retreat.flag("enable_retreat", default=False)
    fields["retreat_duration"] = retreat.number("retreat_duration", 0.3, 0.0, 2.0, "s")
