"""Maps (`yarp/dev/MapGrid2D.h`): an occupancy and a flag for each cell.

On the wire: ``width height x y theta resolution name compressed {occupancy} {flags}``, rows from top to bottom,
occupancy 0 to 100 or 255 for unknown. The two blobs are compressed with zlib if ``compressed`` is 1, the default.
"""

from __future__ import annotations

import logging
import math
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yarp_compat.dev import mapflag
from yarp_compat.dev.mapflag import MAX_CELLS, UNKNOWN, MapFlag, flags_of, occupancy_of, too_large
from yarp_compat.dev.mapinfo import MapContents, MapGrid2DInfo, MapGrid2DOrigin, Pair, numbers
from yarp_compat.dev.rosmap import load_ros, save_ros
from yarp_compat.dev.yarpmap import load_yarp, save_yarp
from yarp_compat.overriding import override
from yarp_compat.sig.image import ImageMono, ImageRgb
from yarp_compat.wire.accessors import getter
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.tags import INT8

__all__ = ["MAX_CELLS", "UNKNOWN", "MapFlag", "MapGrid2D", "flags_of", "occupancy_of", "too_large"]

log = logging.getLogger(__name__)

_LONGEST_NAME = 254  # bytes that fit into the buffer of YARP's reader


class MapGrid2D(MapGrid2DInfo, Portable):
    """A map; by default of 2 by 2 free cells of one meter. :meth:`of` makes any other map."""

    map_flags: ClassVar = MapFlag
    MAP_CELL_FREE: ClassVar = MapFlag.FREE
    MAP_CELL_KEEP_OUT: ClassVar = MapFlag.KEEP_OUT
    MAP_CELL_TEMPORARY_OBSTACLE: ClassVar = MapFlag.TEMPORARY_OBSTACLE
    MAP_CELL_ENLARGED_OBSTACLE: ClassVar = MapFlag.ENLARGED_OBSTACLE
    MAP_CELL_WALL: ClassVar = MapFlag.WALL
    MAP_CELL_UNKNOWN: ClassVar = MapFlag.UNKNOWN

    def __init__(self) -> None:
        super().__init__("", 2, 2, 1.0)
        self._occupancy = np.zeros((2, 2), np.uint8)
        self._flags = np.zeros((2, 2), np.uint8)
        self.compressed = True  # whether the cells are compressed on the wire

    @classmethod
    def of(
        cls,
        flags: ArrayLike,  # a :class:`MapFlag` for each cell, of shape (height, width), rows from top to bottom
        # 0 to 100 or 255, of the same shape; by default from the flags: 100 for walls, 255 for unknown cells
        occupancy: ArrayLike | None = None,
        *,
        name: str = "",  # of the map
        resolution: float = 1.0,  # meters per cell
        origin: Iterable[float] = (0.0, 0.0, 0.0),  # the lower left corner: meters, meters, degrees
    ) -> Self:
        """Make a map from arrays of cells, without copying uint8 arrays.

        Raises:
            ValueError: the shapes differ or are not two-dimensional, a value exceeds a byte, the map is too large, or
                the resolution or origin is invalid.
        """
        grid = cls()
        grid.set_cells(flags, occupancy)
        grid.m_map_name = name
        grid.m_origin = MapGrid2DOrigin(*origin)
        if not grid.setResolution(resolution):
            raise ValueError(f"a cell cannot be {resolution} meters wide")
        return grid

    @property
    def flags(self) -> NDArray[np.uint8]:
        """The cells' flags, of shape (height, width), rows from top to bottom; may be changed in place."""
        return self._flags

    @property
    def occupancy(self) -> NDArray[np.uint8]:
        """The occupancy of each cell, 0 to 100, or 255; has the shape of the flags, and may be changed in place."""
        return self._occupancy

    def set_cells(self, flags: ArrayLike, occupancy: ArrayLike | None = None) -> None:
        """Replace the cells; for the arguments, see :meth:`of`."""
        new = _bytes(flags)
        if new.ndim != 2:
            raise ValueError(f"the cells of a map must have the shape (height, width), not {new.shape}")
        if new.size > MAX_CELLS:
            raise ValueError(too_large(new.shape[1], new.shape[0]))
        cells = occupancy_of(new) if occupancy is None else _bytes(occupancy)
        if cells.shape != new.shape:
            raise ValueError(f"the flags have the shape {new.shape}, but the occupancy {cells.shape}")
        self._flags, self._occupancy = new, cells
        self.m_height, self.m_width = new.shape

    width = getter("m_width", int, "The width in cells.")
    height = getter("m_height", int, "The height in cells.")
    getMapName = getter("m_map_name", str, "The map's name.")

    def setMapName(self, name: str) -> bool:
        """Rename the map; False if the name is empty."""
        if name:
            self.m_map_name = name
        return bool(name)

    getResolution = getter("m_resolution", float, "Meters per cell.")

    def setResolution(self, resolution: float) -> bool:
        """Set the size of cells in meters; False if it is invalid."""
        if not (math.isfinite(resolution) and resolution > 0):
            return False
        self.m_resolution = float(resolution)
        return True

    def getOrigin(self) -> tuple[float, float, float]:
        """Return the pose of the lower left corner: meters, meters, degrees."""
        return self.m_origin.x, self.m_origin.y, self.m_origin.theta

    def setOrigin(self, x: float, y: float, theta: float) -> bool:
        """Set the pose of the lower left corner."""
        self.m_origin.setOrigin(x, y, theta)
        return True

    def getSize_in_cells(self) -> tuple[int, int]:
        """Return width and height in cells."""
        return self.m_width, self.m_height

    def setSize_in_cells(self, width: int, height: int) -> bool:
        """Change the size and make all cells free; return False unless both numbers are above 0.

        Raises `ValueError` if the map would be too large.
        """
        if not (width > 0 and height > 0):
            return False
        if width * height > MAX_CELLS:
            raise ValueError(too_large(width, height))
        self.set_cells(np.zeros((height, width), np.uint8), np.zeros((height, width), np.uint8))
        return True

    def getSize_in_meters(self) -> tuple[float, float]:
        """Return width and height in meters."""
        return self.m_width * self.m_resolution, self.m_height * self.m_resolution

    def setSize_in_meters(self, width: float, height: float) -> bool:
        """Change the size and make all cells free, like `setSize_in_cells`."""
        return self.setSize_in_cells(int(width / self.m_resolution), int(height / self.m_resolution))

    def getMapFlag(self, cell: Pair) -> MapFlag | None:
        """Return a cell's flag; None outside of the map."""
        at = self._index(cell)
        return None if at is None else MapFlag(self._flags[at])

    def setMapFlag(self, cell: Pair, flag: MapFlag | int) -> bool:
        """Set a cell's flag; False outside of the map."""
        at = self._index(cell)
        if at is not None:
            self._flags[at] = MapFlag(flag)
        return at is not None

    def getOccupancyData(self, cell: Pair) -> float | None:
        """Return the occupancy of a cell, 0 to 100, or -1 for unknown; None outside of the map."""
        at = self._index(cell)
        if at is None:
            return None
        occupancy = int(self._occupancy[at])
        return -1.0 if occupancy == UNKNOWN else float(occupancy)

    def setOccupancyData(self, cell: Pair, occupancy: float) -> bool:
        """Set a cell's occupancy (below 0: unknown); return False outside of the map. Raises `ValueError` above 100."""
        if not occupancy <= 100:
            raise ValueError(f"a cell's occupancy must be at most 100, not {occupancy}")
        at = self._index(cell)
        if at is not None:
            self._occupancy[at] = UNKNOWN if occupancy < 0 else int(occupancy)
        return at is not None

    def isFree(self, cell: Pair) -> bool:
        """Whether a cell of the map has occupancy 0 and the flag for free cells."""
        at = self._index(cell)
        return at is not None and not self._occupancy[at] and not self._flags[at]

    def isNotFree(self, cell: Pair) -> bool:
        """Whether a cell of the map is an obstacle or a keep-out cell, or its occupancy is above 0 or unknown."""
        at = self._index(cell)
        if at is None:
            return False
        flag = self._flags[at]
        return bool(self._occupancy[at]) or MapFlag.KEEP_OUT <= flag <= MapFlag.ENLARGED_OBSTACLE

    def isKeepOut(self, cell: Pair) -> bool:
        """Whether a cell is a keep-out cell."""
        at = self._index(cell)
        return at is not None and self._flags[at] == MapFlag.KEEP_OUT

    def isWall(self, cell: Pair) -> bool:
        """Whether a cell is a wall."""
        at = self._index(cell)
        return at is not None and self._flags[at] == MapFlag.WALL

    def clearMapTemporaryFlags(self) -> None:
        """Make temporary and enlarged obstacles free."""
        temporary = (self._flags == MapFlag.TEMPORARY_OBSTACLE) | (self._flags == MapFlag.ENLARGED_OBSTACLE)
        self._flags[temporary] = MapFlag.FREE

    def enlargeObstacles(self, size: float) -> bool:
        """Mark free cells within ``size`` meters of other cells (see `enlarge`) as enlarged obstacles.

        With 0 or less, make all enlarged obstacles free.
        """
        if size > 0:
            enlarge(self._flags, math.ceil(min(size / self.m_resolution, self.m_width + self.m_height)))
        else:
            self._flags[self._flags == MapFlag.ENLARGED_OBSTACLE] = MapFlag.FREE
        return True

    def crop(self, left: int = -1, top: int = -1, right: int = -1, bottom: int = -1) -> bool:
        """Crop to the columns [left, right) and the rows [top, bottom); return False if the range is invalid.

        A negative number stands for the outermost known cell on its side. (YARP then drops one column at the right.)
        """
        if min(left, top, right, bottom) < 0:
            known = self._occupancy != UNKNOWN
            columns, rows = np.flatnonzero(known.any(axis=0)), np.flatnonzero(known.any(axis=1))
            if not len(columns):
                return False
            left, right = int(columns[0]) if left < 0 else left, int(columns[-1]) + 1 if right < 0 else right
            top, bottom = int(rows[0]) if top < 0 else top, int(rows[-1]) + 1 if bottom < 0 else bottom
        if not (left < right <= self.m_width and top < bottom <= self.m_height):
            return False
        x, y, theta = self.getOrigin()
        x, y = x + left * self.m_resolution, y + (self.m_height - bottom) * self.m_resolution
        part = slice(top, bottom), slice(left, right)
        self.set_cells(self._flags[part].copy(), self._occupancy[part].copy())
        self.m_origin = MapGrid2DOrigin(x, y, theta)
        return True

    def getMapImage(self, image: ImageRgb) -> bool:
        """Paint the flags in their colors into an image."""
        image.copy(ImageRgb.of(mapflag.picture_of_flags(self._flags)))
        return True

    def setMapImage(self, image: ImageRgb) -> bool:
        """Set the flags from their colors; other colors become unknown. Return False if the image has another size."""
        if (image.width(), image.height()) != self.getSize_in_cells():
            return False
        self._flags = mapflag.flags_of_picture(image.numpy())
        return True

    def getOccupancyGrid(self, image: ImageMono) -> bool:
        """Copy the occupancy of the cells, 0 to 100 or 255, to an image."""
        image.copy(ImageMono.of(self._occupancy.copy()))
        return True

    def setOccupancyGrid(self, image: ImageMono) -> bool:
        """Set the occupancy from an image's pixels; False if the image has another size."""
        if (image.width(), image.height()) != self.getSize_in_cells():
            return False
        self._occupancy = image.numpy().copy()
        return True

    def loadFromFile(self, map_filename: str) -> bool:
        """Load a map file, see :meth:`load`; return False, with the reason in the log, on failure."""
        try:
            loaded = type(self).load(map_filename)
        except ValueError as error:
            log.error("%s", error)
            return False
        loaded.compressed = self.compressed
        self._become(loaded)
        return True

    def saveToFile(self, map_filename: str) -> bool:
        """Write a map file, see :meth:`save`; return False, with the reason in the log, on failure."""
        try:
            self.save(map_filename)
        except ValueError as error:
            log.error("%s", error)
            return False
        return True

    @classmethod
    def load(cls, path: str | Path, jail: Path | None = None) -> Self:
        """Read a map of YARP (``.map``) or of ROS (any other file, which is YAML); raises `MapFileError`.

        Paths in the file are absolute, or relative to its folder; with a ``jail``, all files must be in that folder.
        """
        read = load_yarp(path, jail) if Path(path).suffix.lower() == ".map" else load_ros(path, jail)
        return cls.of(read.flags, read.occupancy, name=read.name, resolution=read.resolution, origin=read.origin)

    def save(self, path: str | Path, **ros: Any) -> None:
        """Write a map for YARP (``.map``), or for ROS (any other suffix, usually ``.yaml``); raises `MapFileError`.

        The images are written to the same folder (for YARP, named after the map); ``ros`` are options of `save_ros`.
        """
        contents = MapContents(self._flags, self._occupancy, self.m_map_name, self.m_resolution, self.m_origin)
        if Path(path).suffix.lower() == ".map":
            save_yarp(contents, path)
        else:
            save_ros(contents, path, **ros)

    def enable_map_compression_over_network(self, enable: bool) -> bool:
        """Switch the compression of cells on the wire on or off."""
        self.compressed = bool(enable)
        return True

    def isIdenticalTo(self, other: MapGrid2D) -> bool:
        """Whether name, resolution, origin and all cells are equal."""
        return (
            (self.m_map_name, self.m_resolution) == (other.m_map_name, other.m_resolution)
            and self.m_origin == other.m_origin
            and np.array_equal(self._flags, other._flags)
            and np.array_equal(self._occupancy, other._occupancy)
        )

    @override
    def __eq__(self, other: object) -> bool:
        return self.isIdenticalTo(other) if isinstance(other, MapGrid2D) else NotImplemented

    @override
    def __repr__(self) -> str:
        return f"<MapGrid2D {self.m_map_name!r} of {self.m_width} x {self.m_height} cells of {self.m_resolution} m>"

    def copy(self) -> Self:
        """Return a deep copy."""
        duplicate = type(self).of(
            self._flags.copy(), self._occupancy.copy(),
            name=self.m_map_name, resolution=self.m_resolution, origin=self.m_origin,
        )  # fmt: skip
        duplicate.compressed = self.compressed
        return duplicate

    def _index(self, cell: Pair) -> tuple[int, int] | None:
        column, row = map(int, numbers(cell))
        return (row, column) if 0 <= column < self.m_width and 0 <= row < self.m_height else None

    @override
    def _write(self, out: ElementWriter) -> None:
        if len(self.m_map_name.encode("utf-8", "surrogateescape")) > _LONGEST_NAME:
            raise WireError(f"a map's name must have at most {_LONGEST_NAME} bytes, unlike {self.m_map_name!r:.60}")
        out.begin(10)
        out.integer(self.m_width)
        out.integer(self.m_height)
        for number in (*self.getOrigin(), self.m_resolution):
            out.float64(number)
        out.string(self.m_map_name)
        out.integer(int(self.compressed), INT8)
        for cells in (self._occupancy, self._flags):
            flat = np.ascontiguousarray(cells).reshape(-1)
            out.blob(zlib.compress(flat.data) if self.compressed else flat.data)

    @override
    def _read(self, source: ElementReader) -> None:
        count = source.begin()
        if count != 10:
            raise WireError(f"a map must have 10 fields, not {count}")
        width, height = source.integer(), source.integer()
        if min(width, height) < 0 or width * height > MAX_CELLS:
            raise WireError(too_large(width, height))
        x, y, theta, resolution = (source.float64() for _ in range(4))
        name, compressed = source.string(), bool(source.integer())
        blobs = [_cells(source.blob(), width * height, compressed=compressed) for _ in range(2)]
        source.end()
        occupancy, flags = (cells.reshape(height, width) for cells in blobs)
        try:
            decoded = MapGrid2D.of(flags, occupancy, name=name, resolution=resolution, origin=(x, y, theta))
        except ValueError as error:
            raise WireError(str(error)) from None
        decoded.compressed = compressed
        self.__dict__.update(decoded.__dict__)


def _cells(data: memoryview, count: int, *, compressed: bool) -> NDArray[np.uint8]:
    """Return a copy of the cells in a blob, decompressed if needed."""
    content: Any = data
    if compressed:
        try:
            content = zlib.decompressobj().decompress(data, count + 1)
        except zlib.error as error:
            raise WireError(f"the map's cells cannot be unzipped: {error}") from None
    if len(content) != count:
        raise WireError(f"the map has {count} cells, but its data has {len(content)}")
    return np.frombuffer(content, np.uint8).copy()


def _bytes(values: ArrayLike) -> NDArray[np.uint8]:
    try:
        return np.asarray(values, np.uint8)
    except OverflowError as err:
        raise ValueError(f"the values of cells must be 0 to 255: {err}") from None


def enlarge(flags: NDArray[np.uint8], cells: int) -> None:
    """Mark free cells within ``cells`` steps (straight or diagonal) of a cell with another flag as enlarged obstacles.

    The result equals YARP's repeated passes over all eight neighbors. Changes ``flags``, (height, width), in place.
    """
    near = (flags >= MapFlag.KEEP_OUT) & (flags <= MapFlag.UNKNOWN)
    near = _spread(_spread(near, cells).T, cells).T
    flags[near & (flags == MapFlag.FREE)] = MapFlag.ENLARGED_OBSTACLE


def _spread(marks: NDArray[np.bool_], cells: int) -> NDArray[np.bool_]:
    """Extend marks along rows by ``cells`` cells in both directions, doubling the step each time."""
    cells = min(cells, marks.shape[1])
    done = 0
    while done < cells:
        step = min(done + done + 1, cells) - done
        wider = marks.copy()
        wider[:, step:] |= marks[:, :-step]
        wider[:, :-step] |= marks[:, step:]
        marks, done = wider, done + step
    return marks
