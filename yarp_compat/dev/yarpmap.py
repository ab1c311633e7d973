"""Maps in YARP's format: a ``.map`` file that names an image of flags and a map of ROS (`yarp/dev/MapGrid2D.cpp`).

Keys: ``MapName``, and ``YarpMapData`` (the image) or ``RosMapData`` (the YAML file) or both; ``resolution`` and
``origin (x y theta)`` override the YAML file.

YARP uses the yaw of a YAML file unchanged as theta, although YARP's maps rotate in the opposite direction. For both
YARP and map servers to read a rotated map correctly, the ``.map`` file gets YARP's ``origin``, and the YAML file ROS's.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev import mapfile, mapflag
from yarp_compat.dev.mapfile import MapFileError, decimal, resolve
from yarp_compat.dev.mapinfo import MapContents, MapGrid2DOrigin
from yarp_compat.dev.rosmap import RosMapHeader, occupancy_of_image, read_header

_LINE = re.compile(r'\s*(\w+)(?:\s*=\s*|\s+)("(?:[^"\\]|\\.)*"|.*?)\s*(?:\s(?:#|//).*)?$')


def load_yarp(path: str | Path, jail: Path | None = None) -> MapContents:
    """Read a YARP map, only from the folder ``jail`` if given; raises `MapFileError` for an invalid file."""
    file = resolve(path, Path(), jail)
    settings = _settings(mapfile.read_text(file))
    if "MapName" not in settings:
        raise MapFileError(f"{file}: the key MapName is missing")
    if not settings.keys() & {"YarpMapData", "RosMapData"}:
        raise MapFileError(f"{file}: one of the keys YarpMapData and RosMapData is required")
    flags = occupancy = None
    header = RosMapHeader("", 1.0)
    if "YarpMapData" in settings:
        flags = _flags(resolve(settings["YarpMapData"], file.parent, jail))
    if "RosMapData" in settings:
        yaml = resolve(settings["RosMapData"], file.parent, jail)
        header = read_header(yaml)
        image = resolve(header.image, yaml.parent, jail)
        occupancy = _occupancy(image, header, has_flags=flags is not None)
    header = _override(header, settings, file)
    if flags is None:
        assert occupancy is not None
        flags = mapflag.flags_of(occupancy)
    elif occupancy is None:
        occupancy = mapflag.occupancy_of(flags)
    elif flags.shape != occupancy.shape:
        raise MapFileError(
            f"{file}: the flags are {flags.shape[1]} x {flags.shape[0]} cells, the occupancy {occupancy.shape[1]} x "
            f"{occupancy.shape[0]}"
        )
    x, y, angle = header.origin
    theta = angle if header.degrees else float(np.degrees(angle))
    return MapContents(flags, occupancy, settings["MapName"], header.resolution, MapGrid2DOrigin(x, y, theta))


def files_of_map(path: Path) -> list[Path]:
    """Return the files of a map of YARP (``.map``) or ROS (YAML), the given one first; raises `MapFileError`."""
    file = resolve(path, Path(), None)
    if file.suffix.lower() != ".map":
        return [path, resolve(read_header(file).image, file.parent, None)]
    settings = _settings(mapfile.read_text(file))
    files = [path]
    if "YarpMapData" in settings:
        files.append(resolve(settings["YarpMapData"], file.parent, None))
    if "RosMapData" in settings:
        files += files_of_map(resolve(settings["RosMapData"], file.parent, None))
    return files


def save_yarp(grid: MapContents, path: str | Path) -> None:
    """Write a map for YARP: the ``.map`` file and three files named after the map; raises `MapFileError`."""
    file = Path(path)
    name = mapfile.file_name(grid.name)
    header = RosMapHeader(f"{name}_grid.pgm", grid.resolution, grid.origin.to_ros())
    mapfile.write_colors(file.with_name(f"{name}_yarpflags.ppm"), mapflag.picture_of_flags(grid.flags))
    mapfile.write_grays(file.with_name(header.image), mapflag.lookup(grid.occupancy, mapflag.GRAYS))
    mapfile.write(file.with_name(f"{name}_grid.yaml"), header.to_text())
    lines = [
        f"MapName {_quoted(name)}", f"YarpMapData {_quoted(name + '_yarpflags.ppm')}",
        f"RosMapData {_quoted(name + '_grid.yaml')}",
    ]  # fmt: skip
    if grid.origin.theta:
        lines.append(f"origin ({' '.join(map(decimal, grid.origin))})")
    mapfile.write(file, "\n".join(lines) + "\n")


def _settings(text: str) -> dict[str, str]:
    """Return each key's first value, which is the rest of its line: YARP does not quote names of several words."""
    settings: dict[str, str] = {}
    for line in text.split("\n"):
        match = _LINE.match(line)
        if match and match[2]:
            key, value = match.groups()
            settings.setdefault(key, re.sub(r"\\(.)", r"\1", value[1:-1]) if value[0] == '"' else value)
    return settings


def _quoted(text: str) -> str:
    if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.-]*", text):
        return text
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _flags(path: Path) -> NDArray[np.uint8]:
    pixels = mapfile.read_image(path)
    if pixels.dtype != np.uint8:
        raise MapFileError(f"{path}: an image of flags must have 8-bit colors")
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, axis=2)
    return mapflag.flags_of_picture(pixels[..., :3])


def _occupancy(path: Path, header: RosMapHeader, *, has_flags: bool) -> NDArray[np.uint8]:
    """Return the occupancy in an image.

    If the map also has an image of flags, an 8-bit gray image that is ``trinary`` and not negated is decoded with
    YARP's grays; any other image is decoded as map servers do.
    """
    pixels = mapfile.read_image(path)
    if has_flags and pixels.ndim == 2 and pixels.dtype == np.uint8 and header.mode == "trinary" and not header.negate:
        return mapflag.lookup(pixels, mapflag.OCCUPANCIES)
    return occupancy_of_image(pixels, header)


def _override(header: RosMapHeader, settings: dict[str, str], file: Path) -> RosMapHeader:
    try:
        if "resolution" in settings:
            header = replace(header, resolution=float(settings["resolution"]))
        if "origin" in settings:
            x, y, theta = (float(number) for number in re.split(r"[\s,]+", settings["origin"].strip("() \t")))
            header = replace(header, origin=(x, y, theta), degrees=True)
    except ValueError:
        raise MapFileError(f"{file}: resolution must be a number, and origin (x y theta) three numbers") from None
    if not all(map(np.isfinite, (header.resolution, *header.origin))) or header.resolution <= 0:
        raise MapFileError(f"{file}: invalid resolution {header.resolution} or origin {header.origin}")
    return header
