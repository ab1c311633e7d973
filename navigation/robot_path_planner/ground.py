"""The map as the planner sees it, and obstacles that are not on the map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.astar import Weights
from navigation.algorithms.distance_transform import distance_transform
from navigation.algorithms.occupancy import MOST, OccupancyMap
from navigation.maps.grid import turned
from navigation.maps.masks import cells_of, keep_out_cells
from navigation.pose import Pose
from yarp_compat.dev.extras import AreaBehavior
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapflag import MapFlag, lookup
from yarp_compat.dev.mapgrid import MapGrid2D

Cell = tuple[int, int]  # row, from the top one down, and column
OCCUPIED = 50  # cells with at least this occupancy are walls, as in a YARP map without flags
_NEAR_WALL = 16
"""The extra cost of a cell next to a cell in which the robot does not fit. It falls with the square of the distance
within `clearance`, so that a local navigator has room wherever possible."""
_ENLARGED = 4  # the extra cost of cells that the map flags as enlarged obstacles
_UNSURE = 25  # a cell that is not a wall costs 1 more per this much of its occupancy
_MOST = 250  # the highest cost of a cell

_SOLID = np.zeros(256, np.uint8)
_SOLID[[MapFlag.WALL, MapFlag.TEMPORARY_OBSTACLE, MapFlag.UNKNOWN]] = 1
_NOTHING = AreaBehavior()

_BESIDE = 1.5  # meters, see `Ground.beside`


@dataclass(frozen=True)
class Zone:
    """An area and the behavior that it requires of robots."""

    area: Map2DArea
    behavior: AreaBehavior


class Ground:
    """An immutable map for a robot of a given radius, meters; all arrays are (rows, columns).

    A rotated map is aligned with the axes. Cells nearer to walls and keep-out cells than ``radius`` + ``clearance``
    meters cost more. Zones on other maps are ignored. ``closed`` is why robots must not drive on the map at all, or "".
    """

    def __init__(
        self, grid: MapGrid2D, radius: float, clearance: float = 0.0, zones: Sequence[Zone] = (), closed: str = ""
    ) -> None:
        self.grid = grid = turned(grid)
        self.radius, self.closed = radius, closed
        flags, occupancy = grid.flags, grid.occupancy
        # walls, temporary obstacles, unknown and occupied cells
        self.solid = lookup(flags, _SOLID).astype(bool) | ((occupancy >= OCCUPIED) & (occupancy <= 100))
        on_map = [zone for zone in zones if zone.area.map_id == grid.name]
        self.kept = keep_out_cells(grid, [zone.area for zone in on_map if zone.behavior.keep_out])
        # meters from a cell's center to the nearest border of a solid or keep-out cell, else infinite
        self.room = (distance_transform(self.solid | self.kept) - 0.5) * np.float32(grid.resolution)
        self.weights = self._cell_weights(clearance)  # cost of entering a cell; 0 if the robot does not fit
        # 1: the robot fits with a cell to spare, so that the cells' size does not matter on a line between two points
        self.spare = (self.room >= radius + grid.resolution - 1e-6).astype(np.uint8)
        self.open = (self.room > radius / 2).astype(np.uint8)  # 1: a robot may be here while it avoids an obstacle
        self.labels, self.behaviors = _label_cells(grid, on_map)  # the index of each cell's behavior
        # close to keep-out cells, which a laser does not show: a local navigator must not go around obstacles here
        self.beside = distance_transform(self.kept) < _BESIDE / grid.resolution

    @property
    def name(self) -> str:
        return self.grid.name

    def cell(self, x: float, y: float) -> Cell | None:
        """Return the cell at a point; None outside the map."""
        if not (math.isfinite(x) and math.isfinite(y)):
            return None
        column, row = (int(index) for index in self.grid.cells_at((x, y)))
        rows, columns = self.weights.shape
        return (row, column) if 0 <= row < rows and 0 <= column < columns else None

    def places(self, cells: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return the centers of cells: (n, 2) rows and columns to (n, 2) x and y, meters."""
        return self.grid.centers_of(cells[:, ::-1])

    def fits(self, cell: Cell) -> bool:
        """Whether the robot may be in a cell."""
        return bool(self.weights[cell])

    def reason(self, cell: Cell) -> str:
        """Return why the robot may not be in a cell, as the rest of "it is ..."; empty if it may."""
        if self.fits(cell):
            return ""
        if self.kept[cell]:
            return "in a keep-out area"
        if self.grid.flags[cell] == MapFlag.UNKNOWN:
            return "in an unknown part of the map"
        if self.solid[cell]:
            return "in a wall or obstacle"
        return f"closer than the robot's radius ({self.radius:g} m) to a wall, an obstacle or a keep-out cell"

    def _cell_weights(self, clearance: float) -> Weights:
        cost = np.ones(self.room.shape, np.float32)
        occupancy = self.grid.occupancy
        unsure = occupancy <= 100
        cost[unsure] += occupancy[unsure] // _UNSURE
        cost[self.grid.flags == MapFlag.ENLARGED_OBSTACLE] += _ENLARGED
        if clearance > 0:
            near = np.clip(1.0 - (self.room - self.radius) / clearance, 0.0, 1.0)
            cost += np.ceil(_NEAR_WALL * near**2)
        cost[self.room < self.radius - 1e-6] = 0.0
        return np.minimum(cost, _MOST).astype(np.uint8)


def _label_cells(grid: MapGrid2D, zones: Sequence[Zone]) -> tuple[NDArray[np.uint16], list[AreaBehavior]]:
    """Return the index of each cell's behavior, and the behaviors; index 0 means none."""
    labels = np.zeros(grid.flags.shape, np.uint16)
    behaviors = [_NOTHING]
    for zone in zones:
        if zone.behavior.max_speed is None and not zone.behavior.on_obstacle:
            continue
        part, inside = cells_of(grid, zone.area.points)
        part_labels = labels[part]
        for label in np.unique(part_labels[inside]):
            both = combine(behaviors[label], zone.behavior)
            if both not in behaviors:
                behaviors.append(both)
            part_labels[inside & (part_labels == label)] = behaviors.index(both)
    return labels, behaviors


def combine(one: AreaBehavior, other: AreaBehavior) -> AreaBehavior:
    """Return the behavior where two areas overlap: the lower speed, and waiting rather than going around."""
    speeds = [speed for speed in (one.max_speed, other.max_speed) if speed is not None]
    requests = {one.on_obstacle, other.on_obstacle}
    on_obstacle = "wait" if "wait" in requests else "around" if "around" in requests else ""
    return AreaBehavior(min(speeds, default=None), on_obstacle)


SURE = 1.2  # log odds from which a cell is an obstacle: two hits, even if one scan passed through the cell
_KNOWN = 0.15  # echoes within this distance (meters) of a mapped wall belong to it: maps and poses are inexact
_FORGET_EVERY = 1.0


class Clutter:
    """Obstacles that are not on the map: obstacles of the laser, which fade within ``memory`` seconds, and of layers.

    A layer is an array of points, (n, 2) in meters on the map; its obstacles do not fade.
    """

    def __init__(self, ground: Ground, memory: float, layers: Sequence[NDArray[np.float64]] = ()) -> None:
        grid = ground.grid
        self._ground = ground
        rows, columns = ground.weights.shape
        self._seen = OccupancyMap(rows, columns, grid.resolution, (grid.origin.x, grid.origin.y))
        self._fade = MOST / memory * _FORGET_EVERY
        self._forgotten = -math.inf
        self._news = distance_transform(ground.solid) > _KNOWN / grid.resolution
        self._disc = _circle(ground.radius / grid.resolution + 0.5)
        self._half = _circle(ground.radius / 2 / grid.resolution + 0.5)
        self._cells: NDArray[np.int64] | None = None
        self.layers(layers)

    def layers(self, layers: Sequence[NDArray[np.float64]]) -> None:
        """Replace the obstacles of all layers by (n, 2) points on the map, in meters."""
        rows, columns = self._ground.weights.shape
        at = self._ground.grid.cells_at(np.concatenate((np.empty((0, 2)), *layers)))[:, ::-1]
        at = np.unique(at[((at >= 0) & (at < (rows, columns))).all(axis=1)], axis=0)
        self.fixed = at[self._news[at[:, 0], at[:, 1]]].astype(np.int64)  # (n, 2) rows and columns
        self.closed_by_layers = self._around(self.fixed, self._disc)  # the robot does not fit here
        self._struck_by_layers = self._around(self.fixed, self._half)

    def see(self, laser: Pose, ranges: NDArray[np.float64], first: float, step: float, farthest: float) -> None:
        """Add a scan of a laser at a pose on the map, up to ``farthest`` meters.

        Angles are in radians from the laser's direction. Ranges are in meters; infinity means no obstacle, NaN unknown.
        """
        self._seen.insert((laser.x, laser.y, laser.theta), ranges, first, step, farthest)
        self._cells = None

    def fade(self, now: float) -> None:
        """Fade the laser's obstacles; those that it no longer sees disappear."""
        if now - self._forgotten >= _FORGET_EVERY or now < self._forgotten:
            self._forgotten = now
            odds = self._seen.odds
            odds[odds > 0.0] -= min(self._fade, MOST)
            self._cells = None

    def clear(self) -> None:
        """Remove all obstacles of the laser."""
        self._seen.odds[:] = 0.0
        self._cells = None

    @property
    def cells(self) -> NDArray[np.int64]:
        """The rows and columns of the laser's obstacles that are not on the map, (n, 2)."""
        if self._cells is None:
            rows, columns = np.nonzero(self._seen.odds >= SURE)
            rows = self._seen.odds.shape[0] - 1 - rows
            news = self._news[rows, columns]
            self._cells = np.stack((rows[news], columns[news]), axis=1)
        return self._cells

    def closed(self) -> NDArray[np.bool_]:
        """Return the mask (rows, columns) of cells in which obstacles leave no room for the robot."""
        return self._around(self.cells, self._disc) | self.closed_by_layers

    def struck(self) -> NDArray[np.bool_]:
        """Return the mask of cells within half the radius of obstacles; a robot stops in front of these cells."""
        return self._around(self.cells, self._half) | self._struck_by_layers

    def _around(self, cells: NDArray[np.int64], disc: NDArray[np.int64]) -> NDArray[np.bool_]:
        mask = np.zeros(self._ground.weights.shape, np.bool_)
        if len(cells):
            rows, columns = (np.add.outer(cells[:, axis], disc[:, axis]).ravel() for axis in (0, 1))
            high, wide = self._ground.weights.shape
            fits = (rows >= 0) & (rows < high) & (columns >= 0) & (columns < wide)
            mask[rows[fits], columns[fits]] = True
        return mask

    def weights(self, *, seen: bool = True) -> Weights:
        """Return the map's weights with all obstacles, or only with obstacles of the layers."""
        closed = self.closed() if seen else self.closed_by_layers
        weights: Weights = np.where(closed, np.uint8(0), self._ground.weights)
        return weights


def _circle(cells: float) -> NDArray[np.int64]:
    """Return the offsets (n, 2) from a cell to all cells whose centers are less than ``cells`` cells away."""
    reach = math.ceil(cells)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    near = rows**2 + columns**2 < cells**2
    return np.stack((rows[near], columns[near]), axis=1)
