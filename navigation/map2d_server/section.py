"""The section ``modules.map2d_server``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from typing_extensions import override

from bridge.config.sections.section import (
    FrameName,
    Mistake,
    ModuleSection,
    OptionalPort,
    PortName,
    Section,
    TopicName,
    matching,
    repeated,
    setting,
)

_PointName = Annotated[
    str,
    matching(
        r"[A-Za-z0-9_. -]{0,64}", "cannot begin a location's name: use letters, digits, blanks and the signs . _ -"
    ),
]


class TakenMap(Section):
    """Maps from a topic that are imported into the store."""

    topic: TopicName = Field(description="The topic (`nav_msgs/msg/OccupancyGrid`) on the hub: `/map`.")
    name: str = Field(min_length=1, max_length=64, description="The map's name in the store.")
    use: bool = setting(True, "Whether each map that arrives becomes the current one.")
    period: float = setting(2.0, "Minimum seconds between two imported maps.", ge=0.0, le=3600.0)


class Map2DServerSection(ModuleSection):
    """The server of the store's maps and places."""

    ports: tuple[PortName, ...] = setting(
        ("/map2D_nws_yarp/rpc", "/mapServer/rpc"), "YARP ports that answer map clients (`map2D_nwc_yarp`)."
    )
    command_port: OptionalPort = setting(
        "/map2D_server/command", 'YARP port that accepts the words `current`, `use NAME` and `help`; "": none.'
    )
    folder: Path | None = setting(
        None, "The only folder in which clients may save and load; default `maps` in the module's state folder."
    )
    current: str = setting("", "The current map until a client chooses one.")
    frame: FrameName = setting("map", "The frame of all maps and markers.")
    take: tuple[TakenMap, ...] = setting(
        (),
        "Maps of other servers and mappers to import into the store. While another program publishes `/map`, the server"
        " itself does not.",
    )
    clicked_point: _PointName = setting(
        "",
        'Points of `/clicked_point` become locations on the current map, named by this word and a number; "": none do.',
    )

    @override
    def mistakes(self, config: Any) -> Iterator[Mistake]:
        if twice := repeated([*self.ports, *filter(None, [self.command_port])]):
            yield ("ports",), f"two keys name the port {twice}"
        if twice := repeated([taken.topic for taken in self.take]):
            yield ("take",), f"two entries name the topic {twice}"
        if twice := repeated([taken.name for taken in self.take]):
            yield ("take",), f"two entries name the map {twice}"

    def taken_as(self, topic: str) -> str:
        """Return the name in the store for maps from a topic; "" if they are not imported."""
        return next((taken.name for taken in self.take if taken.topic == topic), "") if self.enabled else ""
