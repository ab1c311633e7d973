"""Rules for areas, and links between maps, in a file next to YARP's file of places, which cannot hold them.

The format is similar to that of places: ``Version:`` and ``1``; ``Behaviours:`` with lines of an area's name and its
settings, ``corridor max_speed=0.3 on_obstacle=wait``; ``Links:`` with lines of a name, two locations' names and a cost,
``lift lift_0 lift_1 20.0``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from yarp_compat.dev.mapfile import MapFileError, TextFile, decimal
from yarp_compat.overriding import override
from yarp_compat.wire.text import from_text, value_text

_SECTIONS = ("Behaviours:", "Links:")


@dataclass
class Extras(TextFile):
    """The content of an extras file: behaviors by the names of their areas, links by their own names."""

    behaviors: dict[str, AreaBehavior] = field(default_factory=dict)
    links: dict[str, MapLink] = field(default_factory=dict)

    @classmethod
    @override
    def from_text(cls, text: str, source: str = "the file") -> Self:
        lines = [line.strip() for line in text.split("\n")]
        if lines[:2] != ["Version:", "1"]:
            raise MapFileError(f"{source} does not begin with the lines 'Version:' and '1'")
        extras, section = cls(), ""
        for number, line in enumerate(lines[2:], 3):
            if line in _SECTIONS:
                section = line
            elif line:
                try:
                    extras._add_line(section, line)
                except (ValueError, TypeError, IndexError) as error:
                    raise MapFileError(f"{source}, line {number}: {error}: {line:.100}") from None
        return extras

    @override
    def to_text(self) -> str:
        lines = ["Version:", "1", "Behaviours:"]
        lines += [f"{value_text(name)} {rules.to_text()}" for name, rules in sorted(self.behaviors.items())]
        lines.append("Links:")
        for name, link in sorted(self.links.items()):
            lines.append(" ".join([*map(value_text, (name, link.first, link.second)), decimal(link.cost)]))
        return "\n".join(lines) + "\n"

    def _add_line(self, section: str, line: str) -> None:
        elements = from_text(line)
        name = str(elements[0])
        if name in (self.links if section == "Links:" else self.behaviors):
            raise ValueError(f"{name!r} is defined twice")
        if section == "Links:":
            _, first, second, cost = elements
            self.links[name] = MapLink(str(first), str(second), float(cost))
        elif section == "Behaviours:":
            # without the name, which may contain a setting's name
            rules = AreaBehavior.from_text(" ".join(map(str, elements[1:])))
            self.behaviors[name] = rules or AreaBehavior()
        else:
            raise ValueError("the line precedes the sections Behaviours: and Links:")


def extras_file(places: str | Path) -> Path:
    """Return the extras file of a places file: ``locations_extras.ini`` next to ``locations.ini``."""
    return Path(places).with_name(f"{Path(places).stem}_extras.ini")


_SETTING = re.compile(r"\b(max_speed|on_obstacle|keep_out)\b(?:[ \t]*=[ \t]*([^\s,;]*))?")
_OBSTACLE = ("", "wait", "around")
_TRUTH = {None: True, "1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}


@dataclass(frozen=True)
class AreaBehavior:
    """The rules of an area."""

    # meters per second, above 0; None if the area sets no limit. Closed areas have `keep_out`, because a limit of 0
    # means "no limit" to other programs
    max_speed: float | None = None
    on_obstacle: str = ""  # ``wait`` until an obstacle is gone, or go ``around`` it; empty if the area sets no rule
    keep_out: bool = False  # planners plan no path through the area

    def __post_init__(self) -> None:
        speed = self.max_speed
        if speed is not None and not (math.isfinite(speed) and speed > 0):
            raise ValueError(f"max_speed must be meters per second above 0, not {speed}; keep_out keeps robots away")
        if self.on_obstacle not in _OBSTACLE:
            raise ValueError(f"on_obstacle must be wait or around, not {self.on_obstacle!r}")

    @classmethod
    def from_text(cls, text: str) -> AreaBehavior | None:
        """Parse the rules in a description; None if it has none. Raises `ValueError` for invalid rules."""
        settings: dict[str, str | None] = {}
        for setting in _SETTING.finditer(text):
            name, value = setting.groups()
            if name in settings:
                raise ValueError(f"{name} appears twice in {text!r:.100}")
            if value is None and name != "keep_out":
                continue  # a word in a sentence, not a setting
            settings[name] = value
        if not settings:
            return None
        return cls(
            _speed(settings["max_speed"]) if "max_speed" in settings else None,
            settings.get("on_obstacle") or "",
            "keep_out" in settings and _truth(settings["keep_out"]),
        )

    def to_text(self) -> str:
        """Return the rules as text for a description."""
        settings = [] if self.max_speed is None else [f"max_speed={self.max_speed!r}"]
        if self.on_obstacle:
            settings.append(f"on_obstacle={self.on_obstacle}")
        if self.keep_out:
            settings.append("keep_out")
        return " ".join(settings)


def _speed(text: str | None) -> float:
    try:
        return float(text or "")
    except ValueError:
        raise ValueError(f"max_speed must be meters per second, not {text!r}") from None


def _truth(text: str | None) -> bool:
    try:
        return _TRUTH[text and text.lower()]
    except KeyError:
        raise ValueError(f"keep_out must be true or false, not {text!r}") from None


@dataclass(frozen=True)
class MapLink:
    """Two locations, by name, where robots change between two maps; the ``cost`` is in meters of path length."""

    first: str
    second: str
    cost: float = 0.0

    def __post_init__(self) -> None:
        if not (self.first and self.second and self.first != self.second):
            raise ValueError(f"a link joins two locations, not {self.first!r} and {self.second!r}")
        if not (math.isfinite(self.cost) and self.cost >= 0):
            raise ValueError(f"a link's cost must be 0 or more, not {self.cost}")
