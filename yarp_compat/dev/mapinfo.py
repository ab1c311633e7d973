"""A map without its cells: its name, size, resolution and origin (`yarp/dev/MapGrid2DInfo.h`).

Cell (0, 0) is the upper left one, and in YARP a cell's position is its lower left corner. If this corner is ``d``
meters to the right of and above the lower left corner of the map, it is at ``R(-theta) (origin + d)`` in the map's
frame. In ROS it is at ``origin + R(yaw) d``, so the two origins of a rotated map differ: see
:meth:`MapGrid2DOrigin.to_ros`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.overriding import override
from yarp_compat.sig.vec2d import Vec2D, Vec2DInt, Vec2DSize
from yarp_compat.wire.accessors import getter

Pair = Vec2D | Vec2DInt | Sequence[float]  # YARP's XYCell or XYWorld, or just two numbers


class MapGrid2DOrigin:
    """The pose of a map's lower left corner.

    x and y are in meters, before the rotation by theta, in degrees, clockwise about the frame's origin.
    """

    def __init__(self, x: float = 0.0, y: float = 0.0, theta: float = 0.0) -> None:
        self.setOrigin(x, y, theta)

    def setOrigin(self, x: float, y: float, theta: float) -> None:
        """Set the origin, with the angle modulo 360 degrees. Raises `ValueError` for numbers that are not finite."""
        if not all(map(math.isfinite, (x, y, theta))):
            raise ValueError(f"a map's origin must be finite numbers, not {(x, y, theta)}")
        self.x, self.y, self.theta = float(x), float(y), math.fmod(theta, 360.0)

    get_x = getter("x", float, "The x coordinate in meters.")
    get_y = getter("y", float, "The y coordinate in meters.")
    get_theta = getter("theta", float, "The angle in degrees.")

    def get_ca(self) -> float:
        """Return the angle's cosine."""
        return math.cos(math.radians(self.theta))

    def get_sa(self) -> float:
        """Return the angle's sine."""
        return math.sin(math.radians(self.theta))

    def rotated(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return numbers or arrays of x and y, rotated clockwise by theta."""
        ca, sa = self.get_ca(), self.get_sa()
        return x * ca + y * sa, y * ca - x * sa

    def to_ros(self) -> tuple[float, float, float]:
        """Return the origin in ROS's convention: the corner's x and y in meters, the yaw in radians."""
        if not self.theta:
            return self.x, self.y, 0.0
        return *self.rotated(self.x, self.y), -math.radians(self.theta)

    @classmethod
    def from_ros(cls, x: float, y: float, yaw: float) -> Self:
        """Make an origin from ROS's x, y (meters) and yaw (radians)."""
        if not yaw:
            return cls(x, y, 0.0)
        ca, sa = math.cos(yaw), math.sin(yaw)
        return cls(x * ca + y * sa, y * ca - x * sa, -math.degrees(yaw))

    @override
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MapGrid2DOrigin):
            return NotImplemented
        return (self.x, self.y, self.theta) == (other.x, other.y, other.theta)

    def __iter__(self) -> Iterator[float]:
        return iter((self.x, self.y, self.theta))

    @override
    def __repr__(self) -> str:
        return f"MapGrid2DOrigin({self.x}, {self.y}, {self.theta})"


class MapContents(NamedTuple):
    """A map's cells, (height, width) from the top, its name, meters per cell and origin.

    ``flags`` are values of `MapFlag`, ``occupancy`` is 0 to 100, or 255 if unknown.
    """

    flags: NDArray[np.uint8]
    occupancy: NDArray[np.uint8]
    name: str
    resolution: float
    origin: MapGrid2DOrigin


class MapGrid2DInfo:
    """A map without its cells: its name, width and height in cells, meters per cell, and origin."""

    def __init__(
        self,
        name: str = "",
        width: int = 0,
        height: int = 0,
        resolution: float = 0.0,
        origin: Iterable[float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.m_map_name = name
        self.m_width, self.m_height = width, height
        self.m_resolution = resolution
        self.m_origin = MapGrid2DOrigin(*origin)

    @property
    def name(self) -> str:
        return self.m_map_name

    @property
    def resolution(self) -> float:
        """Meters per cell."""
        return self.m_resolution

    @property
    def origin(self) -> MapGrid2DOrigin:
        """The pose of the lower left corner."""
        return self.m_origin

    def cell2World(self, cell: Pair) -> Vec2D:
        """Return the position of a cell's lower left corner in meters."""
        column, row = numbers(cell)
        x = column * self.m_resolution + self.m_origin.x
        y = -row * self.m_resolution + self.m_origin.y + (self.m_height - 1) * self.m_resolution
        return Vec2D(*self.m_origin.rotated(x, y))

    def world2Cell(self, world: Pair) -> Vec2DSize:
        """Return the cell at a position, or the nearest on the map, rounded as in YARP; see also :meth:`cells_at`."""
        column, row = self._truncated(world)
        return Vec2DSize(min(max(column, 0), self.m_width - 1), min(max(row, 0), self.m_height - 1))

    def world2Cell_unsafeFast(self, world: Pair) -> Vec2DSize:
        """Return the cell at a position, which may be off the map; unlike in YARP, its numbers may be below 0."""
        return Vec2DSize(*self._truncated(world))

    def isInsideMap(self, place: Vec2D | Vec2DInt) -> bool:
        """Whether a cell (`Vec2DSize`, `Vec2DInt`) or a position (`Vec2D`, meters) is on the map."""
        cell = place if isinstance(place, Vec2DInt) else self.world2Cell_unsafeFast(place)
        return 0 <= cell.x < self.m_width and 0 <= cell.y < self.m_height

    def toLocation(self, place: Vec2D | Vec2DInt) -> Map2DLocation:
        """Return a cell or a position as a location on this map."""
        world = self.cell2World(place) if isinstance(place, Vec2DInt) else place
        return Map2DLocation(self.m_map_name, world.x, world.y)

    def toXYCell(self, location: Map2DLocation) -> Vec2DSize:
        """Return the cell of a location."""
        return self.world2Cell((location.x, location.y))

    def toXYWorld(self, location: Map2DLocation) -> Vec2D:
        """Return the position of a location."""
        return Vec2D(location.x, location.y)

    def cells_at(self, points: ArrayLike) -> NDArray[np.intp]:
        """Return columns and rows (..., 2) of the cells at positions (x, y in meters: (..., 2)), even off the map."""
        places = self.in_cells(points)
        return np.stack((np.floor(places[..., 0]), np.ceil(places[..., 1]) - 1), -1).astype(np.intp)

    def in_cells(self, points: ArrayLike) -> NDArray[np.float64]:
        """Convert positions (x, y in meters: (..., 2)) to fractional cells right of and below the upper left corner."""
        places = np.asarray(points, float)
        ca, sa = self.m_origin.get_ca(), self.m_origin.get_sa()
        right = (places[..., 0] * ca - places[..., 1] * sa - self.m_origin.x) / self.m_resolution
        up = (places[..., 0] * sa + places[..., 1] * ca - self.m_origin.y) / self.m_resolution
        return np.stack((right, self.m_height - up), -1)

    def centers_of(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Return the centers (x, y in meters: (..., 2)) of cells (columns and rows, of the same shape)."""
        indices = np.asarray(cells, float)
        x = (indices[..., 0] + 0.5) * self.m_resolution + self.m_origin.x
        y = (self.m_height - 0.5 - indices[..., 1]) * self.m_resolution + self.m_origin.y
        return np.stack(self.m_origin.rotated(x, y), -1)

    def _truncated(self, world: Pair) -> tuple[int, int]:
        x, y = numbers(world)
        ca, sa = self.m_origin.get_ca(), self.m_origin.get_sa()
        column = int((x * ca - y * sa - self.m_origin.x) / self.m_resolution)
        return column, int((self.m_origin.y - x * sa - y * ca) / self.m_resolution) + self.m_height - 1


def numbers(pair: Pair) -> tuple[float, float]:
    """Return a pair's two numbers."""
    if isinstance(pair, Vec2D | Vec2DInt):
        return pair.x, pair.y
    x, y = pair
    return x, y
