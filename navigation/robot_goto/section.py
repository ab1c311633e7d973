"""The section ``modules.robot_goto``, the local navigator."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from bridge.config.sections.obstacles import ObstacleSection
from bridge.config.sections.section import (
    FLOOR,
    PORT_OR_NONE,
    FrameName,
    ModuleSection,
    Section,
    setting,
    subsection,
)

_DEGREES = "degrees per second"


class LaserPose(Section):
    """The pose of a YARP laser on the robot; the pose of a topic's laser is that of its frame."""

    x: float = setting(0.0, "Metres to the front (`laser_pos_x`).", ge=-10.0, le=10.0)
    y: float = setting(0.0, "Metres to the left (`laser_pos_y`).", ge=-10.0, le=10.0)
    theta: float = setting(0.0, "Degrees (`laser_pos_theta`).", ge=-360.0, le=360.0)


class RobotGotoSection(ModuleSection):
    """The local navigator. Default limits are those of R1."""

    ini: Path | None = setting(None, "A `robotGoto` file of an existing robot; keys set here override it.")
    frame: FrameName = setting("map", "The map's frame.")
    base_frame: FrameName = setting("base_link", "The robot's frame.")
    odom_frame: FrameName = setting(
        "odom", "The odometry's frame, in which it keeps what the laser saw; the map's frame if `/tf` does not have it."
    )
    scan: str = setting("/scan", 'The laser (`sensor_msgs/msg/LaserScan`); "": none.')
    laser_port: str = setting("", "A laser on YARP (`/cer/laser:o`) for `laser:i`; empty: none.", pattern=PORT_OR_NONE)
    laser_pose: LaserPose = subsection(LaserPose, "Pose of the YARP laser.")
    obstacles: tuple[ObstacleSection, ...] = setting(
        (),
        "Clouds and layers that show obstacles outside the laser's plane. It only drives while it receives them all.",
    )
    height: float = setting(1.3, "Height of the robot, metres; points of clouds above it are ignored.", gt=0.0, le=3.0)
    max_step: float = setting(0.05, "Steps up or down in clouds that its wheels climb, metres.", gt=0.0, le=1.0)
    floor: float | None = setting(None, FLOOR, ge=-3.0, le=3.0)
    laser_offset: float = setting(
        0.08,
        "Metres from the robot's center to the lasers of a scan that merges several: beams closer than this to corners"
        " and blind sectors are ignored.",
        ge=0.0,
        le=1.0,
    )
    cmd_vel: str = setting("/cmd_vel", "Topic of its commands (`Twist`).", min_length=1)
    prefix: str = setting("/robotGoto", "Prefix of its YARP ports; empty: none.", pattern=PORT_OR_NONE)
    period: float = setting(0.05, "Seconds between two commands.", ge=0.01, le=0.2)
    robot_is_holonomic: bool = setting(False, "Whether it can drive to the side.")
    robot_radius: float = setting(0.3, "Metres: the disc that the robot and its load fit into.", gt=0.0, le=3.0)
    max_beta_angle: float = setting(20.0, "Degrees off its path up to which it drives at full speed.", gt=0.0, le=180.0)
    lin_speed_gain: float = setting(0.6, "Metres per second for each metre to go.", gt=0.0, le=100.0)
    ang_speed_gain: float = setting(1.5, "Degrees per second for each degree to go.", gt=0.0, le=100.0)
    max_lin_speed: float = setting(0.3, "Metres per second.", gt=0.0, le=3.0)
    max_ang_speed: float = setting(30.0, f"{_DEGREES.capitalize()}.", gt=0.0, le=360.0)
    min_lin_speed: float = setting(0.02, "Metres per second.", ge=0.0, le=3.0)
    min_ang_speed: float = setting(2.0, f"{_DEGREES.capitalize()}.", ge=0.0, le=360.0)
    goal_tolerance_lin: float = setting(0.05, "Metres.", gt=0.0, le=10.0)
    goal_tolerance_ang: float = setting(2.0, "Degrees.", gt=0.0, le=180.0)
    max_lin_acc: float = setting(0.3, "Metres per second squared by which the base surely brakes.", gt=0.0, le=100.0)
    max_ang_acc: float = setting(80.0, f"{_DEGREES.capitalize()} squared.", gt=0.0, le=7200.0)
    reaction: float = setting(
        0.25, "Seconds from a scan until the wheels follow: delays of laser, network and base.", ge=0.05, le=2.0
    )
    enable_obstacles_emergency_stop: bool = setting(True, "Whether it stops and waits for obstacles in its path.")
    enable_dynamic_max_distance: bool = setting(True, "Whether it looks farther ahead at higher speed.")
    max_detection_distance: float = setting(1.2, "Metres ahead within which an obstacle stops it.", gt=0.0, le=10.0)
    min_detection_distance: float = setting(0.4, "The same at rest.", gt=0.0, le=10.0)
    max_waiting_time: float = setting(60.0, "Seconds that it waits before it gives up the goal.", ge=0.0, le=86400.0)
    enable_obstacles_avoidance: bool = setting(True, "Whether it drives around obstacles.")
    frontal_blind_angle: float = setting(
        25.0, "Degrees from the front; obstacles within do not count as lateral.", ge=0.0, le=180.0
    )
    speed_reduction_factor: float = setting(
        0.5, "Largest reduction of speed for lateral obstacles, as a share.", ge=0.0, le=0.95
    )
    enable_retreat: bool = setting(False, "Whether it backs off before it drives to a new goal.")
    retreat_duration: float = setting(0.3, "Seconds for which it backs off.", ge=0.0, le=2.0)
    laser_timeout: float = setting(0.5, "Seconds without a scan after which it stops.", gt=0.0, le=10.0)
    memory: float = setting(20.0, "Seconds for which it believes what the laser saw of a place.", ge=1.0, le=600.0)
    deadlock_time: float = setting(20.0, "Seconds without progress that count as a deadlock.", ge=1.0, le=3600.0)
    on_deadlock: Literal["abort", "pause"] = setting("abort", "In a deadlock: abort the goal, or wait until resumed.")
