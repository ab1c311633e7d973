"""Locations that are docks, by settings in their descriptions, so that YARP's files and servers preserve them.

A description such as ``charger in the lab, kind=dock dock_type=simple_charging_dock`` makes a location a dock. The type
names a plugin of the program that docks, and may be missing.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from yarp_compat.dev.locations import Map2DLocation

_KIND = re.compile(r"(?<![\w=])kind=dock(?![\w=-])")
_TYPE = re.compile(r"(?<![\w=])dock_type=([A-Za-z0-9_.:/-]+)")


class Dock(NamedTuple):
    """The settings that make a location a dock; ``type`` is "" if the description has none."""

    type: str = ""

    def to_text(self) -> str:
        """Return the settings as text for a description; raises `ValueError` if the type is not one word."""
        if not self.type:
            return "kind=dock"
        text = f"kind=dock dock_type={self.type}"
        if dock_of(Map2DLocation(description=text)) != self:
            raise ValueError(f"a dock's type may only have letters, digits and _ . : / -, not {self.type!r:.60}")
        return text


def dock_of(location: Map2DLocation) -> Dock | None:
    """Return the dock settings of a location; None if it is not a dock."""
    if not _KIND.search(location.description):
        return None
    found = _TYPE.search(location.description)
    return Dock(found.group(1) if found else "")
