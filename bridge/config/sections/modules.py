"""The section ``modules``: the modules that Midspan hosts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, create_model, model_validator

from bridge.config.sections.section import Factory, ModuleSection, Section, SmallName, fields_of, setting
from bridge.descriptors import all_modules


class OwnModule(Section):
    """A module of your own."""

    name: SmallName = Field(description="Its name on the hub: lowercase letters, digits and underscores.")
    factory: Factory = Field(
        description="Its class as `package.module:Class`, in a package installed in Midspan's environment."
    )
    options: dict[str, Any] = Field(default_factory=dict, description="Options for its class.")


class ModulesSection(Section):
    """The modules that Midspan hosts, in one worker."""

    enabled: Literal["auto", False] = setting("auto", "`auto`: enabled modules run; `false`: no module runs.")
    own: tuple[OwnModule, ...] = setting((), "Modules of your own.")

    @property
    def sections(self) -> dict[str, Section]:
        """The sections of the enabled modules, by name."""
        enabled: dict[str, Section] = {name: part for name, part in self.shipped.items() if part.enabled}
        return enabled | {module.name: module for module in self.own}

    @property
    def shipped(self) -> dict[str, ModuleSection]:
        """The sections of all modules except ``own``, by name."""
        return {name: part for name, part in self if isinstance(part, ModuleSection)}

    @model_validator(mode="after")
    def _names_differ(self) -> ModulesSection:
        names = [module.name for module in self.own]
        taken = [name for name in names if names.count(name) > 1 or name in type(self).model_fields]
        if taken:
            raise ValueError(f"two modules are called {taken[0]}")
        return self


def _with_registered_sections() -> type[ModulesSection]:
    """Return the model with the sections of all modules."""
    sections = {module.name: (module.section, module.about) for module in all_modules().values() if module.section}
    doc = ModulesSection.__doc__
    return create_model("ModulesSection", __base__=ModulesSection, __doc__=doc, **fields_of(sections))


if not TYPE_CHECKING:
    ModulesSection = _with_registered_sections()
