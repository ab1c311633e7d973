"""Maps in ROS's format: a YAML file that names an image (http://wiki.ros.org/map_server, nav2_map_server's map_io).

The keys are ``image resolution origin negate occupied_thresh free_thresh mode``; the origin is ``[x, y, yaw]``, with
the yaw in radians. YARP writes ``origin: [ x y theta ]``, without commas and in degrees, which map servers reject; this
module recognizes it.
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

from yarp_compat.dev.mapfile import MapFileError, decimal, file_name, gray_image, read_image, read_text, resolve, write
from yarp_compat.dev.mapflag import UNKNOWN, flags_of, lookup
from yarp_compat.dev.mapinfo import MapContents, MapGrid2DOrigin

MODES = ("trinary", "scale", "raw")
_LONGEST = 1 << 16  # maximum characters of a map's YAML file
_DEEPEST = 8  # maximum nesting of its lists and mappings
_UNKNOWN_GRAY = 205
_BAND = 1 << 20  # cells per step, so that intermediate results stay in the cache


_BETWEEN = np.isin(np.arange(256), (0, 100, UNKNOWN), invert=True).astype(np.uint8)
"""Whether ``trinary`` images cannot represent an occupancy."""


_BEYOND = np.where(np.arange(256) <= 100, 0, UNKNOWN).astype(np.uint8)
"""A mask to combine with pixels by "or": all bits set for numbers that are not an occupancy."""


@dataclass(frozen=True)
class RosMapHeader:
    """The content of the YAML file."""

    image: str  # the image file
    resolution: float  # meters per cell
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # the pose of the lower left corner, as in the file
    # the origin is YARP's, with theta in degrees, instead of ROS's, with the yaw in radians
    degrees: bool = False
    negate: bool = False  # white is occupied instead of black
    occupied_thresh: float = 0.65  # pixels with a higher probability are occupied, 0 to 1
    # pixels with a lower probability are free. With YARP's 0.2 or Nav2's 0.25, map servers read unknown cells (gray
    # 205, which is 0.19608) as free
    free_thresh: float = 0.196
    # ``trinary`` (unknown between the thresholds), ``scale`` (interpolated between them, transparent is unknown) or
    # ``raw`` (the pixel's number is the occupancy, above 100 unknown)
    mode: str = "trinary"

    def to_text(self) -> str:
        """Return the content of the YAML file."""
        origin = ", ".join(map(decimal, self.origin))
        return (
            f"image: {_scalar(self.image)}\nmode: {self.mode}\nresolution: {decimal(self.resolution)}\n"
            f"origin: [{origin}]\nnegate: {int(self.negate)}\n"
            f"occupied_thresh: {decimal(self.occupied_thresh)}\nfree_thresh: {decimal(self.free_thresh)}\n"
        )


def load_ros(path: str | Path, jail: Path | None = None) -> MapContents:
    """Read a ROS map from its YAML file; with a ``jail``, all files must be in that folder.

    The map gets the file's name without its suffix, and the flags that YARP assigns: free below 50, wall up to 100,
    else unknown. Raises `MapFileError`.
    """
    file = resolve(path, Path(), jail)
    header = read_header(file)
    flags, occupancy = _cells(read_image(resolve(header.image, file.parent, jail)), header)
    origin = MapGrid2DOrigin(*header.origin) if header.degrees else MapGrid2DOrigin.from_ros(*header.origin)
    return MapContents(flags, occupancy, file.stem, header.resolution, origin)


def save_ros(
    grid: MapContents,  # the map
    path: str | Path,  # the YAML file; the image is written to the same folder with the same name
    *,
    image: str = "pgm",  # ``pgm``, ``png`` or ``bmp``
    # as in :class:`RosMapHeader`; by default ``trinary``, or ``raw`` if ``trinary`` would lose occupancies. ``scale``
    # needs png, where transparent pixels are unknown
    mode: str = "",
    negate: bool = False,  # paint occupied cells white; ignored in ``raw``
    occupied_thresh: float = 0.65,  # as in :class:`RosMapHeader`
    free_thresh: float = 0.196,  # as in :class:`RosMapHeader`
) -> None:
    """Write a map in ROS's format: its occupancy, without its flags.

    Raises:
        MapFileError: an option is invalid, or a file cannot be written.
    """
    file = Path(path)
    if image not in ("pgm", "png", "bmp"):
        raise MapFileError(f"images of maps must be pgm, png or bmp, not {image!r:.30}")
    mode = mode or ("raw" if lookup(grid.occupancy, _BETWEEN).any() else "trinary")
    header = RosMapHeader(
        f"{file_name(file.stem)}.{image}", grid.resolution, grid.origin.to_ros(), negate=negate and mode != "raw",
        occupied_thresh=occupied_thresh, free_thresh=free_thresh, mode=mode,
    )  # fmt: skip
    _check(header, file)
    if mode == "scale" and image != "png":
        raise MapFileError(f"the mode scale needs png images, whose transparent pixels are unknown, not {image}")
    write(file.with_name(header.image), *gray_image(image, _painted(grid.occupancy, header)))
    write(file, header.to_text())


def read_header(path: Path) -> RosMapHeader:
    """Read the YAML file of a map; raises `MapFileError` if it is invalid."""
    settings = _mapping(path)
    for key in ("image", "resolution", "origin"):
        if key not in settings:
            raise MapFileError(f"{path}: the key {key} is missing")
    if not isinstance(settings["image"], str) or not settings["image"]:
        raise MapFileError(f"{path}: image must be a file name, not {settings['image']!r:.60}")
    origin, degrees = _origin(settings["origin"], path)
    header = RosMapHeader(
        settings["image"],
        _number(settings, "resolution", path, 0.0),
        origin,
        degrees,
        bool(_number(settings, "negate", path, 0.0)),
        _number(settings, "occupied_thresh", path, RosMapHeader.occupied_thresh),
        _number(settings, "free_thresh", path, RosMapHeader.free_thresh),
        str(settings.get("mode", "trinary")).lower(),
    )
    _check(header, path)
    return header


def occupancy_of_image(pixels: NDArray[Any], header: RosMapHeader) -> NDArray[np.uint8]:
    """Return the occupancy, 0 to 100 or 255, as map servers do; in ``trinary`` they count the opacity as a color."""
    if pixels.ndim == 2:
        if header.mode == "raw" and pixels.dtype == np.uint8:
            return pixels | lookup(pixels, _BEYOND)
        table = _table(np.iinfo(pixels.dtype).max, header)
        return lookup(pixels, table) if pixels.dtype == np.uint8 else table[pixels]
    channels = 4 if header.mode == "trinary" and pixels.shape[2] == 4 else 3
    sums = pixels[..., 0].astype(np.uint16)
    for channel in range(1, channels):
        sums += pixels[..., channel]
    occupancy = _table(255 * channels, header)[sums]
    if header.mode == "scale" and pixels.shape[2] == 4:
        occupancy[pixels[..., 3] < 255] = UNKNOWN
    return occupancy


def _cells(pixels: NDArray[Any], header: RosMapHeader) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the flags and the occupancy, computed in bands of rows."""
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
    """Return the occupancy of each gray from 0 to ``most``; cached for the bands of a map."""
    return _occupancy_of_shades(np.arange(most + 1) / most, header)


def _occupancy_of_shades(shades: NDArray[np.float64], header: RosMapHeader) -> NDArray[np.uint8]:
    """Return the occupancy of shades from 0 (black) to 1 (white)."""
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
    """Return the pixels that are read back as this occupancy."""
    cells = np.arange(256)
    known = cells <= 100
    if header.mode == "raw":
        return lookup(occupancy, np.where(known, cells, 255).astype(np.uint8))
    if header.mode == "scale":
        part = header.free_thresh + cells / 100 * (header.occupied_thresh - header.free_thresh)
        grays = np.where(cells == 0, 255, np.where(cells >= 100, 0, np.round(255 * (1 - part))))
    else:
        grays = np.where(cells <= header.free_thresh * 100, 254, _UNKNOWN_GRAY)
        grays = np.where(known & (cells >= header.occupied_thresh * 100), 0, grays)
        grays = np.where(known, grays, _UNKNOWN_GRAY)
    table = (255 - grays if header.negate else grays).clip(0, 255).astype(np.uint8)
    if header.mode == "trinary":
        return lookup(occupancy, table)
    pixels = np.empty((*occupancy.shape, 4), np.uint8)
    pixels[..., :3] = lookup(occupancy, table)[..., None]
    pixels[..., 3] = lookup(occupancy, (known * 255).astype(np.uint8))
    return pixels


def _check(header: RosMapHeader, path: Path) -> None:
    if not header.resolution > 0:
        raise MapFileError(f"{path}: resolution must be meters per cell above 0, not {header.resolution}")
    if header.mode not in MODES:
        raise MapFileError(f"{path}: mode must be one of {', '.join(MODES)}, not {header.mode!r:.30}")
    if not 0 <= header.free_thresh <= header.occupied_thresh <= 1:
        raise MapFileError(
            f"{path}: free_thresh {header.free_thresh} and occupied_thresh {header.occupied_thresh} must be "
            "ascending numbers from 0 to 1"
        )


def _mapping(path: Path) -> Mapping[str, Any]:
    """Parse a YAML file; reject aliases, which can expand a few bytes enormously, and deep nesting."""
    import yaml

    text = read_text(path)
    if len(text) > _LONGEST:
        raise MapFileError(f"{path} is longer than {_LONGEST} characters, too long for a map's YAML file")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the compiled loader is ten times as fast
    try:
        if _may_be_huge(text):
            _check_events(yaml.parse(text, loader), path)
        content = yaml.load(text, loader)  # noqa: S506 - a safe loader
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        if isinstance(error, MapFileError):
            raise
        raise MapFileError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise MapFileError(f"{path} is not the YAML file of a map: it has no keys")
    return content


def _may_be_huge(text: str) -> bool:
    """Whether `_check_events` could reject a text: checking each event takes as long as parsing."""
    return "*" in text or sum(map(text.count, ("[", "{", "- ", "? "))) > _DEEPEST


def _check_events(events: Iterable[Any], path: Path) -> None:
    import yaml

    depth = 0
    for event in events:
        if isinstance(event, yaml.AliasEvent):
            raise MapFileError(f"{path}: aliases (*{event.anchor}) are not allowed in a map's YAML file")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise MapFileError(f"{path}: lists are nested too deep for a map's YAML file")


def _origin(value: Any, path: Path) -> tuple[tuple[float, float, float], bool]:
    parts = value if isinstance(value, list) else [value]
    degrees = len(parts) == 1 and isinstance(parts[0], str)
    if degrees:
        parts = parts[0].split()
    try:
        x, y, angle = (float(part) for part in parts)
        if math.isfinite(x) and math.isfinite(y) and math.isfinite(angle):
            return (x, y, angle), degrees
    except (TypeError, ValueError):
        pass
    raise MapFileError(f"{path}: origin must be [x, y, yaw], three numbers, not {value!r:.60}")


def _number(settings: Mapping[str, Any], key: str, path: Path, default: float) -> float:
    try:
        number = float(settings.get(key, default))
        if math.isfinite(number):
            return number
    except (TypeError, ValueError):
        pass
    raise MapFileError(f"{path}: {key} must be a number, not {settings[key]!r:.60}")


def _scalar(text: str) -> str:
    """Format a text as a YAML scalar, if necessary in quotes that YARP understands too."""
    if text.replace("_", "a").replace("-", "a").replace(".", "a").isalnum() and text.isascii():
        return text
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
