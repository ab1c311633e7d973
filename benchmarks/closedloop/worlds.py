"""The floors for the drives: single floors of the simulator's plans, with keep-out areas in their maps."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navigation.maps.masks import cells_of
from sim import export
from sim.pieces import Piece
from sim.plan import Plan, load_plan
from sim.world import FloorWorld
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.sig.vec2d import Vec2D

Rectangle = tuple[float, float, float, float]
"""x0, y0, x1, y1, meters."""

WORLDS = ("apartment", "office", "lab", "hall", "tables", "two_storeys/ground", "two_storeys/upper")

KEEP_OUT: dict[str, tuple[Rectangle, ...]] = {
    "apartment": ((4.1, 7.8, 5.2, 8.6), (0.1, 2.6, 0.8, 3.6), (4.4, 4.1, 5.6, 4.3)),
    "office": ((11.0, 5.1, 13.0, 5.6), (17.5, 11.2, 19.5, 11.7)),
    "lab": ((6.3, 4.2, 7.0, 4.9), (8.2, 8.3, 9.0, 9.2)),
    "hall": ((-4.0, -1.0, -2.0, 1.0), (3.0, 1.0, 5.0, 4.0)),
    "two_storeys/ground": ((3.5, 5.5, 4.5, 6.5),),
    "two_storeys/upper": ((9.4, 6.4, 10.4, 7.2),),
}
"""Keep-out areas on free floor, by world."""


LEAST, TALL = 0.05, 1.3
"""Range of heights above the floor in which things are obstacles, meters."""


def hidden(world: FloorWorld) -> list[Piece]:
    """Return the fixed obstacles that a robot's map lacks: table tops, shelves, low boxes, and drops in the floor."""
    fixed = [piece for piece in world.pieces[: world.first_leaf] if piece.above < TALL and piece.top > LEAST]
    drops = [Piece("", *d.at, 0.0, *d.size, d.depth, above=-d.depth) for d in world.floor.drops]
    return [piece for piece in fixed if not piece.above <= export.SEEN < piece.top] + drops


def covered(grid: MapGrid2D, pieces: Iterable[Piece]) -> NDArray[np.float64]:
    """Return the centers of a map's cells that pieces touch, (n, 2) meters."""
    rows, columns = np.indices(grid.flags.shape)
    places = grid.centers_of(np.stack((columns, rows), -1).reshape(-1, 2))
    touched = np.zeros(len(places), np.bool_)
    for piece in pieces:
        dx, dy = places.T - np.array([[piece.x], [piece.y]])
        c, s, half = math.cos(piece.yaw), math.sin(piece.yaw), grid.resolution / 2
        along, aside = np.abs(c * dx + s * dy), np.abs(c * dy - s * dx)
        touched |= (along <= piece.length / 2 + half) & (aside <= piece.width / 2 + half)
    return places[touched]


@dataclass(frozen=True, eq=False)
class World:
    """A floor to drive on.

    Attributes:
        name: one of `WORLDS`.
        plan: a plan with only this floor.
        map: the robot's map, with open doors and without movable things.
        keep_out: areas of the map that must not be entered.
    """

    name: str
    plan: Plan
    map: MapGrid2D
    keep_out: tuple[Rectangle, ...]

    @property
    def hides(self) -> bool:
        """Whether the floor has tables, of which a laser sees only the legs, or drops."""
        floor = self.plan.floors[self.plan.first]
        return bool(floor.tables or floor.drops)

    @property
    def drops(self) -> tuple[Rectangle, ...]:
        """The areas that lie lower than the floor."""
        drops = self.plan.floors[self.plan.first].drops
        halves = [((d.at[0], d.at[1]), (d.size[0] / 2, d.size[1] / 2)) for d in drops]
        return tuple((x - length, y - width, x + length, y + width) for (x, y), (length, width) in halves)


def world(name: str, *, people: bool = True) -> World:
    """Return a world by its name, with or without people.

    Raises:
        SimError: the name is unknown.
    """
    building, _, level = name.partition("/")
    whole = load_plan(building)
    floor = level or whole.first
    plan = Plan(name=whole.name, floors={floor: whole.floors[floor]})
    plan = plan if people else plan.without_people
    grid = export.grid(plan, floor)
    areas = KEEP_OUT.get(name, ())
    for x0, y0, x1, y1 in areas:
        part, inside = cells_of(grid, [Vec2D(x0, y0), Vec2D(x1, y0), Vec2D(x1, y1), Vec2D(x0, y1)])
        cells = grid.flags[part]
        cells[inside & (cells == MapFlag.FREE)] = MapFlag.KEEP_OUT
    return World(name, plan, grid, areas)
