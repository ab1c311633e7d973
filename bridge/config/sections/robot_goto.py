"""The section ``modules.robot_goto``: drives to a goal by laser and frames alone."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from bridge.config.sections.module import ModuleSection
from bridge.config.sections.section import Section

_PORT = r"^((/[^\s/\"'*()\[\]{}]+)+)?$"
_DEGREES = "degrees per second"


class LaserPose(Section):
    """Where a laser that is heard by a YARP port is on the robot; that of a topic is where its frame is."""

    x: float = Field(default=0.0, ge=-10.0, le=10.0, description="Metres to the front (`laser_pos_x`).")
    y: float = Field(default=0.0, ge=-10.0, le=10.0, description="Metres to the left (`laser_pos_y`).")
    theta: float = Field(default=0.0, ge=-360.0, le=360.0, description="Degrees (`laser_pos_theta`).")


class RobotGotoSection(ModuleSection):
    """The local navigator. Limits are those of R1 unless told otherwise."""

    ini: Path | None = Field(
        default=None,
        description="A `robotGoto` file of an existing robot, read as it is; what stands here beside it is stronger.",
    )
    frame: str = Field(default="map", min_length=1, max_length=100, description="The map's frame.")
    base_frame: str = Field(default="base_link", min_length=1, max_length=100, description="The robot's frame.")
    odom_frame: str = Field(
        default="odom",
        min_length=1,
        max_length=100,
        description="The odometry's frame, in which what the laser saw is kept; where it is not on `/tf`, the map's.",
    )
    scan: str = Field(default="/scan", description='The laser (`sensor_msgs/msg/LaserScan`); "" for none.')
    laser_port: str = Field(
        default="",
        pattern=_PORT,
        description="A laser on YARP (`/cer/laser:o`) to be connected to `laser:i`; empty for none.",
    )
    laser_pose: LaserPose = Field(default_factory=LaserPose, description="Where the laser on YARP is.")
    laser_offset: float = Field(
        default=0.08,
        ge=0.0,
        le=1.0,
        description="Metres from the robot's middle at which its lasers stand, where a scan is merged from several"
        " ones: beams are believed no nearer to corners and blind sectors than that.",
    )
    cmd_vel: str = Field(default="/cmd_vel", min_length=1, description="Topic of its commands (`Twist`).")
    prefix: str = Field(default="/robotGoto", pattern=_PORT, description="Begins its YARP ports; empty for none.")
    period: float = Field(default=0.05, ge=0.01, le=0.2, description="Seconds between two commands.")
    robot_is_holonomic: bool = Field(default=False, description="Whether it can drive to the side.")
    robot_radius: float = Field(
        default=0.3, gt=0.0, le=3.0, description="Metres; the disc that the robot fits into, whatever it carries."
    )
    max_beta_angle: float = Field(
        default=20.0, gt=0.0, le=180.0, description="Degrees from its way within which it drives at full speed."
    )
    lin_speed_gain: float = Field(
        default=0.6, gt=0.0, le=100.0, description="Metres per second for each metre that is left."
    )
    ang_speed_gain: float = Field(
        default=1.5, gt=0.0, le=100.0, description="Degrees per second for each degree that is left."
    )
    max_lin_speed: float = Field(default=0.3, gt=0.0, le=3.0, description="Metres per second.")
    max_ang_speed: float = Field(default=30.0, gt=0.0, le=360.0, description=f"{_DEGREES.capitalize()}.")
    min_lin_speed: float = Field(default=0.02, ge=0.0, le=3.0, description="Metres per second.")
    min_ang_speed: float = Field(default=2.0, ge=0.0, le=360.0, description=f"{_DEGREES.capitalize()}.")
    goal_tolerance_lin: float = Field(default=0.05, gt=0.0, le=10.0, description="Metres.")
    goal_tolerance_ang: float = Field(default=2.0, gt=0.0, le=180.0, description="Degrees.")
    max_lin_acc: float = Field(
        default=0.3, gt=0.0, le=100.0, description="Metres per second squared by which the base brakes for certain."
    )
    max_ang_acc: float = Field(default=80.0, gt=0.0, le=7200.0, description=f"{_DEGREES.capitalize()} squared.")
    reaction: float = Field(
        default=0.25,
        ge=0.05,
        le=2.0,
        description="Seconds from what the laser sees until the wheels follow: of the laser, the network and the base.",
    )
    enable_obstacles_emergency_stop: bool = Field(
        default=True, description="Whether it stops and waits for what comes into its way."
    )
    enable_dynamic_max_distance: bool = Field(
        default=True, description="Whether it looks the farther ahead the faster it goes."
    )
    max_detection_distance: float = Field(
        default=1.2, gt=0.0, le=10.0, description="Metres ahead within which an obstacle stops it."
    )
    min_detection_distance: float = Field(default=0.4, gt=0.0, le=10.0, description="The same at rest.")
    max_waiting_time: float = Field(
        default=60.0, ge=0.0, le=86400.0, description="Seconds that it waits before it gives the goal up."
    )
    enable_obstacles_avoidance: bool = Field(default=True, description="Whether it goes round obstacles.")
    frontal_blind_angle: float = Field(
        default=25.0, ge=0.0, le=180.0, description="Degrees from the front within which nothing is beside it."
    )
    speed_reduction_factor: float = Field(
        default=0.5, ge=0.0, le=0.95, description="The greatest share of its speed taken back beside obstacles."
    )
    enable_retreat: bool = Field(default=False, description="Whether it backs off before it drives to a new goal.")
    retreat_duration: float = Field(default=0.3, ge=0.0, le=2.0, description="Seconds for which it does.")
    laser_timeout: float = Field(
        default=0.5, gt=0.0, le=10.0, description="Seconds without a scan after which it stands still."
    )
    memory: float = Field(
        default=20.0, ge=1.0, le=600.0, description="Seconds for which it believes what the laser saw of a place."
    )
    deadlock_time: float = Field(
        default=20.0, ge=1.0, le=3600.0, description="Seconds without progress that are a deadlock."
    )
    on_deadlock: Literal["abort", "pause"] = Field(
        default="abort", description="What it does then: give the goal up, or wait until it is resumed."
    )
