"""The section ``modules.mapper3d``: the octree of clouds and depth images, and what of it the robot would touch."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from bridge.config.sections.section import (
    FLOOR,
    FrameName,
    ModuleSection,
    OptionalTopic,
    Section,
    TopicName,
    differ,
    matching,
    setting,
    subsection,
)

_Prefix = Annotated[str, matching(r"(?:/[A-Za-z0-9_.-]+)+", "is not a prefix of port names: write it as /mapper3D")]


class DepthSource(Section):
    """A depth camera."""

    image: TopicName = Field(description="Topic of its depth images (`sensor_msgs/msg/Image`, `32FC1` or `16UC1`).")
    info: TopicName = Field(description="Topic of its `sensor_msgs/msg/CameraInfo`, of the depth images' pixels.")


class LayerSection(Section):
    """The layer, a grid of the cells that the robot would touch."""

    topic: OptionalTopic = setting(
        "/mapper3d/layer",
        "Topic of the layer (`nav_msgs/msg/OccupancyGrid`, latched); the obstacles' heights are on the topic of this"
        ' name with the suffix `_heights`. "": none.',
    )
    period: float = setting(0.5, "Minimum seconds between two published changes of the layer.", ge=0.05, le=60)
    height: float = setting(
        1.5, "Height of the robot above the floor, metres; it passes under higher obstacles.", gt=0.0, le=10.0
    )
    width: float = setting(0.5, "Width of the robot, metres; it needs floor of this width.", gt=0.0, le=10.0)
    step: float = setting(0.02, "Highest step that its wheels climb, metres.", ge=0.0, le=1.0)
    margin: float = setting(0.05, "Free space that it needs above itself, metres.", ge=0.0, le=2.0)
    slope: float = setting(8.0, "Steepest ramp that it climbs, degrees.", ge=0.0, le=45.0)
    largest: float = setting(
        40.0, "Maximum length of the layer's sides, metres; the robot is in its middle.", ge=1.0, le=400.0
    )
    name: str = setting("layer", "Its name among the maps of the store.", min_length=1, max_length=64)


class Mapper3DSection(ModuleSection):
    """The mapper of space."""

    mapping: bool = setting(True, "Whether it maps from the start, or only after `start`.")
    map_name: str = setting("map", "The map's name among the store's 3D maps, for `save`.", min_length=1, max_length=64)
    load: str = setting(
        "", "Name of the store's 3D map to start with, unless `keep` has one; empty: none.", max_length=64
    )
    clouds: tuple[TopicName, ...] = setting((), "Topics of clouds (`sensor_msgs/msg/PointCloud2`).")
    depth: tuple[DepthSource, ...] = setting((), "Depth cameras.")
    pixels: int = setting(
        1, "Use every n-th pixel of each row and column of depth images: 2 uses a quarter of them.", ge=1, le=32
    )
    sync: float = setting(0.1, "Seconds by which an image and its `CameraInfo` may differ.", ge=0.0, le=10.0)
    resolution: float = setting(0.05, "Metres of a voxel.", ge=0.005, le=1.0)
    nearest: float = setting(0.1, "Metres within which points are left out, such as those of the robot.", ge=0.0, le=10)
    farthest: float = setting(4.0, "Metres to which rays are believed.", gt=0.0, le=100.0)
    forget_after: float = setting(
        0.0,
        "Seconds after which an obstacle is removed that its sensor no longer sees in plain view; 0: never.",
        ge=0.0,
    )
    memory: int = setting(256, "Megabytes (1,048,576 bytes) that the map may have.", ge=1, le=65536)
    when_full: Literal["stop", "forget"] = setting(
        "stop", "If the memory is full: `stop` ignores new voxels; `forget` drops those farthest from the sensor."
    )
    layer: LayerSection = subsection(LayerSection, "What the robot would touch, as a grid.")
    map_frame: FrameName = setting("map", "The map's frame. Without a localiser, `odom` maps by odometry only.")
    odom_frame: FrameName = setting("odom", "The odometry's frame.")
    base_frame: FrameName = setting("base_link", "The robot's frame.")
    floor: float | None = setting(None, FLOOR, ge=-3.0, le=3.0)
    octomap: bool = setting(
        True, "Whether it serves the topics and services of `octomap_server`, while others want them."
    )
    period: float = setting(2.0, "Seconds between two octomaps that are published, at least.", ge=0.1, le=600.0)
    keep: bool = setting(
        False, "Whether the map is kept in the module's state folder, and gone on with at the next start."
    )
    folder: Path | None = setting(
        None, "The only folder in which clients may save and load; default `maps` in the module's state folder."
    )
    prefix: _Prefix = setting("/mapper3D", "Prefix of its YARP ports.")

    @model_validator(mode="after")
    def _sees(self) -> Mapper3DSection:
        differ([*self.clouds, *(source.image for source in self.depth)], "two sources have the topic")
        if self.nearest >= self.farthest:
            raise ValueError(f"nearest ({self.nearest:g} m) is not nearer than farthest ({self.farthest:g} m)")
        return self
