"""The files of YARP's map storage (`map2DStorage/Map2DStorage.cpp`): places, and collections of maps.

Files of places have ``Version:``, its number, and a section for each kind, whose lines are Bottles. Version 1 has
locations and areas, 2 adds paths, 3 descriptions, 4 objects; version 4 is written. Numbers are preserved exactly, while
YARP keeps six digits. Collections (``maps_collection.ini``) have a line for each map, ``mapfile: name.map``; if the
line ends with ``crop``, unknown edges are removed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapfile import MapFileError, TextFile, decimal, file_name, read_text, resolve, write
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.overriding import override
from yarp_compat.sig.vec2d import Vec2D
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.text import from_text, value_text

Line = list[Any]


@dataclass
class Places(TextFile):
    """The content of a file of places, by name: locations, objects, areas and paths."""

    locations: dict[str, Map2DLocation] = field(default_factory=dict)
    objects: dict[str, Map2DObject] = field(default_factory=dict)
    areas: dict[str, Map2DArea] = field(default_factory=dict)
    paths: dict[str, Map2DPath] = field(default_factory=dict)

    @classmethod
    @override
    def from_text(cls, text: str, source: str = "the file") -> Self:
        """Parse a file's text; errors name the file ``source``.

        Raises `MapFileError` for an invalid line, or a name that a section defines twice.
        """
        lines = iter(enumerate(text.split("\n"), 1))
        version = _version(lines, source)
        places = cls()
        kind: dict[str, Any] = {}
        parse: Callable[[Line, bool], Any] = _nowhere
        for number, line in lines:
            if line.strip() in _SECTIONS:
                attribute, parse = _SECTIONS[line.strip()]
                kind = getattr(places, attribute)
            elif line.strip():
                try:
                    elements = from_text(line)
                    value = parse(elements, version >= 3)
                    _add(kind, _text(elements[0]), value)
                except (ValueError, WireError, IndexError, TypeError) as error:
                    raise MapFileError(f"{source}, line {number}: {error}: {line:.100}") from None
        return places

    @override
    def to_text(self) -> str:
        lines = ["Version:", "4", "Locations:"]
        for name, place in sorted(self.locations.items()):
            lines.append(_line(name, place.map_id, [place.x, place.y, place.theta], place.description))
        lines.append("Objects:")
        for name, thing in sorted(self.objects.items()):
            pose = [thing.x, thing.y, thing.z, thing.roll, thing.pitch, thing.yaw]
            lines.append(_line(name, thing.map_id, pose, thing.description))
        lines.append("Areas:")
        for name, area in sorted(self.areas.items()):
            corners = [number for point in area.points for number in (point.x, point.y)]
            lines.append(_line(name, area.map_id, corners, area.description, count=len(area.points)))
        lines.append("Paths:")
        for name, path in sorted(self.paths.items()):
            poses = [f"({_pose_text(value_text(p.map_id), [p.x, p.y, p.theta])})" for p in path.waypoints]
            lines.append(" ".join([value_text(name), *poses, _quoted(path.description)]))
        return "\n".join(lines) + "\n"


def _version(lines: Iterator[tuple[int, str]], source: str) -> int:
    head = [line.strip() for _, line in (next(lines, (0, "")), next(lines, (0, "")))]
    if head[0] != "Version:" or head[1] not in ("1", "2", "3", "4"):
        raise MapFileError(f"{source} does not begin with the lines 'Version:' and '1', '2', '3' or '4'")
    return int(head[1])


def _nowhere(_line: Line, _described: bool) -> None:
    raise ValueError("the line precedes all sections, the first of which is Locations:")


def _location(line: Line, described: bool) -> Map2DLocation:
    _sized(line, 5 + described)
    return _pose(line[1:5], _text(line[5]) if described else "")


def _object(line: Line, _described: bool) -> Map2DObject:
    _sized(line, 9)
    x, y, z, roll, pitch, yaw = map(_number, line[2:8])
    return Map2DObject(_text(line[1]), x, y, z, roll, pitch, yaw, _text(line[8]))


def _area(line: Line, described: bool) -> Map2DArea:
    count = line[2]
    if type(count) is not int or count < 0:
        raise ValueError(f"{count!r:.40} is not a number of corners")
    _sized(line, 3 + 2 * count + described)
    corners = [_number(value) for value in line[3 : 3 + 2 * count]]
    points = [Vec2D(x, y) for x, y in zip(corners[::2], corners[1::2], strict=True)]
    return Map2DArea(_text(line[1]), points, _text(line[-1]) if described else "")


def _path(line: Line, described: bool) -> Map2DPath:
    poses = [value for value in line[1:] if isinstance(value, list)]
    _sized(line, 1 + len(poses) + (described and not (poses and line[-1] is poses[-1])))
    waypoints = [_pose(pose) for pose in poses]
    return Map2DPath(waypoints, "" if line[-1] in poses or len(line) == 1 else _text(line[-1]))


_SECTIONS: Mapping[str, tuple[str, Callable[[Line, bool], Any]]] = {
    "Locations:": ("locations", _location),
    "Objects:": ("objects", _object),
    "Areas:": ("areas", _area),
    "Paths:": ("paths", _path),
}


def _pose(line: Line, description: str = "") -> Map2DLocation:
    _sized(line, 4)
    x, y, theta = map(_number, line[1:])
    return Map2DLocation(_text(line[0]), x, y, theta, description)


def _add(kind: dict[str, Any], name: str, value: Any) -> None:
    if name in kind:
        raise ValueError(f"{name!r} is defined twice")
    kind[name] = value


def _sized(line: Line, count: int) -> None:
    if len(line) != count:
        raise ValueError(f"expected {count} values, not {len(line)}")


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{value!r:.40} is not a number")  # noqa: TRY004
    return float(value)


def _text(value: Any) -> str:
    """Return a text, even if it looks like a number."""
    if isinstance(value, str):
        return str(value)
    if isinstance(value, list | bytes):
        raise ValueError(f"{value!r:.40} is not a text")  # noqa: TRY004
    return value_text(value)


def _line(name: str, map_name: str, numbers: Sequence[float], description: str, count: int | None = None) -> str:
    """Format a line; ``count`` precedes a variable number of numbers."""
    head = value_text(map_name) if count is None else f"{value_text(map_name)} {count}"
    return f"{value_text(name)} {_pose_text(head, numbers)} {_quoted(description)}"


def _pose_text(head: str, numbers: Sequence[float]) -> str:
    return " ".join([head, *(decimal(float(number)) for number in numbers)])


def _quoted(text: str) -> str:
    quoted = value_text(text)
    return quoted if quoted.startswith('"') else f'"{quoted}"'


def map_files(path: str | Path, jail: Path | None = None) -> list[tuple[Path, bool]]:
    """Return the files of a collection's maps, each with whether to crop the map; raises `MapFileError`.

    Paths in the collection are absolute, or relative to its folder; with a ``jail``, all files must be in that folder.
    """
    file = resolve(path, Path(), jail)
    files = []
    for number, line in enumerate(read_text(file).split("\n"), 1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        key, _, value = text.partition(" ")
        name, crop = value.strip(), False
        if name.endswith(" crop"):
            name, crop = name.removesuffix(" crop").rstrip(), True
        if key != "mapfile:" or not name:
            raise MapFileError(f"{file}, line {number}: expected 'mapfile: NAME.map [crop]', found {text!r:.100}")
        files.append((resolve(name, file.parent, jail), crop))
    return files


def load_maps(path: str | Path, jail: Path | None = None) -> dict[str, MapGrid2D]:
    """Read a collection's maps, by name; raises `MapFileError` like `map_files`, and if two maps share a name."""
    maps: dict[str, MapGrid2D] = {}
    for file, crop in map_files(path, jail):
        grid = MapGrid2D.load(file, jail)
        if grid.name in maps:
            raise MapFileError(f"{file}: the collection {path} already has a map named {grid.name!r}")
        if crop:
            grid.crop()
        maps[grid.name] = grid
    return maps


def save_maps(maps: Mapping[str, MapGrid2D], path: str | Path) -> None:
    """Write a collection and its maps to one folder; raises `MapFileError` if a map's name cannot be a file name."""
    file = Path(path)
    if sys.platform in ("win32", "darwin") and len({name.casefold() for name in maps}) < len(maps):
        raise MapFileError(f"{file}: two maps' names differ only in case, which file names here do not distinguish")
    for name, grid in maps.items():
        grid.save(file.with_name(f"{file_name(name)}.map"))
    write(file, "".join(f"mapfile: {name}.map\n" for name in sorted(maps)))
