"""Collections of maps (``maps_collection.ini``), as YARP's map storage keeps them (`map2DStorage/Map2DStorage.cpp`).

A line for each map, ``mapfile: name.map``, behind which ``crop`` leaves out what is unknown at its edges.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from yarp_compat.dev.mapfile import MapFileError, file_name, found, read_text, write
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.yarpmap import load_yarp, save_yarp


def map_files(path: str | Path, jail: Path | None = None) -> list[tuple[Path, bool]]:
    """The maps' files that a collection names, and whether each is to be cropped.

    Args:
        path: the collection's file; the others are beside it, or where it says.
        jail: a folder that all files must be in.

    Raises:
        MapFileError: a file is not there, or a line means nothing.
    """
    file = found(path, Path(), jail)
    files = []
    for number, line in enumerate(read_text(file).split("\n"), 1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        key, _, rest = text.partition(" ")
        name, crop = rest.strip(), False
        if name.endswith(" crop"):
            name, crop = name.removesuffix(" crop").rstrip(), True
        if key != "mapfile:" or not name:
            raise MapFileError(f"{file}, line {number}: expected 'mapfile: NAME.map [crop]', found {text!r:.100}")
        files.append((found(name, file.parent, jail), crop))
    return files


def load_maps(path: str | Path, jail: Path | None = None) -> dict[str, MapGrid2D]:
    """Read a collection's maps, by name.

    Raises:
        MapFileError: as of :func:`map_files`, and where two maps have one name.
    """
    maps: dict[str, MapGrid2D] = {}
    for file, crop in map_files(path, jail):
        grid = load_yarp(file, jail)
        if grid.name in maps:
            raise MapFileError(f"{file}: a map named {grid.name!r} is in the collection {path} already")
        if crop:
            grid.crop()
        maps[grid.name] = grid
    return maps


def save_maps(maps: Mapping[str, MapGrid2D], path: str | Path) -> None:
    """Write a collection, and its maps beside it.

    Raises:
        MapFileError: a map's name cannot be a file's, or a file cannot be written.
    """
    file = Path(path)
    for name, grid in maps.items():
        save_yarp(grid, file.with_name(f"{file_name(name)}.map"))
    write(file, "".join(f"mapfile: {name}.map\n" for name in sorted(maps)))
