"""Maps as YARP keeps them: a ``.map`` file that names an image of flags and a map of ROS (`yarp/dev/MapGrid2D.cpp`).

``MapName``, ``YarpMapData`` (the image), ``RosMapData`` (the YAML file), at least one of the two; ``resolution`` and
``origin (x y theta)`` go before what the YAML file says.

YARP takes the yaw of a YAML file for its theta, though it turns maps the other way. To be read rightly by YARP and by
map servers both, a map that is turned is written with its ``origin`` in the ``.map`` file, and with ROS's in the YAML.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev import mapfile, mapflag
from yarp_compat.dev.mapfile import MapFileError, decimal, found
from yarp_compat.dev.mapinfo import MapContents, MapGrid2DOrigin
from yarp_compat.dev.rosmap import RosMapHeader, occupancy_of_image, read_header

_LINE = re.compile(r'\s*(\w+)(?:\s*=\s*|\s+)("(?:[^"\\]|\\.)*"|.*?)\s*(?:\s(?:#|//).*)?$')


def load_yarp(path: str | Path, jail: Path | None = None) -> MapContents:
    """Read a map of YARP, in the folder ``jail`` where that is given; raises `MapFileError` for a wrong file."""
    file = found(path, Path(), jail)
    said = _settings(mapfile.read_text(file))
    if "MapName" not in said:
        raise MapFileError(f"{file} says no MapName")
    if not said.keys() & {"YarpMapData", "RosMapData"}:
        raise MapFileError(f"{file} says neither YarpMapData nor RosMapData")
    flags = occupancy = None
    header = RosMapHeader("", 1.0)
    if "YarpMapData" in said:
        flags = _flags(found(said["YarpMapData"], file.parent, jail))
    if "RosMapData" in said:
        yaml = found(said["RosMapData"], file.parent, jail)
        header = read_header(yaml)
        image = found(header.image, yaml.parent, jail)
        occupancy = _occupancy(image, header, painted=flags is not None)
    header = _overridden(header, said, file)
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
    return MapContents(flags, occupancy, said["MapName"], header.resolution, MapGrid2DOrigin(x, y, theta))


def save_yarp(grid: MapContents, path: str | Path) -> None:
    """Write a map for YARP: the ``.map`` file and, named after the map, three beside it; raises `MapFileError`."""
    file = Path(path)
    name = mapfile.file_name(grid.name)
    header = RosMapHeader(f"{name}_grid.pgm", grid.resolution, grid.origin.to_ros())
    mapfile.write_colours(file.with_name(f"{name}_yarpflags.ppm"), mapflag.picture_of_flags(grid.flags))
    mapfile.write_greys(file.with_name(header.image), mapflag.looked_up(grid.occupancy, mapflag.GREYS))
    mapfile.write(file.with_name(f"{name}_grid.yaml"), header.to_text())
    lines = [
        f"MapName {_word(name)}", f"YarpMapData {_word(name + '_yarpflags.ppm')}",
        f"RosMapData {_word(name + '_grid.yaml')}",
    ]  # fmt: skip
    if grid.origin.theta:
        lines.append(f"origin ({' '.join(map(decimal, grid.origin))})")
    mapfile.write(file, "\n".join(lines) + "\n")


def _settings(text: str) -> dict[str, str]:
    """The first value of each key: all of its line, as YARP writes names of several words without quotes."""
    said: dict[str, str] = {}
    for line in text.split("\n"):
        match = _LINE.match(line)
        if match and match[2]:
            key, value = match.groups()
            said.setdefault(key, re.sub(r"\\(.)", r"\1", value[1:-1]) if value[0] == '"' else value)
    return said


def _word(text: str) -> str:
    """A word of the file, quoted where it needs it."""
    if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.-]*", text):
        return text
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _flags(path: Path) -> NDArray[np.uint8]:
    pixels = mapfile.read_image(path)
    if pixels.dtype != np.uint8:
        raise MapFileError(f"{path}: an image of flags has colours of 8 bits")
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, axis=2)
    return mapflag.flags_of_picture(pixels[..., :3])


def _occupancy(path: Path, header: RosMapHeader, *, painted: bool) -> NDArray[np.uint8]:
    """The occupancy of an image: in YARP's greys where it stands beside one of flags, else as a map server reads it."""
    pixels = mapfile.read_image(path)
    if painted and pixels.ndim == 2 and pixels.dtype == np.uint8 and header.mode == "trinary" and not header.negate:
        return mapflag.looked_up(pixels, mapflag.OCCUPANCIES)
    return occupancy_of_image(pixels, header)


def _overridden(header: RosMapHeader, said: dict[str, str], file: Path) -> RosMapHeader:
    try:
        if "resolution" in said:
            header = replace(header, resolution=float(said["resolution"]))
        if "origin" in said:
            x, y, theta = (float(word) for word in re.split(r"[\s,]+", said["origin"].strip("() \t")))
            header = replace(header, origin=(x, y, theta), degrees=True)
    except ValueError:
        raise MapFileError(f"{file}: resolution is a number and origin (x y theta), three of them") from None
    if not all(map(np.isfinite, (header.resolution, *header.origin))) or header.resolution <= 0:
        raise MapFileError(f"{file}: no map has the resolution {header.resolution} and the origin {header.origin}")
    return header
