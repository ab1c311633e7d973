"""The section ``modules``: what Midspan hosts."""

from __future__ import annotations

import re
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from bridge.config.sections.base_control import BaseControlSection
from bridge.config.sections.localization_server import LocalizationServerSection
from bridge.config.sections.mapper2d import Mapper2DSection
from bridge.config.sections.maps import Map2DServerSection
from bridge.config.sections.module import ModuleSection
from bridge.config.sections.robot_goto import RobotGotoSection
from bridge.config.sections.robot_path_planner import RobotPathPlannerSection
from bridge.config.sections.section import Section
from bridge.config.sections.transforms import TransformServerSection

_FACTORY = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
_NAME = re.compile(r"[a-z][a-z0-9_]{0,62}")


class OwnModule(Section):
    """A module of one's own."""

    name: str = Field(description="Its name on the hub: small letters, digits and underscores.")
    factory: str = Field(
        description="Where its class is, as `package.module:Class`; the package is installed beside Midspan."
    )
    options: dict[str, Any] = Field(default_factory=dict, description="What it is started with.")

    @field_validator("name")
    @classmethod
    def _name_is_a_node(cls, value: str) -> str:
        if not _NAME.fullmatch(value):
            msg = f"{value!r} is no name of a module: small letters, digits and underscores, a letter first"
            raise ValueError(msg)
        return value

    @field_validator("factory")
    @classmethod
    def _factory_is_a_class(cls, value: str) -> str:
        if not _FACTORY.fullmatch(value):
            msg = f"{value!r} names no class: write package.module:Class"
            raise ValueError(msg)
        return value


class ModulesSection(Section):
    """The modules that Midspan hosts, in one worker."""

    enabled: Literal["auto", False] = Field(
        default="auto", description="`auto`: those that are switched on run; `false`: none does."
    )
    base_control: BaseControlSection = Field(
        default_factory=BaseControlSection,
        description="Drives a mobile base as its inputs command; see docs/base_control.md.",
    )
    localization_server: LocalizationServerSection = Field(
        default_factory=LocalizationServerSection,
        description="Where the robot is, for all sides, and a localiser of Midspan's own; see docs/localization.md.",
    )
    map2d_server: Map2DServerSection = Field(
        default_factory=Map2DServerSection,
        description="The maps and places of the store for YARP, ROS 1 and ROS 2; see docs/maps.md.",
    )
    mapper2d: Mapper2DSection = Field(
        default_factory=Mapper2DSection,
        description="A map from a laser and a pose that is given; see docs/mapper2d.md.",
    )
    robot_goto: RobotGotoSection = Field(
        default_factory=RobotGotoSection,
        description="Drives to a goal by laser and frames alone; see docs/robot_goto.md.",
    )
    robot_path_planner: RobotPathPlannerSection = Field(
        default_factory=RobotPathPlannerSection,
        description="Ways over the map, driven waypoint by waypoint by a local navigator; see"
        " docs/robot_path_planner.md.",
    )
    transform_server: TransformServerSection = Field(
        default_factory=TransformServerSection,
        description="The frames of all sides for YARP programs; see docs/frames.md.",
    )
    own: tuple[OwnModule, ...] = Field(default=(), description="Modules of one's own.")

    @property
    def sections(self) -> dict[str, Section]:
        """The sections of the modules that are switched on, by name."""
        ours: dict[str, Section] = {
            name: part for name, part in self if isinstance(part, ModuleSection) and part.enabled
        }
        return ours | {module.name: module for module in self.own}

    @model_validator(mode="after")
    def _names_differ(self) -> ModulesSection:
        names = [module.name for module in self.own]
        taken = [name for name in names if names.count(name) > 1 or name in type(self).model_fields]
        if taken:
            msg = f"two modules are called {taken[0]}"
            raise ValueError(msg)
        return self
