"""The sections ``store``, ``modules.map2d_server`` and ``modules.mapper2d``: where maps are kept, served and made."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from bridge.config.sections.section import (
    PORT_OR_NONE,
    Enabled,
    FrameName,
    ModuleSection,
    OptionalPort,
    OptionalTopic,
    PortName,
    Section,
    TopicName,
    differ,
    matching,
    setting,
)


class StoreSection(Section):
    """The store of maps, locations, areas, paths, objects and links on the hub; see docs/navigation/maps.md."""

    enabled: Enabled = setting("auto", "Whether this daemon keeps a copy; `auto`: if a module uses it.")
    maps: Path | None = setting(
        None,
        "A collection of maps (`maps_collection.ini`) or one map (`.map`, `.yaml`), imported at start. The import"
        " neither replaces nor restores maps that the store has or has deleted.",
    )
    locations: Path | None = setting(
        None, "A file of locations, areas, paths and objects (`locations.ini`), imported in the same way."
    )
    keys: int = setting(10_000, "Maximum number of values in the store.", ge=1, le=100_000)
    megabytes: int = setting(1024, "Megabytes (1,048,576 bytes) of all values together.", ge=1, le=1 << 20)
    deleted: int = setting(10_000, "Deleted names that it remembers, the latest ones.", ge=0, le=100_000)
    deleted_days: float = setting(
        30.0, "Days for which it does. A machine away for longer brings deleted values back.", gt=0, le=3650
    )


_PointName = Annotated[
    str,
    matching(
        r"[A-Za-z0-9_. -]{0,64}", "cannot begin a location's name: use letters, digits, blanks and the signs . _ -"
    ),
]


class TakenMap(Section):
    """Maps of a topic that are taken into the store."""

    topic: TopicName = Field(description="The topic (`nav_msgs/msg/OccupancyGrid`) on the hub: `/map`.")
    name: str = Field(min_length=1, max_length=64, description="The map's name in the store.")
    use: bool = setting(True, "Whether each map that arrives becomes the current one.")
    period: float = setting(2.0, "Seconds between two maps that are taken, at least.", ge=0.0, le=3600.0)


class Map2DServerSection(ModuleSection):
    """The map server."""

    ports: tuple[PortName, ...] = setting(
        ("/map2D_nws_yarp/rpc", "/mapServer/rpc"), "YARP ports that answer map clients (`map2D_nwc_yarp`)."
    )
    command_port: OptionalPort = setting(
        "/map2D_server/command", 'YARP port that takes the words `current`, `use NAME` and `help`; "": none.'
    )
    folder: Path | None = setting(
        None, "The only folder in which clients may save and load; default `maps` in the module's state folder."
    )
    current: str = setting("", "The current map until a client chooses one.")
    frame: FrameName = setting("map", "The frame of all maps and markers.")
    take: tuple[TakenMap, ...] = setting(
        (), "Maps of other servers and mappers for the store. The server does not publish `/map` that it takes."
    )
    clicked_point: _PointName = setting(
        "", 'Points of `/clicked_point` become locations of the current map, with this name and a number; "": none do.'
    )

    @model_validator(mode="after")
    def _nothing_comes_twice(self) -> Map2DServerSection:
        differ([*self.ports, *filter(None, [self.command_port])], "two keys name the port")
        differ([taken.topic for taken in self.take], "two entries of 'take' name the topic")
        differ([taken.name for taken in self.take], "two entries of 'take' name the map")
        return self

    def taken_as(self, topic: str) -> str:
        """The map's name in the store for maps of a topic; "" where the store does not take them."""
        return next((taken.name for taken in self.take if taken.topic == topic), "") if self.enabled else ""


_Prefix = Annotated[str, matching(r"(?:/[A-Za-z0-9_.-]+)+", "is not a prefix of port names: write it as /mapper2D")]


class Mapper2DSection(ModuleSection):
    """The mapper."""

    ini: Path | None = setting(None, "A `mapper2D` file of an existing robot; keys set here override it.")
    mapping: bool = setting(True, "Whether it maps from the start, or only after `start`.")
    map_name: str = setting("map", "The map's name in the store.", min_length=1, max_length=64)
    width: float = setting(10.0, "Metres at the start, around the robot.", gt=0.0, le=400.0)
    height: float = setting(10.0, "Metres at the start, around the robot.", gt=0.0, le=400.0)
    resolution: float = setting(0.05, "Metres of a cell.", ge=0.005, le=1.0)
    largest: float = setting(100.0, "Metres to which a side of the map may grow.", gt=0.0, le=400.0)
    farthest: float = setting(10.0, "Metres beyond which beams are ignored.", gt=0.0, le=100.0)
    scan: OptionalTopic = setting("/scan", 'Topic of the laser (`sensor_msgs/msg/LaserScan`); "": none.')
    laser_port: str = setting("", "A laser on YARP (`/cer/laser:o`) for `laser:i`; empty: none.", pattern=PORT_OR_NONE)
    laser: tuple[float, float, float] | None = setting(
        None, "Pose on the robot: metres, metres, degrees; empty: by `/tf` and `/tf_static`, on YARP the middle."
    )
    pose: Literal["tf", "topic", "port"] = setting(
        "tf", "Source of the pose: `tf`: the frames of all sides; `topic`: `pose_topic`; `port`: `odometry:i` on YARP."
    )
    pose_topic: OptionalTopic = setting(
        "/localization/pose", "Topic of the pose: `Odometry`, `PoseStamped` or `PoseWithCovarianceStamped`."
    )
    pose_port: str = setting(
        "", "Poses (`/baseControl/odometry:o`) for `odometry:i`; empty: none.", pattern=PORT_OR_NONE
    )
    initial_pose: OptionalTopic = setting("", 'Topic that sets the pose (`PoseWithCovarianceStamped`); "": none.')
    map_frame: FrameName = setting(
        "map", "The map's frame. Without a localiser, `odom` maps by odometry only.", min_length=1, max_length=100
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
    prefix: _Prefix = setting("/mapper2D", "Prefix of its YARP ports.")
