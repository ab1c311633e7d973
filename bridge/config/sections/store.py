"""The section ``store``: the maps and locations that all daemons of a deployment share."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from bridge.config.sections.section import Enabled, Section


class StoreSection(Section):
    """The store of maps, locations, areas, paths, objects and links, shared on the hub (see docs/maps.md)."""

    enabled: Enabled = Field(
        default="auto",
        description="Whether this daemon keeps a copy: `auto`: where a module uses it; `true`: always; `false`: never.",
    )
    maps: Path | None = Field(
        default=None,
        description="A collection of maps (`maps_collection.ini`) or one map (`.map`, `.yaml`) that is imported at"
        " start. What the store knows already, or was deleted from it, stays as it is.",
    )
    locations: Path | None = Field(
        default=None, description="A file of locations, areas, paths and objects (`locations.ini`), imported likewise."
    )
    keys: int = Field(default=10_000, ge=1, le=100_000, description="Values that the store holds at most.")
    megabytes: int = Field(
        default=1024, ge=1, le=1 << 20, description="Megabytes (1,048,576 bytes) of all values together."
    )
    deleted: int = Field(
        default=10_000, ge=0, le=100_000, description="Deleted names that are remembered, the latest ones."
    )
    deleted_days: float = Field(
        default=30.0,
        gt=0,
        le=3650,
        description="Days for which they are. A machine that was away for longer brings back what was deleted"
        " meanwhile.",
    )
