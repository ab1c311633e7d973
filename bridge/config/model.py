"""The model of the YAML file. Every key is optional; the defaults run on one machine as they are."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ForwardRef, Literal, Self, TypeVar

from pydantic import Field, create_model, model_validator
from typing_extensions import override

from bridge.config.digests import set_digests
from bridge.config.sections.section import DrivenTopic, Section, differ, setting, subsection
from bridge.descriptors import all_modules, all_workers
from bridge.registration import imported
from bridge.sides import own_sides

if TYPE_CHECKING:
    from bridge.config.sections.clock import ClockSection
    from bridge.config.sections.hub import HubSection
    from bridge.config.sections.modules import ModulesSection, OwnModule
    from bridge.config.sections.navigation import NavigationSection
    from bridge.config.sections.ros import Ros1Section, Ros2Section
    from bridge.config.sections.routing import RoutingSection
    from bridge.config.sections.store import StoreSection
    from bridge.config.sections.yarp import YarpSection
    from bridge.config.sections.zenoh import ZenohSection

SomeSection = TypeVar("SomeSection", bound=Section)

DAEMON_NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,62}$"
FORMAT = 1
"""The format of the files that this Midspan reads; `bridge.config.migrate` brings older ones to it."""


@dataclass(frozen=True, slots=True)
class Default:
    """Creates a section with all defaults; imports its model, ``package.module:Model``, at the first use."""

    target: str

    @property
    def model(self) -> type[Section]:
        model: type[Section] = imported(self.target)
        return model

    def __call__(self) -> Section:
        return self.model()


def _later(target: str, description: str) -> Any:
    """Define a section whose model is imported at the first use."""
    return Field(default_factory=Default(target), description=description)


_DEFINITIONS = ("*", "*/*", "*/*/*")  # of a folder for one kind, of a package, of packages
_SUFFIXES = {".msg", ".srv", ".action", ".idl", ".xml"}


class TypesSection(Section):
    """Message types beyond those installed."""

    folders: tuple[Path, ...] = setting(
        (),
        "Folders of .msg files, as `<folder>/<package>/msg/<Name>.msg` or `<package>/<Name>.msg`; each may have its own"
        " version of a package.",
    )
    mapping_rules: tuple[Path, ...] = setting(
        (),
        "Mapping-rule files (YAML), as for ros1_bridge, or for versions of packages; see docs/sides/messages.md.",
    )

    @override
    def named_files(self) -> Iterator[Path]:
        yield from self.mapping_rules
        for folder in self.folders:
            for pattern in _DEFINITIONS:
                yield from sorted(file for file in folder.glob(pattern) if file.suffix in _SUFFIXES)


class LimitsSection(Section):
    """Size limits."""

    message: int = setting(
        256,
        "Size of the largest message in megabytes (1,048,576 bytes), on every side and in both directions. Larger"
        " messages are refused and counted as `large`; all others are bridged.",
        ge=1,
        le=256,
    )

    @property
    def message_bytes(self) -> int:
        """Bytes of the largest message."""
        return self.message << 20


class LogSection(Section):
    """Logging."""

    level: Literal["debug", "info", "warning", "error"] = setting("info", "Lowest level that is written.")


class Config(Section):
    """Midspan's configuration."""

    # not sent to workers, so that a worker of an earlier release can use the keys that it knows
    version: int = setting(
        FORMAT, "Format of this file; `midspan config migrate` updates older files.", ge=1, exclude=True
    )
    name: Annotated[str, Field(pattern=DAEMON_NAME)] = Field(
        default_factory=lambda: re.sub(r"[^A-Za-z0-9_.-]", "-", socket.gethostname())[:63] or "midspan",
        description="Name of this daemon; by default the machine's name at first start, stored in the state folder.",
    )
    state: Path | None = setting(
        None, "State folder; default $STATE_DIRECTORY, $XDG_STATE_HOME/midspan or ~/.local/state/midspan."
    )
    hub: HubSection = _later("bridge.config.sections.hub:HubSection", "The hub.")
    ros1: Ros1Section = _later("bridge.config.sections.ros:Ros1Section", "The ROS 1 side.")
    ros2: Ros2Section = _later("bridge.config.sections.ros:Ros2Section", "The ROS 2 (DDS) side.")
    zenoh: ZenohSection = _later(
        "bridge.config.sections.zenoh:ZenohSection", "The other key dialects on zenoh networks."
    )
    yarp: YarpSection = _later("bridge.config.sections.yarp:YarpSection", "The YARP side.")
    modules: ModulesSection = _later("bridge.config.sections.modules:ModulesSection", "The modules that Midspan hosts.")
    store: StoreSection = _later("bridge.config.sections.store:StoreSection", "The store of maps and locations.")
    clock: ClockSection = _later("bridge.config.sections.clock:ClockSection", "The time scale of this run.")
    types: TypesSection = subsection(TypesSection, "Message types beyond those installed.")
    routing: RoutingSection = _later(
        "bridge.config.sections.routing:RoutingSection", "Which topics are bridged, and how."
    )
    navigation: NavigationSection = _later(
        "bridge.config.sections.navigation:NavigationSection",
        "Planners and clients; see docs/navigation/navigation.md.",
    )
    limits: LimitsSection = subsection(LimitsSection, "Size limits.")
    log: LogSection = subsection(LogSection, "Logging.")

    @classmethod
    @override
    def model_rebuild(cls, **options: Any) -> bool | None:
        """Import the models of all sections; pydantic calls this when the model is used for the first time."""
        options.pop("_parent_namespace_depth", None)
        models: dict[str, Any] = {}
        for info in cls.model_fields.values():
            reference: Any = info.annotation
            if isinstance(reference, ForwardRef) and isinstance(info.default_factory, Default):
                models[reference.__forward_arg__] = info.default_factory.model
        return super().model_rebuild(**options, _types_namespace=models)

    def section(self, model: type[SomeSection]) -> SomeSection:
        """Return the section of a worker or a module, by its model."""
        target = f"{model.__module__}:{model.__name__}"
        section: SomeSection
        for worker in all_workers():
            if worker.section == target:
                section = getattr(self, worker.name)
                return section
        for module in all_modules().values():
            if module.section == target:
                section = getattr(self.modules, module.name)
                return section
        raise LookupError(f"{target} is not the section of a worker or a module")

    def set_digests(self, values: Mapping[str, str]) -> None:
        """Set the digests of the sections' files, which a configuration from the daemon comes with."""
        set_digests(self, values)

    def set_driven(self, topics: tuple[DrivenTopic, ...]) -> None:
        """Set `driven_topics` as the daemon found them; this class has all sections, and ignores them."""

    @property
    def driven_topics(self) -> tuple[DrivenTopic, ...]:
        """The topics that move this robot: those of ``navigation`` and of enabled modules and workers."""
        sections: dict[str, Section] = {"navigation": self.navigation}
        sections |= {f"modules.{name}": section for name, section in self.modules.sections.items()}
        workers = {worker.name: getattr(self, worker.name) for worker in all_workers() if worker.section}
        sections |= {name: section for name, section in workers.items() if getattr(section, "enabled", False)}
        return tuple(DrivenTopic(of, *topic) for of, section in sections.items() for topic in section.driven)

    @property
    def rules(self) -> RoutingSection:
        """The rules of ``routing``, combined with those that follow from other sections (`bridge.config.rules`)."""
        from bridge.config.rules import with_commands, with_navigation

        return with_commands(with_navigation(self.routing, self.navigation), self.driven_topics)

    @property
    def _own_planners(self) -> dict[str, OwnModule]:
        """The planners that a user's class implements, as modules by name."""
        from bridge.config.sections.modules import OwnModule

        own = (planner for planner in self.navigation.planners if planner.factory)
        return {p.name: OwnModule(name=p.name, factory=str(p.factory), options=p.options) for p in own}

    @model_validator(mode="after")
    def _modules_differ(self) -> Self:
        modules = self.modules
        differ(
            [*modules.shipped, *(module.name for module in modules.own), *self._own_planners],
            "two modules have the name",
        )
        return self

    @property
    def hosted(self) -> dict[str, Section]:
        """The sections of all modules that run, by name; ``navigation`` supplies values that a section leaves out."""
        sections = self.modules.sections
        if self.navigation.planner:
            sections["gateway"] = self.navigation
            sections |= self._own_planners
        defaults = {"map": self.navigation.map, "source": self.navigation.localizer}
        return {name: _with_defaults(section, defaults) for name, section in sections.items()}


def _with_defaults(section: Section, defaults: dict[str, str | None]) -> Section:
    """Return the section with these values in place of None."""
    missing = {name: value for name, value in defaults.items() if getattr(section, name, value) is None}
    return section.model_copy(update=missing) if missing else section


def _with_registered_sections() -> type[Config]:
    """Return the model with the sections of all workers, and of the sides that do not ship with Midspan."""
    sections = {worker.name: (worker.section, worker.about) for worker in all_workers() if worker.section}
    sections |= {side.name: (side.section, f"The {side.label} side.") for side in own_sides()}
    fields: dict[str, Any] = {
        name: (ForwardRef(f"{name}_section"), _later(target, about)) for name, (target, about) in sections.items()
    }
    return create_model("Config", __base__=Config, __doc__=Config.__doc__, **fields)


if not TYPE_CHECKING:
    Config = _with_registered_sections()
