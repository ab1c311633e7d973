"""The section ``modules.mapper2d``: a map from a laser and a pose that is given."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator

from bridge.config.sections.module import ModuleSection
from bridge.config.sections.values import ROS2_NAME

_PORT = r"^((/[^\s/\"'*()\[\]{}]+)+)?$"
_PREFIX = re.compile(r"(?:/[A-Za-z0-9_.-]+)+")


class Mapper2DSection(ModuleSection):
    """The mapper."""

    ini: Path | None = Field(
        default=None,
        description="A `mapper2D` file of an existing robot, read as it is; what stands here beside it is stronger.",
    )
    mapping: bool = Field(default=True, description="Whether it maps from the start, or only after `start`.")
    map_name: str = Field(default="map", min_length=1, max_length=64, description="The map's name in the store.")
    width: float = Field(default=10.0, gt=0.0, le=400.0, description="Metres at the start, about the robot.")
    height: float = Field(default=10.0, gt=0.0, le=400.0, description="Metres at the start, about the robot.")
    resolution: float = Field(default=0.05, ge=0.005, le=1.0, description="Metres of a cell.")
    largest: float = Field(default=100.0, gt=0.0, le=400.0, description="Metres that a side of the map grows to.")
    farthest: float = Field(default=10.0, gt=0.0, le=100.0, description="Metres beyond which a beam says nothing.")
    scan: str = Field(default="/scan", description='Topic of the laser (`sensor_msgs/msg/LaserScan`); "" for none.')
    laser_port: str = Field(
        default="",
        pattern=_PORT,
        description="A laser on YARP (`/cer/laser:o`) to be connected to `laser:i`; empty for none.",
    )
    laser: tuple[float, float, float] | None = Field(
        default=None,
        description="Where the laser is on the robot: metres, metres, degrees; empty: as `/tf` and `/tf_static` say,"
        " and in the robot's middle where it is on YARP.",
    )
    pose: Literal["tf", "topic", "port"] = Field(
        default="tf",
        description="Who says where the robot is: `tf`: the frames of all sides; `topic`: `pose_topic`; `port`: the"
        " YARP port `odometry:i`.",
    )
    pose_topic: str = Field(
        default="/localization/pose",
        description="Topic of the robot's pose: `Odometry`, `PoseStamped` or `PoseWithCovarianceStamped`.",
    )
    pose_port: str = Field(
        default="",
        pattern=_PORT,
        description="Who sends poses on YARP (`/baseControl/odometry:o`), to be connected to `odometry:i`; empty: it is"
        " connected by others.",
    )
    initial_pose: str = Field(
        default="",
        description="Topic (`PoseWithCovarianceStamped`) that says where the robot is now, as `initLoc` does;"
        ' "" for none.',
    )
    map_frame: str = Field(
        default="map",
        min_length=1,
        max_length=100,
        description="The map's frame. Without a localiser, `odom` maps by odometry alone.",
    )
    odom_frame: str = Field(default="odom", min_length=1, max_length=100, description="The odometry's frame.")
    base_frame: str = Field(default="base_link", min_length=1, max_length=100, description="The robot's frame.")
    topic: str = Field(
        default="/mapper2d/map",
        description='Topic of the map as it grows (`nav_msgs/msg/OccupancyGrid`), such as `/map`; "" for none.',
    )
    period: float = Field(
        default=1.0, ge=0.05, le=60.0, description="Seconds from one map that is published, and drawn, to the next."
    )
    folder: Path | None = Field(
        default=None,
        description="The only folder whose files clients may name when they save and load; by default `maps` in the"
        " module's part of the state folder.",
    )
    prefix: str = Field(default="/mapper2D", description="Begins its YARP ports.")

    @field_validator("prefix")
    @classmethod
    def _begins_ports(cls, value: str) -> str:
        if not _PREFIX.fullmatch(value):
            msg = f"{value!r} does not begin names of ports: it should look like /mapper2D"
            raise ValueError(msg)
        return value

    @field_validator("scan", "pose_topic", "initial_pose", "topic")
    @classmethod
    def _is_a_topic(cls, value: str) -> str:
        if value and not ROS2_NAME.fullmatch(value):
            msg = f"{value!r} is no topic: begin it with a slash; letters, digits and underscores make its parts"
            raise ValueError(msg)
        return value
