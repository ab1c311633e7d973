"""The model of Midspan's one YAML file. Every key is optional; the defaults run on one machine as they are."""

from __future__ import annotations

import re
import socket
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from bridge.config.mix import with_navigation
from bridge.config.sections.clock import ClockSection
from bridge.config.sections.hub import HubSection
from bridge.config.sections.modules import ModulesSection
from bridge.config.sections.navigation import NavigationSection
from bridge.config.sections.ros1 import Ros1Section
from bridge.config.sections.ros2 import Ros2Section
from bridge.config.sections.routing import RoutingSection
from bridge.config.sections.section import Section
from bridge.config.sections.sim import SimSection
from bridge.config.sections.store import StoreSection
from bridge.config.sections.yarp import YarpSection
from bridge.config.sections.zenoh import ZenohSection


class TypesSection(Section):
    """Message types beyond those installed."""

    folders: tuple[Path, ...] = Field(
        default=(),
        description="Folders of .msg files, as `<folder>/<package>/msg/<Name>.msg` or `<package>/<Name>.msg`.",
    )
    mapping_rules: tuple[Path, ...] = Field(default=(), description="ros1_bridge mapping-rule files (YAML).")


class LimitsSection(Section):
    """What is refused for its size."""

    message: int = Field(
        default=256,
        ge=1,
        le=256,
        description="Megabytes (1,048,576 bytes) of the largest message, on every side and both ways. A larger one is"
        " refused and counted as `large`; everything else flows on.",
    )

    @property
    def message_bytes(self) -> int:
        """Bytes of the largest message."""
        return self.message << 20


class LogSection(Section):
    """Logging."""

    level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="Least level that is written."
    )


class Config(Section):
    """Midspan's configuration."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,62}$")] = Field(
        default_factory=lambda: re.sub(r"[^A-Za-z0-9_.-]", "-", socket.gethostname())[:63] or "midspan",
        description="Name of this daemon; default the machine's.",
    )
    state: Path | None = Field(
        default=None,
        description="State folder; default $STATE_DIRECTORY, else $XDG_STATE_HOME/midspan, else"
        " ~/.local/state/midspan.",
    )
    hub: HubSection = Field(default_factory=HubSection, description="The hub.")
    ros1: Ros1Section = Field(default_factory=Ros1Section, description="The ROS 1 side.")
    ros2: Ros2Section = Field(default_factory=Ros2Section, description="The ROS 2 (DDS) side.")
    zenoh: ZenohSection = Field(
        default_factory=ZenohSection, description="The other key dialects in use on zenoh networks."
    )
    yarp: YarpSection = Field(default_factory=YarpSection, description="The YARP side.")
    modules: ModulesSection = Field(default_factory=ModulesSection, description="The modules that Midspan hosts.")
    sim: SimSection = Field(default_factory=SimSection, description="The simulated base.")
    store: StoreSection = Field(default_factory=StoreSection, description="The store of maps and locations.")
    clock: ClockSection = Field(default_factory=ClockSection, description="The time scale of this run.")
    types: TypesSection = Field(default_factory=TypesSection, description="Message types beyond those installed.")
    routing: RoutingSection = Field(default_factory=RoutingSection, description="Which topics cross, and how.")
    navigation: NavigationSection = Field(
        default_factory=NavigationSection,
        description="Any planner with any client: which one drives, and at which names each side asks; see"
        " docs/navigation.md.",
    )
    limits: LimitsSection = Field(default_factory=LimitsSection, description="What is refused for its size.")
    log: LogSection = Field(default_factory=LogSection, description="Logging.")

    @property
    def rules(self) -> RoutingSection:
        """What crosses, and how: ``routing``, after what follows from ``navigation``."""
        return with_navigation(self.routing, self.navigation)

    @property
    def hosted(self) -> dict[str, Section]:
        """The sections of all modules that run, by name; what they leave to ``navigation`` is as it says there."""
        found = self.modules.sections
        if self.navigation.planner:
            found["gateway"] = self.navigation
        defaults = {"map": self.navigation.map, "source": self.navigation.localizer}
        return {name: _filled(section, defaults) for name, section in found.items()}


def _filled(section: Section, defaults: dict[str, str | None]) -> Section:
    """The section with these values where it has None."""
    left = {name: value for name, value in defaults.items() if getattr(section, name, value) is None}
    return section.model_copy(update=left) if left else section
