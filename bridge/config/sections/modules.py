"""The section ``modules``: what Midspan hosts, and the server of frames among it."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from bridge.boards.section import ControlBoardsSection
from bridge.config.sections.section import (
    ModuleSection,
    OptionalPort,
    Section,
    SmallName,
    matching,
    setting,
    subsection,
)
from navigation.base_control.section import BaseControlSection
from navigation.localization_server.section import LocalizationServerSection
from navigation.map2d_server.section import Map2DServerSection
from navigation.mapper2d.section import Mapper2DSection
from navigation.mapper3d.section import Mapper3DSection
from navigation.robot_goto.section import RobotGotoSection
from navigation.robot_path_planner.section import RobotPathPlannerSection


class TransformServerSection(ModuleSection):
    """The server of frames for YARP's `frameTransformClient`."""

    prefix: OptionalPort = setting(
        "", "Prefix of its ports: `/robot` for `/robot/frameTransformServer/...`, as YARP's `ft_server_prefix`."
    )
    period: float = setting(0.01, "Seconds between two messages of the port `tf:o`.", ge=0.001, le=1.0)
    yarp_frame_lifetime: float = setting(
        0.2, "Seconds after its stamp for which YARP programs see a frame that a YARP program set.", ge=0.01, le=3600.0
    )
    ros_frame_lifetime: float = setting(
        1.0, "Seconds for which YARP programs see a frame of `/tf`; at least its period.", ge=0.01, le=3600.0
    )
    clock: Literal["run", "system"] = setting(
        "run",
        "Clock of the YARP programs. `run`: this run's clock (with `clock.source: sim` they use"
        " `YARP_CLOCK=/midspan/clock:o`); `system`: the machine's, also in a simulation.",
    )
    cache_time: float = setting(10.0, "Seconds of history before each frame's newest.", gt=0.0, le=600.0)
    max_future: float = setting(2.0, "Seconds that a stamp may be ahead of the clock.", ge=0.0, le=60.0)

    buffer_server: bool = setting(
        True, "Serve `/tf2_buffer_server` and `/tf2_frames` for tf2_ros's `BufferClient`; off if others do."
    )


_FACTORY = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
_Factory = Annotated[str, matching(_FACTORY, "does not name a class: write package.module:Class")]


class OwnModule(Section):
    """A module of your own."""

    name: SmallName = Field(description="Its name on the hub: small letters, digits and underscores.")
    factory: _Factory = Field(
        description="Its class as `package.module:Class`, in a package installed in Midspan's environment."
    )
    options: dict[str, Any] = Field(default_factory=dict, description="Options that it starts with.")


class ModulesSection(Section):
    """The modules that Midspan hosts, in one worker."""

    enabled: Literal["auto", False] = setting("auto", "`auto`: modules that are switched on run; `false`: none runs.")
    base_control: BaseControlSection = subsection(
        BaseControlSection, "Drives a mobile base as its inputs command; see docs/navigation/base_control.md."
    )
    control_boards: ControlBoardsSection = subsection(
        ControlBoardsSection, "Joints of a YARP robot's control boards as `JointState`; see docs/sides/yarp.md."
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
    mapper3d: Mapper3DSection = subsection(
        Mapper3DSection, "Makes an octree of clouds and depth images; see docs/navigation/mapper3d.md."
    )
    robot_goto: RobotGotoSection = subsection(
        RobotGotoSection, "Drives to a goal with only laser and frames; see docs/navigation/robot_goto.md."
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
