"""The section ``modules.mapper2d``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from typing_extensions import override

from bridge.config.sections.section import (
    PORT_OR_NONE,
    FrameName,
    Mistake,
    OptionalTopic,
    matching,
    setting,
)
from navigation.file_section import FileSection

MOST_CELLS = 1 << 26
"""Maps with more cells can be neither published nor stored (`yarp_compat.dev.mapflag.MAX_CELLS`)."""

_Prefix = Annotated[str, matching(r"(?:/[A-Za-z0-9_.-]+)+", "is not a prefix of port names: write it as /mapper2D")]


class Mapper2DSection(FileSection):
    """The mapper, which builds a 2D map from laser scans."""

    reader: ClassVar[str] = "navigation.mapper2d.settings:read_file"

    ini: Path | None = setting(None, "A `mapper2D` file of an existing robot; keys set here override it.")
    mapping: bool = setting(True, "Whether mapping starts with the module, or only upon the command `start`.")
    map_name: str = setting("map", "The map's name in the store.", min_length=1, max_length=64)
    width: float = setting(10.0, "Initial width of the map, with the robot in its middle, meters.", gt=0.0, le=400.0)
    height: float = setting(10.0, "Initial height of the map, with the robot in its middle, meters.", gt=0.0, le=400.0)
    resolution: float = setting(0.05, "Side of a cell, meters.", ge=0.005, le=1.0)
    largest: float = setting(100.0, "Length to which each side of the map may grow, meters.", gt=0.0, le=400.0)
    farthest: float = setting(10.0, "Beams are ignored beyond this distance, meters.", gt=0.0, le=100.0)
    scan: OptionalTopic = setting("/scan", 'Topic of the laser (`sensor_msgs/msg/LaserScan`); "": none.')
    laser_port: str = setting("", "A laser on YARP (`/cer/laser:o`) for `laser:i`; empty: none.", pattern=PORT_OR_NONE)
    laser: tuple[float, float, float] | None = setting(
        None,
        "Pose of the laser on the robot: meters, meters, degrees; empty: from `/tf`, on YARP the robot's center.",
    )
    pose: Literal["slam", "tf", "topic", "port"] = setting(
        "slam",
        "Source of the pose: `slam` (the scans, with the odometry on `/tf` as a first guess), `tf` (the frames of all"
        " sides), `topic` (`pose_topic`) or `port` (`odometry:i` on YARP). With `map_frame` equal to"
        " `odom_frame`, `slam` means `tf`.",
    )
    publish_tf: bool = setting(
        True,
        "With `slam`: whether to publish the transform from map to odometry on `/tf`; never while a localizer is"
        " active.",
    )
    tf_tolerance: float = setting(
        0.5,
        "With `slam`: seconds by which that transform's stamp is ahead, as with `localization_server`.",
        ge=0.0,
        le=2.0,
    )
    pose_topic: OptionalTopic = setting(
        "/localization/pose", "Topic of the pose: `Odometry`, `PoseStamped` or `PoseWithCovarianceStamped`."
    )
    pose_port: str = setting(
        "", "YARP port of poses (`/baseControl/odometry:o`) for `odometry:i`; empty: none.", pattern=PORT_OR_NONE
    )
    initial_pose: OptionalTopic = setting("", 'Topic that sets the pose (`PoseWithCovarianceStamped`); "": none.')
    map_frame: FrameName = setting(
        "map",
        "The map's frame; set it to `odom` to map by odometry only.",
        min_length=1,
        max_length=100,
    )
    odom_frame: FrameName = setting("odom", "The odometry's frame.")
    base_frame: FrameName = setting("base_link", "The robot's frame.")
    topic: OptionalTopic = setting(
        "/mapper2d/map", 'Topic of the growing map (`nav_msgs/msg/OccupancyGrid`), such as `/map`; "": none.'
    )
    period: float = setting(1.0, "Seconds between two published and drawn maps.", ge=0.05, le=60.0)
    folder: Path | None = setting(
        None, "The only folder in which clients may save and load; default `maps` in the module's state folder."
    )
    prefix: _Prefix = setting("/mapper2D", "Prefix of the module's YARP ports.")

    @override
    def misfits(self) -> Iterator[Mistake]:
        cells = self.width / self.resolution * self.height / self.resolution
        if cells > MOST_CELLS:
            text = (
                f"a map of {self.width:g} by {self.height:g} m with a resolution of {self.resolution:g} m has"
                f" {cells:.0f} cells, more than {MOST_CELLS}: reduce its initial size, or use larger cells"
            )
            yield ("resolution",), text

    @property
    def slam(self) -> bool:
        """Whether the poses are derived from the scans."""
        return self.pose == "slam" and self.map_frame.lstrip("/") != self.odom_frame.lstrip("/")
