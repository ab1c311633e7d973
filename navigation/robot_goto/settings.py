"""What RobotGoto drives by, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bridge.config.sections.robot_goto import RobotGotoSection
from navigation.ini import laid_under
from navigation.robot_goto.inifile import with_file


@dataclass(frozen=True)
class Settings:
    """Upstream's parameters by upstream's names, and ours. Metres, radians, seconds.

    Attributes:
        holonomic: whether it can drive to the side (``robot_is_holonomic``).
        max_beta_angle: it drives off once it faces its way within this.
        ang_speed_gain: (rad/s) / rad.
        lin_speed_gain: (m/s) / m.
        max_lin_speed: m/s.
        max_ang_speed: rad/s.
        min_lin_speed: m/s.
        min_ang_speed: rad/s.
        goal_tolerance_lin: a goal is reached within it.
        goal_tolerance_ang: the same of its heading.
        robot_radius: of the disc that the robot fits into.
        obstacle_stop: whether it stops and waits before obstacles ahead (``enable_obstacles_emergency_stop``).
        dynamic_distance: whether it looks the farther ahead the faster it goes (``enable_dynamic_max_distance``).
        max_waiting_time: after so long before an obstacle the goal fails.
        max_detection_distance: how far ahead obstacles are looked for.
        min_detection_distance: the same at rest.
        avoidance: whether it goes round obstacles (``enable_obstacles_avoidance``).
        frontal_blind_angle: obstacles within it of its front do not count as beside it.
        speed_reduction_factor: the greatest share of its speed that it takes back beside obstacles.
        retreat: whether it backs off before a new goal (``enable_retreat``).
        retreat_duration: for how long; at most 2 s.
        linear_acceleration: what the base speeds up and brakes by, m/s2.
        angular_acceleration: the same, rad/s2.
        reaction: how long a command, or what the laser sees, takes until the wheels follow it.
        laser_offset: how far from the robot's middle its lasers stand, where several are merged into one, metres.
        laser_timeout: without a scan for so long the laser is silent.
        memory: how long what the laser saw of a place is believed.
        deadlock_time: without progress for so long it is in a deadlock.
        on_deadlock: what it does then: ``abort`` the goal, or ``pause`` until it is told to resume.
    """

    holonomic: bool = False
    max_beta_angle: float = math.radians(20.0)
    ang_speed_gain: float = 1.5
    lin_speed_gain: float = 0.6
    max_lin_speed: float = 0.3
    max_ang_speed: float = math.radians(30.0)
    min_lin_speed: float = 0.02
    min_ang_speed: float = math.radians(2.0)
    goal_tolerance_lin: float = 0.05
    goal_tolerance_ang: float = math.radians(2.0)
    robot_radius: float = 0.3
    obstacle_stop: bool = True
    dynamic_distance: bool = True
    max_waiting_time: float = 60.0
    max_detection_distance: float = 1.2
    min_detection_distance: float = 0.4
    avoidance: bool = True
    frontal_blind_angle: float = math.radians(25.0)
    speed_reduction_factor: float = 0.5
    retreat: bool = False
    retreat_duration: float = 0.3
    linear_acceleration: float = 0.3
    angular_acceleration: float = math.radians(80.0)
    reaction: float = 0.25
    laser_offset: float = 0.08
    laser_timeout: float = 0.5
    memory: float = 20.0
    deadlock_time: float = 20.0
    on_deadlock: str = "abort"


def settings_of(section: RobotGotoSection) -> tuple[Settings, RobotGotoSection, list[str]]:
    """What a section and the file that it names say.

    Returns:
        the settings; the section with the file's values; what is odd in the file, each ``file:line: ...``.

    Raises:
        RuntimeError: the file is not there or cannot be used; the text says where and why.
    """
    section, notes = laid_under(section, section.ini, with_file)
    made = Settings(
        holonomic=section.robot_is_holonomic,
        max_beta_angle=math.radians(section.max_beta_angle),
        ang_speed_gain=section.ang_speed_gain,
        lin_speed_gain=section.lin_speed_gain,
        max_lin_speed=section.max_lin_speed,
        max_ang_speed=math.radians(section.max_ang_speed),
        min_lin_speed=min(section.min_lin_speed, section.max_lin_speed),
        min_ang_speed=math.radians(min(section.min_ang_speed, section.max_ang_speed)),
        goal_tolerance_lin=section.goal_tolerance_lin,
        goal_tolerance_ang=math.radians(section.goal_tolerance_ang),
        robot_radius=section.robot_radius,
        obstacle_stop=section.enable_obstacles_emergency_stop,
        dynamic_distance=section.enable_dynamic_max_distance,
        max_waiting_time=section.max_waiting_time,
        max_detection_distance=section.max_detection_distance,
        min_detection_distance=section.min_detection_distance,
        avoidance=section.enable_obstacles_avoidance,
        frontal_blind_angle=math.radians(section.frontal_blind_angle),
        speed_reduction_factor=section.speed_reduction_factor,
        retreat=section.enable_retreat,
        retreat_duration=section.retreat_duration,
        linear_acceleration=section.max_lin_acc,
        angular_acceleration=math.radians(section.max_ang_acc),
        reaction=section.reaction,
        laser_offset=section.laser_offset,
        laser_timeout=section.laser_timeout,
        memory=section.memory,
        deadlock_time=section.deadlock_time,
        on_deadlock=section.on_deadlock,
    )
    return made, section, notes
