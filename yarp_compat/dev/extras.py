"""What YARP's files of places cannot hold: how to behave in areas, and links between maps, in a file beside them.

It looks as theirs do: ``Version:`` and ``1``; ``Behaviours:`` with lines of an area's name and its settings, ``corridor
max_speed=0.3 on_obstacle=wait``; ``Links:`` with lines of a name, two locations' names and a cost, ``lift lift_0
lift_1 20.0``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from yarp_compat.dev.area_behaviour import AreaBehaviour
from yarp_compat.dev.mapfile import MapFileError, decimal, found, read_text, write
from yarp_compat.dev.maplink import MapLink
from yarp_compat.wire.text import from_text, value_text

_SECTIONS = ("Behaviours:", "Links:")


@dataclass
class Extras:
    """What such a file holds.

    Attributes:
        behaviours: by their areas' names.
        links: by their own names.
    """

    behaviours: dict[str, AreaBehaviour] = field(default_factory=dict)
    links: dict[str, MapLink] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path, jail: Path | None = None) -> Extras:
        """Read a file.

        Raises:
            MapFileError: it is not there, or a line means nothing.
        """
        file = found(path, Path(), jail)
        return cls.from_text(read_text(file), str(file))

    def save(self, path: str | Path) -> None:
        """Write a file.

        Raises:
            MapFileError: it cannot be written.
        """
        write(Path(path), self.to_text())

    @classmethod
    def from_text(cls, text: str, source: str = "the file") -> Extras:
        """What a file's text says; ``source`` is what errors call it.

        Raises:
            MapFileError: a line means nothing, or says a name for the second time.
        """
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
