"""The section ``store``: the store of maps and places."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from typing_extensions import override

from bridge.config.sections.section import Enabled, Section, setting


class StoreSection(Section):
    """The store of maps, locations, areas, paths, objects and links on the hub; see docs/navigation/maps.md."""

    enabled: Enabled = setting("auto", "Whether this daemon keeps a copy; `auto`: if a module uses it.")
    maps: Path | None = setting(
        None,
        "A collection of maps (`maps_collection.ini`) or one map (`.map`, `.yaml`), imported at start. The import does"
        " not replace maps that the store has, and does not restore deleted ones.",
    )
    locations: Path | None = setting(
        None, "A file of locations, areas, paths and objects (`locations.ini`), imported in the same way."
    )
    keys: int = setting(10_000, "Maximum number of values in the store.", ge=1, le=100_000)
    megabytes: int = setting(
        1024, "Maximum size of all values together, in megabytes (1,048,576 bytes).", ge=1, le=1 << 20
    )
    deleted: int = setting(10_000, "Maximum number of deleted names that the store remembers.", ge=0, le=100_000)
    deleted_days: float = setting(
        30.0,
        "Days for which the store remembers deleted names. Machines that were offline longer restore their values.",
        gt=0,
        le=3650,
    )

    @override
    def named_files(self) -> Iterator[Path]:
        yield from filter(None, (self.maps, self.locations))
        if self.locations is not None:
            yield self.locations.with_name(f"{self.locations.stem}_extras.ini")  # `yarp_compat.dev.extras`
