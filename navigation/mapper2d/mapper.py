"""The map of Mapper2D: the laser's observations, overlaid with painted cells."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.occupancy import LEAST, MOST, OccupancyMap
from navigation.mapper2d.section import MOST_CELLS, Mapper2DSection
from navigation.maps.grid import turned
from navigation.pose import Pose
from yarp_compat.dev.mapflag import UNKNOWN, MapFlag, too_large
from yarp_compat.dev.mapgrid import MapGrid2D

PAINTS = {"wall": MapFlag.WALL, "free": MapFlag.FREE, "unknown": MapFlag.UNKNOWN, "keepout": MapFlag.KEEP_OUT}
"""The flags that can be painted, by the names of upstream's ``set_pixel_type``."""

MOST_BRUSH = 200
_BARE = 255  # not painted
_STEP = 5.0  # meters by which the map grows at a side, so that it does not grow at every scan
_TOLERANCE = 1e-3  # cells or meters by which a size may exceed its limit, because of rounding


class Mapper:
    """Builds a map from scans with known poses, without a thread or a clock."""

    def __init__(self, settings: Mapper2DSection) -> None:
        self.settings, self.name = settings, settings.map_name
        self._largest = max(settings.largest, settings.width, settings.height)
        self.mapping = True  # whether scans are used
        self.enlarged = 0.0  # meters by which obstacles are enlarged on published maps
        self._fan: tuple[int, float, float, NDArray[np.float64], NDArray[np.float64]]
        self._fan = 0, 0.0, 0.0, np.empty(0), np.empty(0)
        self.clear()

    def clear(self) -> None:
        """Start a new map."""
        # the number of scans in this map; whether the last one reached beyond the largest size
        self.scans, self.full = 0, False
        self._begin((0.0, 0.0))

    @property
    def empty(self) -> bool:
        """Whether the map has neither observed nor painted cells."""
        return not (self.scans or self._map.odds.any() or (self._paint != _BARE).any())

    def scan(self, pose: Pose, ranges: NDArray[np.floating], first: float, step: float, farthest: float) -> bool:
        """Add a scan of a laser at a pose on the map; return whether it was used.

        Raises `ValueError` if the pose is not finite.

        Ranges are in meters, one per beam; infinity means no obstacle within ``farthest`` meters, NaN means unknown.
        ``first`` is the first beam's angle from the laser's direction, ``step`` the angle to the next beam, radians.
        """
        if not self.mapping:
            return False
        if not all(map(math.isfinite, pose[:3])):
            raise ValueError(f"a scan's pose must be finite, not {pose[:3]}")
        beams: NDArray[np.float64] = np.asarray(ranges, np.float64)
        farthest = min(farthest, self.settings.farthest)
        if self.empty:
            self._begin((pose.x, pose.y))
        self._reach(pose, np.where((beams > 0.0) & (beams <= farthest), beams, 0.0), first, step)
        self._map.insert((pose.x, pose.y, pose.theta), beams, first, step, farthest)
        self.scans += 1
        return True

    def enlarge(self, meters: float) -> None:
        """Add unknown cells on each side; raises `ValueError` for an invalid width, or if the map gets too large."""
        if not meters > 0.0:
            raise ValueError(f"a map can be enlarged by meters above 0, not by {meters:g}")
        cells = math.ceil(min(meters, 1e6) / self.settings.resolution)
        if not self._grow(cells, cells, cells, cells):
            raise ValueError(
                f"the map would have a side of more than {self._largest:g} m, or more than {MOST_CELLS} cells"
                " (modules.mapper2d)"
            )

    def paint(self, at: tuple[float, float], flag: MapFlag, brush: int, to: tuple[float, float] | None = None) -> int:
        """Paint a square ``brush`` cells wide, or a line of such squares; return the number of painted cells.

        Cells painted as wall, free or keep-out (`PAINTS`) stay so, whatever the laser observes; cells painted as
        unknown are reset, and observed again. Points are in meters. Raises `ValueError` for a point outside the
        map, or an invalid brush.
        """
        if not 1 <= brush <= MOST_BRUSH:
            raise ValueError(f"a brush must have 1 to {MOST_BRUSH} cells, not {brush}")
        (x, y), (end_x, end_y) = self._cell(at), self._cell(to or at)
        count = max(abs(end_x - x), abs(end_y - y)) + 1
        painted = np.zeros(self._paint.shape, np.bool_)
        for share in np.linspace(0.0, 1.0, count):
            column, row = round(x + share * (end_x - x)), round(y + share * (end_y - y))
            low_row, low_column = max(0, row - brush // 2), max(0, column - brush // 2)
            painted[low_row : row - brush // 2 + brush, low_column : column - brush // 2 + brush] = True
        self._paint[painted] = _BARE if flag == MapFlag.UNKNOWN else flag
        if flag == MapFlag.UNKNOWN:
            self._map.odds[painted] = 0.0
        return int(painted.sum())

    def grid(self) -> MapGrid2D:
        """Return a copy of the current map."""
        observed = self._map.occupancy()
        occupancy = observed.view(np.uint8)  # -1 is 255
        flags = np.where(observed == 100, MapFlag.WALL, np.where(observed == 0, MapFlag.FREE, MapFlag.UNKNOWN))
        for flag, value in ((MapFlag.WALL, 100), (MapFlag.FREE, 0)):
            occupancy[self._paint == flag] = value
        flags = np.where(self._paint == _BARE, flags, self._paint).astype(np.uint8)
        x, y = self._map.origin
        grid = MapGrid2D.of(
            flags[::-1].copy(), occupancy[::-1].copy(),
            name=self.name, resolution=self.settings.resolution, origin=(x, y, 0.0),
        )  # fmt: skip
        if self.enlarged > 0.0:
            grid.enlargeObstacles(self.enlarged)
        return grid

    def load(self, grid: MapGrid2D) -> None:
        """Continue another map with the same resolution.

        Its walls and free cells count as observed by the laser, its keep-out cells as painted. Raises `ValueError` if
        its resolution differs, or it is too large.
        """
        grid = turned(grid)
        if abs(grid.resolution - self.settings.resolution) > 1e-6:
            raise ValueError(
                f"the map's cells have {grid.resolution:g} m, Mapper2D's {self.settings.resolution:g} m: "
                "set modules.mapper2d.resolution"
            )
        if max(grid.getSize_in_meters()) > self._largest + _TOLERANCE:
            raise ValueError(f"the map is larger than {self._largest:g} m (modules.mapper2d.largest)")
        x, y, _ = grid.getOrigin()
        self._map = OccupancyMap(grid.height(), grid.width(), self.settings.resolution, (x, y))
        flags, occupancy = grid.flags[::-1], grid.occupancy[::-1]
        known = np.clip(occupancy, 1, 99) / 100.0
        odds = np.where(occupancy == UNKNOWN, 0.0, np.clip(np.log(known / (1.0 - known)), LEAST, MOST))
        odds[flags == MapFlag.WALL], odds[flags == MapFlag.FREE] = MOST, LEAST
        self._map.odds[:] = odds
        self._paint = np.where(flags == MapFlag.KEEP_OUT, np.uint8(MapFlag.KEEP_OUT), np.uint8(_BARE))
        self.name, self.scans, self.full = grid.name or self.name, 0, False

    def blank(self) -> Mapper:
        """Return a mapper with the same paint, size and settings, and without observations."""
        copy = Mapper(self.settings)
        rows, columns = self._map.odds.shape
        copy._map = OccupancyMap(rows, columns, self.settings.resolution, self._map.origin)
        copy._paint, copy.scans = self._paint.copy(), 1
        return copy

    def adopt(self, redrawn: Mapper) -> None:
        """Replace the observations with those of a mapper that `blank` returned; the paint stays."""
        cell, (rows, columns) = self.settings.resolution, self._paint.shape
        left, below = (
            round((new - old) / cell) for new, old in zip(redrawn._map.origin, self._map.origin, strict=True)
        )
        new_rows, new_columns = redrawn._paint.shape
        redrawn._grow(
            max(0, below), max(0, rows - below - new_rows), max(0, left), max(0, columns - left - new_columns)
        )
        corner = redrawn._map.origin
        paint, origin = self._paint, self._map.origin
        redrawn._paint[:] = _BARE
        self._map, self._paint, self.full = redrawn._map, redrawn._paint, redrawn.full
        self.overlay(paint, (origin[0] - corner[0], origin[1] - corner[1]))

    @property
    def painted(self) -> tuple[NDArray[np.uint8], tuple[float, float]]:
        """The painted flags (rows, columns) from the bottom up, 255 for none, and the lower left corner, meters."""
        return self._paint, self._map.origin

    def overlay(self, paint: NDArray[np.uint8], offset: tuple[float, float]) -> None:
        """Paint flags as in `painted`, with their corner ``offset`` meters from the map's; ignore cells outside."""
        column, row = (round(value / self.settings.resolution) for value in offset)
        rows, columns = np.nonzero(paint != _BARE)
        to_rows, to_columns = rows + row, columns + column
        inside = (to_rows >= 0) & (to_columns >= 0)
        inside &= (to_rows < self._paint.shape[0]) & (to_columns < self._paint.shape[1])
        self._paint[to_rows[inside], to_columns[inside]] = paint[rows[inside], columns[inside]]

    @property
    def size(self) -> tuple[float, float]:
        """Width and height, meters."""
        rows, columns = self._map.odds.shape
        return columns * self.settings.resolution, rows * self.settings.resolution

    def _begin(self, middle: tuple[float, float]) -> None:
        """Start an empty map around a point, with corners at whole cells so that maps of one robot can be overlaid."""
        cell = self.settings.resolution
        columns, rows = (max(1, round(size / cell)) for size in (self.settings.width, self.settings.height))
        if columns * rows > MOST_CELLS:
            raise ValueError(too_large(columns, rows))  # sizes of an ini file, which the section cannot check
        origin = tuple(
            round(center / cell - cells / 2) * cell for center, cells in zip(middle, (columns, rows), strict=True)
        )
        self._map = OccupancyMap(rows, columns, cell, (origin[0], origin[1]))
        self._paint = np.full((rows, columns), _BARE, np.uint8)

    def _reach(self, pose: Pose, hits: NDArray[np.float64], first: float, step: float) -> None:
        """Grow the map until the robot and its echoes are on it, up to the largest size; ``hits``: meters or 0."""
        if self._fan[:3] != (hits.size, first, step):
            angles = first + step * np.arange(hits.size)
            self._fan = hits.size, first, step, np.cos(angles), np.sin(angles)
        ahead, aside = hits * self._fan[3], hits * self._fan[4]
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        x, y = pose.x + c * ahead - s * aside, pose.y + s * ahead + c * aside
        cell, (left, bottom) = self.settings.resolution, self._map.origin
        rows, columns = self._map.odds.shape
        beyond = (
            (bottom - y.min()) / cell,
            (y.max() - bottom) / cell - rows + 1,
            (left - x.min()) / cell,
            (x.max() - left) / cell - columns + 1,
        )
        self.full = False
        if max(beyond) > 0.0:
            ahead_of_need = math.ceil(_STEP / cell)
            fine = [max(0, math.ceil(side)) for side in beyond]
            coarse = [math.ceil(side / ahead_of_need) * ahead_of_need for side in fine]
            self.full = not (self._grow(*coarse) or self._grow(*fine))

    def _grow(self, below: int, above: int, left: int, right: int) -> bool:
        """Add cells at the sides; return False, without a change, if the map would be too large."""
        rows, columns = self._map.odds.shape
        most = self._largest / self.settings.resolution + _TOLERANCE
        rows, columns = rows + below + above, columns + left + right
        if max(rows, columns) > most or rows * columns > MOST_CELLS:
            return False
        self._map.grow(below, above, left, right)
        self._paint = np.pad(self._paint, ((below, above), (left, right)), constant_values=_BARE)
        return True

    def _cell(self, point: tuple[float, float]) -> tuple[int, int]:
        """Return the column and row of a point; raises `ValueError` outside the map."""
        rows, columns = self._map.odds.shape
        at = [
            (value - origin) / self.settings.resolution for value, origin in zip(point, self._map.origin, strict=True)
        ]
        if not (0.0 <= at[0] < columns and 0.0 <= at[1] < rows):
            raise ValueError(f"{point[0]:g}, {point[1]:g} m is outside the map")
        return int(at[0]), int(at[1])
