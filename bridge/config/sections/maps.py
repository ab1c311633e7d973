"""The section ``modules.map2d_server``: the maps and places of the store, given to YARP, ROS 1 and ROS 2."""

from __future__ import annotations

import re
from pathlib import Path

from pydantic import Field, field_validator, model_validator

from bridge.config.sections.module import ModuleSection
from bridge.config.sections.section import Section
from bridge.config.sections.values import ROS2_NAME

_PORT = re.compile(r"(?:/[^\s/\"'*()\[\]{}]+)+")
_NAME = re.compile(r"[A-Za-z0-9_. -]{0,64}")


class TakenMap(Section):
    """Maps of a topic that are taken into the store."""

    topic: str = Field(description="The topic (`nav_msgs/msg/OccupancyGrid`), as on the hub: `/map`.")
    name: str = Field(min_length=1, max_length=64, description="The map's name in the store.")
    use: bool = Field(default=True, description="Whether it becomes the current map when it comes.")
    period: float = Field(
        default=2.0, ge=0.0, le=3600.0, description="Seconds at least from one map that is taken to the next."
    )

    @field_validator("topic")
    @classmethod
    def _topic_is_one(cls, value: str) -> str:
        if not ROS2_NAME.fullmatch(value):
            msg = f"{value!r} is no topic: begin it with a slash; letters, digits and underscores make its parts"
            raise ValueError(msg)
        return value


class Map2DServerSection(ModuleSection):
    """The map server."""

    ports: tuple[str, ...] = Field(
        default=("/map2D_nws_yarp/rpc", "/mapServer/rpc"),
        description="The YARP ports at which map clients (`map2D_nwc_yarp`) are answered.",
    )
    command_port: str = Field(
        default="/map2D_server/command",
        description='The YARP port that takes the words `current`, `use NAME` and `help`; "" for none.',
    )
    folder: Path | None = Field(
        default=None,
        description="The only folder whose files clients may name when they save and load; by default `maps` in the"
        " module's part of the state folder.",
    )
    current: str = Field(default="", description="The map that is current where nobody has chosen one.")
    frame: str = Field(default="map", min_length=1, max_length=100, description="The frame of all maps and markers.")
    take: tuple[TakenMap, ...] = Field(
        default=(),
        description="Maps of real map servers and mappers that are taken into the store. While somebody publishes"
        " `/map` that is taken, the server does not publish its own.",
    )
    clicked_point: str = Field(
        default="",
        description="Points of `/clicked_point` become locations of the current map with this name and a number;"
        ' "" for none.',
    )

    @field_validator("ports", "command_port")
    @classmethod
    def _ports_are_some(cls, value: tuple[str, ...] | str) -> tuple[str, ...] | str:
        for port in (value,) if isinstance(value, str) else value:
            if not _PORT.fullmatch(port) and (port or not isinstance(value, str)):
                msg = f"{port!r} is no name of a port: write it as /map2D_nws_yarp/rpc"
                raise ValueError(msg)
        return value

    @field_validator("clicked_point")
    @classmethod
    def _prefix_can_begin_a_name(cls, value: str) -> str:
        if not _NAME.fullmatch(value):
            msg = f"{value!r} cannot begin a location's name: letters, digits, blanks and . _ - can"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _nothing_stands_twice(self) -> Map2DServerSection:
        for what, values in (
            ("port", [*self.ports, *filter(None, [self.command_port])]),
            ("topic", [taken.topic for taken in self.take]),
            ("map", [taken.name for taken in self.take]),
        ):
            if len(set(values)) != len(values):
                msg = f"a {what} stands twice"
                raise ValueError(msg)
        return self

    def taken_as(self, topic: str) -> str:
        """The name under which the maps of a topic are in the store, also before they have come; "" where they are not.

        The locations on such a map have that name, and who tells a start.
        """
        return next((taken.name for taken in self.take if taken.topic == topic), "") if self.enabled else ""
