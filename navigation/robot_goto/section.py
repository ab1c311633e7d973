"""The section ``modules.robot_goto``, the local navigator."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from typing_extensions import override

from bridge.config.sections.obstacles import ObstacleSection
from bridge.config.sections.section import (
    FLOOR,
    PORT_OR_NONE,
    FrameName,
    MapSource,
    OptionalTopic,
    Section,
    TopicName,
    setting,
    subsection,
)
from bridge.messages.velocities import VELOCITIES
from navigation.file_section import FileSection

_DEGREES = "degrees per second"


class LaserPose(Section):
    """The pose of a YARP laser on the robot; a laser on a topic has the pose of its frame on `/tf`."""

    x: float = setting(0.0, "Meters to the front (`laser_pos_x`).", ge=-10.0, le=10.0)
    y: float = setting(0.0, "Meters to the left (`laser_pos_y`).", ge=-10.0, le=10.0)
    theta: float = setting(0.0, "Degrees (`laser_pos_theta`).", ge=-360.0, le=360.0)


class RobotGotoSection(FileSection):
    """The local navigator. Default limits are those of R1."""

    reader: ClassVar[str] = "navigation.robot_goto.settings:read_file"

    ini: Path | None = setting(None, "A `robotGoto` file of an existing robot; keys set here override it.")
    frame: FrameName = setting("map", "The map's frame.")
    base_frame: FrameName = setting("base_link", "The robot's frame.")
    odom_frame: FrameName = setting(
        "odom", "The odometry's frame, in which scans are remembered; the map's frame if `/tf` does not have it."
    )
    keep_out_map: MapSource | None = setting(
        None,
        "The map whose keep-out cells and areas the robot does not enter: `store` (its current map), or a topic"
        " (`nav_msgs/msg/OccupancyGrid`); empty: none, and the robot waits for obstacles beside keep-out cells.",
    )
    scan: OptionalTopic = setting("/scan", 'The laser (`sensor_msgs/msg/LaserScan`); "": none.')
    laser_port: str = setting("", "A laser on YARP (`/cer/laser:o`) for `laser:i`; empty: none.", pattern=PORT_OR_NONE)
    laser_pose: LaserPose = subsection(LaserPose, "Pose of the YARP laser.")
    obstacles: tuple[ObstacleSection, ...] = setting(
        (),
        "Clouds and layers that show obstacles outside the laser's plane. The robot drives only while all arrive.",
    )
    height: float = setting(1.3, "Height of the robot, meters; points of clouds above it are ignored.", gt=0.0, le=3.0)
    max_step: float = setting(
        0.05, "Height of steps in clouds, up or down, that the wheels can climb, meters.", gt=0.0, le=1.0
    )
    floor: float | None = setting(None, FLOOR, ge=-3.0, le=3.0)
    laser_offset: float = setting(
        0.08,
        "Meters from the robot's center to the lasers of a scan that merges several: beams closer than this to corners"
        " and blind sectors are ignored.",
        ge=0.0,
        le=1.0,
    )
    cmd_vel: TopicName = setting("/cmd_vel", "Topic of the velocity commands, in the form of `navigation.stamped`.")
    prefix: str = setting("/robotGoto", "Prefix of the YARP ports; empty: none.", pattern=PORT_OR_NONE)
    period: float = setting(0.05, "Seconds between two commands.", ge=0.01, le=0.2)
    robot_is_holonomic: bool = setting(False, "Whether the robot can drive sideways.")
    robot_radius: float = setting(0.3, "Radius in meters of a disc around the robot and its load.", gt=0.0, le=3.0)
    max_beta_angle: float = setting(
        20.0, "Angle between front and path up to which the robot drives at full speed, degrees.", gt=0.0, le=180.0
    )
    lin_speed_gain: float = setting(1.0, "Meters per second for each meter to go.", gt=0.0, le=100.0)
    ang_speed_gain: float = setting(2.0, "Degrees per second for each degree to go.", gt=0.0, le=100.0)
    max_lin_speed: float = setting(0.3, "Meters per second.", gt=0.0, le=3.0)
    max_ang_speed: float = setting(30.0, f"{_DEGREES.capitalize()}.", gt=0.0, le=360.0)
    min_lin_speed: float = setting(0.02, "Meters per second.", ge=0.0, le=3.0)
    min_ang_speed: float = setting(2.0, f"{_DEGREES.capitalize()}.", ge=0.0, le=360.0)
    goal_tolerance_lin: float = setting(0.05, "Meters.", gt=0.0, le=10.0)
    goal_tolerance_ang: float = setting(2.0, "Degrees.", gt=0.0, le=180.0)
    max_lin_acc: float = setting(
        0.3, "Deceleration that the base reaches for certain, meters per second squared.", gt=0.0, le=100.0
    )
    max_ang_acc: float = setting(80.0, f"{_DEGREES.capitalize()} squared.", gt=0.0, le=7200.0)
    reaction: float = setting(
        0.25, "Seconds from a scan until the wheels react: the delays of laser, network and base.", ge=0.05, le=2.0
    )
    enable_obstacles_emergency_stop: bool = setting(True, "Whether the robot stops for obstacles in its path.")
    enable_dynamic_max_distance: bool = setting(
        True, "Whether the distance at which obstacles stop the robot increases with its speed."
    )
    max_detection_distance: float = setting(
        1.2, "Meters ahead within which an obstacle stops the robot at full speed.", gt=0.0, le=10.0
    )
    min_detection_distance: float = setting(0.4, "The same distance at rest, in meters.", gt=0.0, le=10.0)
    max_waiting_time: float = setting(
        60.0, "Seconds for which the robot waits before the goal is aborted.", ge=0.0, le=86400.0
    )
    enable_obstacles_avoidance: bool = setting(True, "Whether the robot drives around obstacles.")
    frontal_blind_angle: float = setting(
        25.0,
        "Degrees to each side of the direction of travel; obstacles within this angle do not count as lateral.",
        ge=0.0,
        le=180.0,
    )
    speed_reduction_factor: float = setting(
        0.0,
        "Largest reduction of speed for lateral obstacles, as a share; with 0, speed only depends on whether the robot"
        " can stop in time.",
        ge=0.0,
        le=0.95,
    )
    enable_retreat: bool = setting(False, "Whether the robot backs off before it drives to a new goal.")
    retreat_duration: float = setting(0.3, "Seconds for which the robot backs off.", ge=0.0, le=2.0)
    laser_timeout: float = setting(0.5, "Seconds without a scan after which the robot stops.", gt=0.0, le=10.0)
    memory: float = setting(20.0, "Seconds for which the laser's observation of a cell is valid.", ge=1.0, le=600.0)
    deadlock_time: float = setting(20.0, "Seconds without progress that count as a deadlock.", ge=1.0, le=3600.0)
    on_deadlock: Literal["abort", "pause"] = setting("abort", "In a deadlock: abort the goal, or wait until resumed.")

    @property
    @override
    def driven(self) -> tuple[tuple[str, str], ...]:
        return tuple((self.cmd_vel, kind) for kind in VELOCITIES)
