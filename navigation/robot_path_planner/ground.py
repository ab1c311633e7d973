"""A map as ways are planned on it, and what the laser sees that the map does not have."""

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
from navigation.maps.masks import cells_of
from navigation.pose import Pose
from yarp_compat.dev.extras import AreaBehaviour
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapflag import MapFlag, looked_up
from yarp_compat.dev.mapgrid import MapGrid2D

Cell = tuple[int, int]  # row, from the top one down, and column
OCCUPIED = 50  # from here on an occupancy is a wall, as YARP takes it where it has no flags
_NEAR_WALL = 16
"""What a cell right beside where the robot does not fit costs more than any other; it falls off within `clearance`, by
the square, so that a local navigator has some room wherever there is any."""
_ENLARGED = 4  # the same of cells that the map itself calls the room about an obstacle
_UNSURE = 25  # an occupancy below a wall's costs 1 more for each so many
_MOST = 250

_SOLID = np.zeros(256, np.uint8)
_SOLID[[MapFlag.WALL, MapFlag.TEMPORARY_OBSTACLE, MapFlag.UNKNOWN]] = 1
_NOTHING = AreaBehaviour()

_BESIDE = 1.5  # metres, see `Ground.beside`


@dataclass(frozen=True)
class Zone:
    """An area, and what it asks of robots."""

    area: Map2DArea
    behaviour: AreaBehaviour


class Ground:
    """A map for a robot of some radius, metres. Nothing of it changes; all arrays are (rows, columns).

    A turned map is made straight. Driving costs more within ``clearance`` metres further to walls and keep-out cells.
    Zones on other maps do not matter.
    """

    def __init__(self, grid: MapGrid2D, radius: float, clearance: float = 0.0, zones: Sequence[Zone] = ()) -> None:
        self.grid = grid = turned(grid)
        self.radius = radius
        flags, occupancy = grid.flags, grid.occupancy
        # walls, temporary obstacles, unknown
        self.solid = looked_up(flags, _SOLID).astype(bool) | ((occupancy >= OCCUPIED) & (occupancy <= 100))
        self.kept = flags == MapFlag.KEEP_OUT  # what is to be kept out of
        here = [zone for zone in zones if zone.area.map_id == grid.name]
        for zone in here:
            if zone.behaviour.keep_out:
                part, inside = cells_of(grid, zone.area.points)
                self.kept[part] |= inside
        # metres from a cell's middle to the nearest border of those; infinite where there are none
        self.room = (distance_transform(self.solid | self.kept) - 0.5) * np.float32(grid.resolution)
        self.weights = self._weighed(clearance)  # what entering costs; 0 where the robot does not fit or is not to be
        self.open = (self.room > radius / 2).astype(np.uint8)  # 1 where a robot that goes round something may come
        self.labels, self.behaviours = _labelled(grid, here)  # each cell's number of a behaviour
        # where robots are kept out nearby: who drives by the laser alone is to go round nothing there, and into none
        self.beside = distance_transform(self.kept) < _BESIDE / grid.resolution

    @property
    def name(self) -> str:
        """The map's."""
        return self.grid.name

    def cell(self, x: float, y: float) -> Cell | None:
        """The cell at a place; None off the map."""
        if not (math.isfinite(x) and math.isfinite(y)):
            return None
        column, row = (int(at) for at in self.grid.cells_at((x, y)))
        rows, columns = self.weights.shape
        return (row, column) if 0 <= row < rows and 0 <= column < columns else None

    def places(self, cells: NDArray[np.int32]) -> NDArray[np.float64]:
        """The middles of cells, metres: (n, 2) of rows and columns to (n, 2) of x and y."""
        return self.grid.centers_of(cells[:, ::-1])

    def fits(self, cell: Cell) -> bool:
        """Whether the robot may stand there."""
        return bool(self.weights[cell])

    def reason(self, cell: Cell) -> str:
        """Why the robot may not stand in a cell, to follow "it lies"; empty where it may."""
        if self.fits(cell):
            return ""
        if self.kept[cell]:
            return "where robots are kept out"
        if self.grid.flags[cell] == MapFlag.UNKNOWN:
            return "where the map knows nothing"
        if self.solid[cell]:
            return "in a wall or obstacle"
        return f"nearer than the robot's radius ({self.radius:g} m) to a wall, an obstacle or a keep-out cell"

    def _weighed(self, clearance: float) -> Weights:
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


def _labelled(grid: MapGrid2D, zones: Sequence[Zone]) -> tuple[NDArray[np.uint16], list[AreaBehaviour]]:
    """Each cell's number of the behaviour that holds there, and the behaviours; 0 is none."""
    labels = np.zeros(grid.flags.shape, np.uint16)
    behaviours = [_NOTHING]
    for zone in zones:
        if zone.behaviour.max_speed is None and not zone.behaviour.on_obstacle:
            continue
        part, inside = cells_of(grid, zone.area.points)
        there = labels[part]
        for label in np.unique(there[inside]):
            both = joined(behaviours[label], zone.behaviour)
            if both not in behaviours:
                behaviours.append(both)
            there[inside & (there == label)] = behaviours.index(both)
    return labels, behaviours


def joined(one: AreaBehaviour, other: AreaBehaviour) -> AreaBehaviour:
    """What holds where two areas overlap: the lower speed, and waiting before going around."""
    speeds = [speed for speed in (one.max_speed, other.max_speed) if speed is not None]
    words = {one.on_obstacle, other.on_obstacle}
    word = "wait" if "wait" in words else "around" if "around" in words else ""
    return AreaBehaviour(min(speeds, default=None), word)


SURE = 1.2  # log odds from which on a cell counts: seen in two scans more than seen through
_KNOWN = 0.15  # metres to a wall of the map within which an echo is that wall's: maps and localisation are not better
_FORGET_EVERY = 1.0


class Clutter:
    """Obstacles on the cells of a map that it does not have; what the laser sees is forgotten after ``memory`` seconds.

    Layers are places, (n, 2) metres on the map, that stay.
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
        """Have other layers."""
        rows, columns = self._ground.weights.shape
        at = self._ground.grid.cells_at(np.concatenate((np.empty((0, 2)), *layers)))[:, ::-1]
        at = np.unique(at[((at >= 0) & (at < (rows, columns))).all(axis=1)], axis=0)
        self.fixed = at[self._news[at[:, 0], at[:, 1]]].astype(np.int64)  # (n, 2) rows and columns of what they have
        self.closed_by_layers = self._around(self.fixed, self._disc)  # where the robot does not fit for them
        self._struck_by_layers = self._around(self.fixed, self._half)

    def see(self, laser: Pose, ranges: NDArray[np.float64], first: float, step: float, farthest: float) -> None:
        """Take a scan of a laser at a pose on the map, up to ``farthest`` metres; angles in radians from its direction.

        Ranges are metres; infinite: nothing is there, NaN: nothing is known.
        """
        self._seen.insert((laser.x, laser.y, laser.theta), ranges, first, step, farthest)
        self._cells = None

    def forget(self, now: float) -> None:
        """Fade what is no longer seen."""
        if now - self._forgotten >= _FORGET_EVERY or now < self._forgotten:
            self._forgotten = now
            odds = self._seen.odds
            odds[odds > 0.0] -= min(self._fade, MOST)
            self._cells = None

    def clear(self) -> None:
        """Forget all."""
        self._seen.odds[:] = 0.0
        self._cells = None

    @property
    def cells(self) -> NDArray[np.int64]:
        """(n, 2) rows and columns of the obstacles that the laser sees and the map does not have."""
        if self._cells is None:
            rows, columns = np.nonzero(self._seen.odds >= SURE)
            rows = self._seen.odds.shape[0] - 1 - rows
            news = self._news[rows, columns]
            self._cells = np.stack((rows[news], columns[news]), axis=1)
        return self._cells

    def closed(self) -> NDArray[np.bool_]:
        """(rows, columns) where the robot does not fit for them and the layers."""
        return self._around(self.cells, self._disc) | self.closed_by_layers

    def struck(self) -> NDArray[np.bool_]:
        """(rows, columns) where the robot would strike them, half its radius about: it stops before, not in, this."""
        return self._around(self.cells, self._half) | self._struck_by_layers

    def _around(self, cells: NDArray[np.int64], disc: NDArray[np.int64]) -> NDArray[np.bool_]:
        found = np.zeros(self._ground.weights.shape, np.bool_)
        if len(cells):
            rows, columns = (np.add.outer(cells[:, axis], disc[:, axis]).ravel() for axis in (0, 1))
            high, wide = self._ground.weights.shape
            fits = (rows >= 0) & (rows < high) & (columns >= 0) & (columns < wide)
            found[rows[fits], columns[fits]] = True
        return found

    def weights(self, *, seen: bool = True) -> Weights:
        """The map's weights with them as obstacles, or with the layers alone."""
        closed = self.closed() if seen else self.closed_by_layers
        found: Weights = np.where(closed, np.uint8(0), self._ground.weights)
        return found


def _circle(cells: float) -> NDArray[np.int64]:
    """(n, 2) the steps to all cells whose middle is nearer than so many cells."""
    reach = math.ceil(cells)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    near = rows**2 + columns**2 < cells**2
    return np.stack((rows[near], columns[near]), axis=1)
