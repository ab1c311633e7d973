"""The section ``modules``: what Midspan hosts."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from bridge.config.sections.base_control import BaseControlSection
from bridge.config.sections.localization_server import LocalizationServerSection
from bridge.config.sections.mapper2d import Mapper2DSection
from bridge.config.sections.maps import Map2DServerSection
from bridge.config.sections.robot_goto import RobotGotoSection
from bridge.config.sections.robot_path_planner import RobotPathPlannerSection
from bridge.config.sections.section import ModuleSection, Section, SmallName, matching, setting, subsection
from bridge.config.sections.transforms import TransformServerSection

_FACTORY = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
_Factory = Annotated[str, matching(_FACTORY, "does not name a class: write package.module:Class")]


class OwnModule(Section):
    """A module of your own."""

    name: SmallName = Field(description="Its name on the hub: small letters, digits and underscores.")
    factory: _Factory = Field(description="Its class as `package.module:Class`, in a package installed beside Midspan.")
    options: dict[str, Any] = Field(default_factory=dict, description="Options that it starts with.")


class ModulesSection(Section):
    """The modules that Midspan hosts, in one worker."""

    enabled: Literal["auto", False] = setting("auto", "`auto`: modules that are switched on run; `false`: none runs.")
    base_control: BaseControlSection = subsection(
        BaseControlSection, "Drives a mobile base as its inputs command; see docs/navigation/base_control.md."
    )
    localization_server: LocalizationServerSection = subsection(
        LocalizationServerSection,
        "Where the robot is, for all sides, with Midspan's own localiser; see docs/navigation/localization.md.",
    )
    map2d_server: Map2DServerSection = subsection(
        Map2DServerSection, "The maps and places of the store for YARP, ROS 1 and ROS 2; see docs/navigation/maps.md."
    )
    mapper2d: Mapper2DSection = subsection(
        Mapper2DSection, "Makes a map from a laser and a known pose; see docs/navigation/mapper2d.md."
    )
    robot_goto: RobotGotoSection = subsection(
        RobotGotoSection, "Drives to a goal by laser and frames alone; see docs/navigation/robot_goto.md."
    )
    robot_path_planner: RobotPathPlannerSection = subsection(
        RobotPathPlannerSection,
        "Plans paths on the map and drives them by a local navigator; see docs/navigation/robot_path_planner.md.",
    )
    transform_server: TransformServerSection = subsection(
        TransformServerSection, "The frames of all sides for YARP programs; see docs/sides/frames.md."
    )
    own: tuple[OwnModule, ...] = setting((), "Modules of your own.")

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
            raise ValueError(f"two modules are called {taken[0]}")
        return self
