"""A map as ways are planned on it: what entering each cell costs, and what areas ask of robots there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navigation.algorithms.astar import Weights
from navigation.algorithms.distance_transform import distance_transform
from navigation.maps.polygon import cells_of
from navigation.maps.turned import turned
from yarp_compat.dev.area_behaviour import AreaBehaviour
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapflag import MapFlag, looked_up
from yarp_compat.dev.mapgrid import MapGrid2D

Cell = tuple[int, int]
"""Row, from the top one down, and column."""

OCCUPIED = 50
"""From here on an occupancy is a wall, as YARP takes it where it has no flags."""

_NEAR_WALL = 16
"""What a cell right beside where the robot does not fit costs more than any other; it falls off within `clearance`, by
the square, so that a local navigator has some room wherever there is any."""
_ENLARGED = 4
"""The same of cells that the map itself calls the room about an obstacle."""
_UNSURE = 25
"""An occupancy below a wall's costs 1 more for each so many."""
_MOST = 250

_SOLID = np.zeros(256, np.uint8)
_SOLID[[MapFlag.WALL, MapFlag.TEMPORARY_OBSTACLE, MapFlag.UNKNOWN]] = 1
_NOTHING = AreaBehaviour()

_BESIDE = 1.5
"""Metres, see `Ground.beside`."""


@dataclass(frozen=True)
class Zone:
    """An area, and what it asks of robots."""

    area: Map2DArea
    behaviour: AreaBehaviour


class Ground:
    """A map for a robot of some size. Nothing of it changes.

    Args:
        grid: the map; a turned one is made straight.
        radius: the robot's, metres.
        clearance: metres further to walls and keep-out cells within which driving costs more.
        zones: areas; those on other maps do not matter.

    Attributes:
        grid: the map, straight.
        solid: (rows, columns) walls, temporary obstacles and what is unknown.
        kept: (rows, columns) what is to be kept out of.
        room: (rows, columns) metres from a cell's middle to the nearest border of those; infinite where there are none.
        weights: (rows, columns) what entering costs; 0 where the robot does not fit or is not to be.
        open: (rows, columns) 1 where a robot that goes round something may well come.
        behaviours: what cells ask for, by the numbers in `labels`.
        beside: (rows, columns) where robots are kept out nearby: who drives by the laser alone is to go round nothing
            there, since that might lead in.
    """

    def __init__(self, grid: MapGrid2D, radius: float, clearance: float = 0.0, zones: Sequence[Zone] = ()) -> None:
        self.grid = grid = turned(grid)
        self.radius = radius
        flags, occupancy = grid.flags, grid.occupancy
        self.solid = looked_up(flags, _SOLID).astype(bool) | ((occupancy >= OCCUPIED) & (occupancy <= 100))
        self.kept = flags == MapFlag.KEEP_OUT
        here = [zone for zone in zones if zone.area.map_id == grid.name]
        for zone in here:
            if zone.behaviour.keep_out:
                part, inside = cells_of(grid, zone.area.points)
                self.kept[part] |= inside
        self.room = (distance_transform(self.solid | self.kept) - 0.5) * np.float32(grid.resolution)
        self.weights = self._weighed(clearance)
        self.open = (self.room > radius / 2).astype(np.uint8)
        self.labels, self.behaviours = _labelled(grid, here)
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
