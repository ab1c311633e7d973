"""What the section of every module that comes with Midspan has."""

from __future__ import annotations

from pydantic import Field

from bridge.config.sections.section import Section


class ModuleSection(Section):
    """A module of Midspan's; its key in `modules` is its name."""

    enabled: bool = Field(default=False, description="Whether it runs.")
