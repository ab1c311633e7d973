"""The section ``modules.mapper3d``: an octree of clouds and depth images, and a layer of what the robot would touch."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from typing_extensions import override

from bridge.config.sections.section import (
    FLOOR,
    FrameName,
    Mistake,
    ModuleSection,
    OptionalTopic,
    Section,
    TopicName,
    matching,
    repeated,
    setting,
    subsection,
)

_Prefix = Annotated[str, matching(r"(?:/[A-Za-z0-9_.-]+)+", "is not a prefix of port names: write it as /mapper3D")]


class DepthSource(Section):
    """A depth camera."""

    image: TopicName = Field(
        description="Topic of the camera's depth images (`sensor_msgs/msg/Image`, `32FC1` or `16UC1`)."
    )
    info: TopicName = Field(description="Topic of the `sensor_msgs/msg/CameraInfo` for the depth images' pixels.")


class LayerSection(Section):
    """The layer, a grid of the cells that the robot would touch."""

    topic: OptionalTopic = setting(
        "/mapper3d/layer",
        "Topic of the layer (`nav_msgs/msg/OccupancyGrid`, latched). The heights of its obstacles are on a topic with"
        ' the same name and the suffix `_heights`. "": none.',
    )
    period: float = setting(0.5, "Minimum seconds between two published changes of the layer.", ge=0.05, le=60)
    height: float = setting(
        1.5, "Height of the robot above the floor, meters; the robot passes under higher obstacles.", gt=0.0, le=10.0
    )
    width: float = setting(0.5, "Width of the robot, and of the floor that it needs, meters.", gt=0.0, le=10.0)
    step: float = setting(0.02, "Highest step that the robot's wheels can climb, meters.", ge=0.0, le=1.0)
    margin: float = setting(0.05, "Free space that the robot needs above itself, meters.", ge=0.0, le=2.0)
    slope: float = setting(8.0, "Steepest ramp that the robot can climb, degrees.", ge=0.0, le=45.0)
    largest: float = setting(
        40.0, "Maximum length of the layer's sides, meters; the robot is in the middle of the layer.", ge=1.0, le=400.0
    )
    name: str = setting("layer", "The layer's name among the maps of the store.", min_length=1, max_length=64)


class Mapper3DSection(ModuleSection):
    """The 3D mapper, which builds an octree from point clouds and depth images."""

    mapping: bool = setting(True, "Whether mapping starts with the module, or only upon the command `start`.")
    map_name: str = setting(
        "map", "Name under which `save` stores the map among the store's 3D maps.", min_length=1, max_length=64
    )
    load: str = setting(
        "", "Name of the store's 3D map to start with, unless `keep` has one; empty: none.", max_length=64
    )
    clouds: tuple[TopicName, ...] = setting((), "Topics of clouds (`sensor_msgs/msg/PointCloud2`).")
    depth: tuple[DepthSource, ...] = setting((), "Depth cameras.")
    pixels: int = setting(
        1, "Use every n-th pixel of each row and column of depth images: 2 uses a quarter of them.", ge=1, le=32
    )
    sync: float = setting(
        0.1, "Seconds by which the stamps of an image and its `CameraInfo` may differ.", ge=0.0, le=10.0
    )
    resolution: float = setting(0.05, "Side of a voxel, meters.", ge=0.005, le=1.0)
    nearest: float = setting(
        0.1, "Points nearer than this are ignored, such as those on the robot; meters.", ge=0.0, le=10
    )
    farthest: float = setting(4.0, "Rays are used only up to this distance, meters.", gt=0.0, le=100.0)
    forget_after: float = setting(
        0.0,
        "Seconds without a hit after which an obstacle in plain view of its sensor is removed; 0: never.",
        ge=0.0,
    )
    memory: int = setting(256, "Size limit of the map, megabytes (1,048,576 bytes).", ge=1, le=65536)
    when_full: Literal["stop", "forget"] = setting(
        "stop", "When `memory` is full: `stop` ignores new voxels; `forget` drops the voxels farthest from the sensor."
    )
    layer: LayerSection = subsection(LayerSection, "The grid of the cells that the robot would touch.")
    map_frame: FrameName = setting(
        "map", "The map's frame. Without a localizer, set it to `odom` to map by odometry only."
    )
    odom_frame: FrameName = setting("odom", "The odometry's frame.")
    base_frame: FrameName = setting("base_link", "The robot's frame.")
    floor: float | None = setting(None, FLOOR, ge=-3.0, le=3.0)
    octomap: bool = setting(
        True, "Whether to offer the topics and services of `octomap_server` too, while other nodes use them."
    )
    period: float = setting(2.0, "Minimum seconds between two published octomaps.", ge=0.1, le=600.0)
    keep: bool = setting(
        False, "Whether the map is stored in the module's state folder, and continued at the next start."
    )
    folder: Path | None = setting(
        None, "The only folder in which clients may save and load; default `maps` in the module's state folder."
    )
    prefix: _Prefix = setting("/mapper3D", "Prefix of the module's YARP ports.")

    @override
    def mistakes(self, config: Any) -> Iterator[Mistake]:
        if twice := repeated([*self.clouds, *(source.image for source in self.depth)]):
            yield (), f"two sources have the topic {twice}"
        if self.nearest >= self.farthest:
            yield ("nearest",), f"{self.nearest:g} m is not nearer than farthest ({self.farthest:g} m)"
