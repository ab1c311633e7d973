"""Rules for areas, and links between maps, in a file beside YARP's of places, which cannot hold them.

It looks as theirs do: ``Version:`` and ``1``; ``Behaviours:`` with lines of an area's name and its settings, ``corridor
max_speed=0.3 on_obstacle=wait``; ``Links:`` with lines of a name, two locations' names and a cost, ``lift lift_0
lift_1 20.0``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from yarp_compat.dev.mapfile import MapFileError, TextFile, decimal
from yarp_compat.wire.text import from_text, value_text

_SECTIONS = ("Behaviours:", "Links:")


@dataclass
class Extras(TextFile):
    """The content of such a file: behaviours by their areas' names, links by their own."""

    behaviours: dict[str, AreaBehaviour] = field(default_factory=dict)
    links: dict[str, MapLink] = field(default_factory=dict)

    @classmethod
    def from_text(cls, text: str, source: str = "the file") -> Self:
        """The content of a file's text, which errors call ``source``; raises `MapFileError` for a wrong line."""
        lines = [line.strip() for line in text.split("\n")]
        if lines[:2] != ["Version:", "1"]:
            raise MapFileError(f"{source} does not begin with a line 'Version:' and one that says 1")
        extras, section = cls(), ""
        for number, line in enumerate(lines[2:], 3):
            if line in _SECTIONS:
                section = line
            elif line:
                try:
                    extras._take(section, line)
                except (ValueError, TypeError, IndexError) as error:
                    raise MapFileError(f"{source}, line {number}: {error}: {line:.100}") from None
        return extras

    def to_text(self) -> str:
        """The text of a file, sorted by names."""
        lines = ["Version:", "1", "Behaviours:"]
        lines += [f"{value_text(name)} {said.to_text()}" for name, said in sorted(self.behaviours.items())]
        lines.append("Links:")
        for name, link in sorted(self.links.items()):
            lines.append(" ".join([*map(value_text, (name, link.first, link.second)), decimal(link.cost)]))
        return "\n".join(lines) + "\n"

    def _take(self, section: str, line: str) -> None:
        words = from_text(line)
        name = str(words[0])
        if name in (self.links if section == "Links:" else self.behaviours):
            raise ValueError(f"{name!r} is there already")
        if section == "Links:":
            _, first, second, cost = words
            self.links[name] = MapLink(str(first), str(second), float(cost))
        elif section == "Behaviours:":
            # only after the name, which may have one of the settings' words in it
            said = AreaBehaviour.from_text(" ".join(map(str, words[1:])))
            self.behaviours[name] = said or AreaBehaviour()
        else:
            raise ValueError("it stands before any section, which are Behaviours: and Links:")


def extras_file(places: str | Path) -> Path:
    """The file beside one of places: ``locations_extras.ini`` beside ``locations.ini``."""
    return Path(places).with_name(f"{Path(places).stem}_extras.ini")


_SETTING = re.compile(r"\b(max_speed|on_obstacle|keep_out)\b(?:[ \t]*=[ \t]*([^\s,;]*))?")
_OBSTACLE = ("", "wait", "around")
_TRUTH = {None: True, "1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}


@dataclass(frozen=True)
class AreaBehaviour:
    """The rules of an area."""

    # metres per second, above 0; None where the area sets no limit. `keep_out` says that nobody may drive there: a
    # limit of 0 means no limit to others
    max_speed: float | None = None
    on_obstacle: str = ""  # ``wait`` until it is gone or go ``around`` it; empty where the area does not say
    keep_out: bool = False  # nobody plans a way through

    def __post_init__(self) -> None:
        speed = self.max_speed
        if speed is not None and not (math.isfinite(speed) and speed > 0):
            raise ValueError(f"max_speed is metres per second above 0, not {speed}: say keep_out to keep robots away")
        if self.on_obstacle not in _OBSTACLE:
            raise ValueError(f"on_obstacle is wait or around, not {self.on_obstacle!r}")

    @classmethod
    def from_text(cls, text: str) -> AreaBehaviour | None:
        """The rules in a description, None where it has none; raises `ValueError` for senseless ones."""
        said: dict[str, str | None] = {}
        for setting in _SETTING.finditer(text):
            name, value = setting.groups()
            if name in said:
                raise ValueError(f"{name} stands twice in {text!r:.100}")
            if value is None and name != "keep_out":
                continue  # the word in a sentence
            said[name] = value
        if not said:
            return None
        return cls(
            _speed(said["max_speed"]) if "max_speed" in said else None,
            said.get("on_obstacle") or "",
            "keep_out" in said and _truth(said["keep_out"]),
        )

    def to_text(self) -> str:
        """The same as it stands in a description."""
        words = [] if self.max_speed is None else [f"max_speed={self.max_speed!r}"]
        if self.on_obstacle:
            words.append(f"on_obstacle={self.on_obstacle}")
        if self.keep_out:
            words.append("keep_out")
        return " ".join(words)


def _speed(text: str | None) -> float:
    try:
        return float(text or "")
    except ValueError:
        raise ValueError(f"max_speed is metres per second, not {text!r}") from None


def _truth(text: str | None) -> bool:
    try:
        return _TRUTH[text and text.lower()]
    except KeyError:
        raise ValueError(f"keep_out is true or false, not {text!r}") from None


@dataclass(frozen=True)
class MapLink:
    """Two locations, by name, on two maps between which robots change, at a ``cost`` of so many metres of way."""

    first: str
    second: str
    cost: float = 0.0

    def __post_init__(self) -> None:
        if not (self.first and self.second and self.first != self.second):
            raise ValueError(f"a link joins two locations, not {self.first!r} and {self.second!r}")
        if not (math.isfinite(self.cost) and self.cost >= 0):
            raise ValueError(f"a link's cost is 0 or more, not {self.cost}")
