"""Maps as ROS keeps them: a YAML file that names an image (http://wiki.ros.org/map_server, nav2_map_server's map_io).

``image resolution origin: [x, y, yaw] negate occupied_thresh free_thresh mode``, with the yaw in radians. YARP writes
``origin: [ x y theta ]``, without commas and in degrees, which no map server reads; this recognises it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev.mapfile import MapFileError, decimal, file_name, found, grey_image, read_image, read_text, write
from yarp_compat.dev.mapflag import UNKNOWN, flags_of, looked_up
from yarp_compat.dev.mapinfo import MapContents, MapGrid2DOrigin

MODES = ("trinary", "scale", "raw")
_LONGEST = 1 << 16
_DEEPEST = 8
_UNKNOWN_GREY = 205
_BAND = 1 << 20  # cells


_BETWEEN = np.isin(np.arange(256), (0, 100, UNKNOWN), invert=True).astype(np.uint8)
"""Whether an occupancy is one that ``trinary`` images cannot hold."""


_BEYOND = np.where(np.arange(256) <= 100, 0, UNKNOWN).astype(np.uint8)
"""All bits set for what is no occupancy, so that what is one stays beside it."""


@dataclass(frozen=True)
class RosMapHeader:
    """The content of the YAML file."""

    image: str  # the image's file
    resolution: float  # metres per cell
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # the place of the lower left corner, as the file says it
    # the origin is YARP's, whose third number is its theta in degrees, and not ROS's yaw in radians
    degrees: bool = False
    negate: bool = False  # white is occupied, not black
    occupied_thresh: float = 0.65  # pixels that are more surely occupied are occupied, 0 to 1
    # those that are less so are free. Map servers take unknown cells (205, which is 0.19608) for free with YARP's 0.2
    # or Nav2's 0.25
    free_thresh: float = 0.196
    # ``trinary`` (what is between is unknown), ``scale`` (a part of the way between, transparent is unknown) or ``raw``
    # (the pixel's number is the occupancy, above 100 unknown)
    mode: str = "trinary"

    def to_text(self) -> str:
        """The YAML file."""
        origin = ", ".join(map(decimal, self.origin))
        return (
            f"image: {_scalar(self.image)}\nmode: {self.mode}\nresolution: {decimal(self.resolution)}\n"
            f"origin: [{origin}]\nnegate: {int(self.negate)}\n"
            f"occupied_thresh: {decimal(self.occupied_thresh)}\nfree_thresh: {decimal(self.free_thresh)}\n"
        )


def load_ros(path: str | Path, jail: Path | None = None) -> MapContents:
    """Read a map of ROS from its YAML file, whose name it has; with a ``jail`` all files must be in that folder.

    The flags are those that YARP gives such a map: free below 50, wall from there on, unknown. Raises `MapFileError`.
    """
    file = found(path, Path(), jail)
    header = read_header(file)
    flags, occupancy = _cells(read_image(found(header.image, file.parent, jail)), header)
    origin = MapGrid2DOrigin(*header.origin) if header.degrees else MapGrid2DOrigin.from_ros(*header.origin)
    return MapContents(flags, occupancy, file.stem, header.resolution, origin)


def save_ros(
    grid: MapContents,  # the map
    path: str | Path,  # the YAML file; the image stands beside it, under the same name
    *,
    image: str = "pgm",  # its kind: ``pgm``, ``png`` or ``bmp``
    # as of :class:`RosMapHeader`; by default ``trinary``, or ``raw`` where the map has an occupancy that gets lost
    # there. ``scale`` is for png, which can say what is unknown
    mode: str = "",
    negate: bool = False,  # paint occupied cells white; not in ``raw``
    occupied_thresh: float = 0.65,  # as of :class:`RosMapHeader`
    free_thresh: float = 0.196,  # as of :class:`RosMapHeader`
) -> None:
    """Write a map as ROS keeps it: its occupancy, and no flags.

    Raises:
        MapFileError: it cannot be written so.
    """
    file = Path(path)
    if image not in ("pgm", "png", "bmp"):
        raise MapFileError(f"images of maps are pgm, png or bmp, not {image!r:.30}")
    mode = mode or ("raw" if looked_up(grid.occupancy, _BETWEEN).any() else "trinary")
    header = RosMapHeader(
        f"{file_name(file.stem)}.{image}", grid.resolution, grid.origin.to_ros(), negate=negate and mode != "raw",
        occupied_thresh=occupied_thresh, free_thresh=free_thresh, mode=mode,
    )  # fmt: skip
    _check(header, file)
    if mode == "scale" and image != "png":
        raise MapFileError(f"the mode scale needs png images, which can say what is unknown, not {image}")
    write(file.with_name(header.image), *grey_image(image, _painted(grid.occupancy, header)))
    write(file, header.to_text())


def read_header(path: Path) -> RosMapHeader:
    """The content of a YAML file; raises `MapFileError` where it is none of a map."""
    said = _mapping(path)
    for key in ("image", "resolution", "origin"):
        if key not in said:
            raise MapFileError(f"{path} says no {key}")
    if not isinstance(said["image"], str) or not said["image"]:
        raise MapFileError(f"{path}: image is a file's name, not {said['image']!r:.60}")
    origin, degrees = _origin(said["origin"], path)
    header = RosMapHeader(
        said["image"],
        _number(said, "resolution", path, 0.0),
        origin,
        degrees,
        bool(_number(said, "negate", path, 0.0)),
        _number(said, "occupied_thresh", path, RosMapHeader.occupied_thresh),
        _number(said, "free_thresh", path, RosMapHeader.free_thresh),
        str(said.get("mode", "trinary")).lower(),
    )
    _check(header, path)
    return header


def occupancy_of_image(pixels: NDArray[Any], header: RosMapHeader) -> NDArray[np.uint8]:
    """The occupancy, 0 to 100 or 255, that map servers read; in ``trinary`` they take the opacity for a colour."""
    if pixels.ndim == 2:
        if header.mode == "raw" and pixels.dtype == np.uint8:
            return pixels | looked_up(pixels, _BEYOND)
        table = _table(np.iinfo(pixels.dtype).max, header)
        return looked_up(pixels, table) if pixels.dtype == np.uint8 else table[pixels]
    channels = 4 if header.mode == "trinary" and pixels.shape[2] == 4 else 3
    sums = pixels[..., 0].astype(np.uint16)
    for channel in range(1, channels):
        sums += pixels[..., channel]
    occupancy = _table(255 * channels, header)[sums]
    if header.mode == "scale" and pixels.shape[2] == 4:
        occupancy[pixels[..., 3] < 255] = UNKNOWN
    return occupancy


def _cells(pixels: NDArray[Any], header: RosMapHeader) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The flags and the occupancy, made of some rows at a time, so that what lies between stays in the cache."""
    height, width = pixels.shape[:2]
    rows = max(1, _BAND // max(1, width))
    if height <= rows:
        occupancy = occupancy_of_image(pixels, header)
        return flags_of(occupancy), occupancy
    flags, occupancy = np.empty((height, width), np.uint8), np.empty((height, width), np.uint8)
    for top in range(0, height, rows):
        band = slice(top, top + rows)
        occupancy[band] = occupancy_of_image(pixels[band], header)
        flags[band] = flags_of(occupancy[band])
    return flags, occupancy


@lru_cache(maxsize=4)
def _table(most: int, header: RosMapHeader) -> NDArray[np.uint8]:
    """The occupancy of each number of pixels that reach from 0 to this one; kept, as all bands of a map ask for it."""
    return _meant(np.arange(most + 1) / most, header)


def _meant(shades: NDArray[np.float64], header: RosMapHeader) -> NDArray[np.uint8]:
    """The occupancy of shades from 0 (black) to 1."""
    if header.mode == "raw":
        numbers = np.round(shades * 255)
        return np.where(numbers <= 100, numbers, UNKNOWN).astype(np.uint8)
    occupied = shades if header.negate else 1.0 - shades
    between = np.full(len(shades), UNKNOWN)
    if header.mode == "scale":
        room = max(header.occupied_thresh - header.free_thresh, 1e-9)
        between = np.clip(np.rint((occupied - header.free_thresh) / room * 100), 0, 100)
    ends = np.where(occupied > header.occupied_thresh, 100, np.where(occupied < header.free_thresh, 0, between))
    return ends.astype(np.uint8)


def _painted(occupancy: NDArray[np.uint8], header: RosMapHeader) -> NDArray[np.uint8]:
    """The pixels that are read back as this occupancy."""
    cells = np.arange(256)
    known = cells <= 100
    if header.mode == "raw":
        return looked_up(occupancy, np.where(known, cells, 255).astype(np.uint8))
    if header.mode == "scale":
        part = header.free_thresh + cells / 100 * (header.occupied_thresh - header.free_thresh)
        greys = np.where(cells == 0, 255, np.where(cells >= 100, 0, np.round(255 * (1 - part))))
    else:
        greys = np.where(cells <= header.free_thresh * 100, 254, _UNKNOWN_GREY)
        greys = np.where(known & (cells >= header.occupied_thresh * 100), 0, greys)
        greys = np.where(known, greys, _UNKNOWN_GREY)
    table = (255 - greys if header.negate else greys).clip(0, 255).astype(np.uint8)
    if header.mode == "trinary":
        return looked_up(occupancy, table)
    pixels = np.empty((*occupancy.shape, 4), np.uint8)
    pixels[..., :3] = looked_up(occupancy, table)[..., None]
    pixels[..., 3] = looked_up(occupancy, (known * 255).astype(np.uint8))
    return pixels


def _check(header: RosMapHeader, path: Path) -> None:
    if not header.resolution > 0:
        raise MapFileError(f"{path}: resolution is metres per cell above 0, not {header.resolution}")
    if header.mode not in MODES:
        raise MapFileError(f"{path}: mode is {', '.join(MODES)}, not {header.mode!r:.30}")
    if not 0 <= header.free_thresh <= header.occupied_thresh <= 1:
        raise MapFileError(
            f"{path}: 0 <= free_thresh <= occupied_thresh <= 1 does not hold for {header.free_thresh} and "
            f"{header.occupied_thresh}"
        )


def _mapping(path: Path) -> Mapping[str, Any]:
    """A YAML file's content: no aliases, which a few bytes make huge, and nothing deep."""
    import yaml

    text = read_text(path)
    if len(text) > _LONGEST:
        raise MapFileError(f"{path} is longer than {_LONGEST} characters, too long for a map's YAML file")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the compiled one is ten times as fast
    try:
        if _may_be_huge(text):
            _check_events(yaml.parse(text, loader), path)
        said = yaml.load(text, loader)  # noqa: S506 - a safe one
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        if isinstance(error, MapFileError):
            raise
        raise MapFileError(f"{path} is no YAML: {' '.join(str(error).split())}") from None
    if not isinstance(said, dict):
        raise MapFileError(f"{path} is no YAML file of a map: it has no keys")
    return said


def _may_be_huge(text: str) -> bool:
    """Whether it has signs of what `_check_events` refuses: a look at each event takes as long as all the rest."""
    return "*" in text or sum(map(text.count, ("[", "{", "- ", "? "))) > _DEEPEST


def _check_events(events: Iterable[Any], path: Path) -> None:
    import yaml

    depth = 0
    for event in events:
        if isinstance(event, yaml.AliasEvent):
            raise MapFileError(f"{path}: a map's YAML file has no aliases (*{event.anchor})")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise MapFileError(f"{path}: a map's YAML file has no lists so deep within each other")


def _origin(said: Any, path: Path) -> tuple[tuple[float, float, float], bool]:
    words = said if isinstance(said, list) else [said]
    degrees = len(words) == 1 and isinstance(words[0], str)
    if degrees:
        words = words[0].split()
    try:
        x, y, angle = (float(word) for word in words)
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(angle):
            return (x, y, angle), degrees
    except (TypeError, ValueError):
        pass
    raise MapFileError(f"{path}: origin is [x, y, yaw], three numbers, not {said!r:.60}")


def _number(said: Mapping[str, Any], key: str, path: Path, default: float) -> float:
    try:
        number = float(said.get(key, default))
        if math.isfinite(number):
            return number
    except (TypeError, ValueError):
        pass
    raise MapFileError(f"{path}: {key} is a number, not {said[key]!r:.60}")


def _scalar(text: str) -> str:
    """A text as a YAML scalar, in the quotes that YARP knows too where it needs them."""
    if text.replace("_", "a").replace("-", "a").replace(".", "a").isalnum() and text.isascii():
        return text
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
