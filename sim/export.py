"""Maps, locations and areas of a floor plan for planners: doors stand open, and what moves is left out."""

from __future__ import annotations

import math
from collections import deque
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim import pieces
from sim.errors import SimError
from sim.pieces import Piece
from sim.plan import Floor, Plan
from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.dev.mapcollection import save_maps
from yarp_compat.dev.mapgrid import MAX_CELLS, MapFlag, MapGrid2D
from yarp_compat.dev.maplink import MapLink
from yarp_compat.dev.places import Places
from yarp_compat.sig.vec2d import Vec2D

_MARGIN = 0.5
"""Metres around what stands on a floor."""


def grid(plan: Plan, floor: str, resolution: float = 0.05) -> MapGrid2D:
    """A floor's map: walls and what stands fast; free is what can be reached from its places, the rest is unknown.

    Raises:
        SimError: it would have too many cells.
    """
    there = plan.floors[floor]
    x0, y0, x1, y1 = there.extent
    left, bottom = (math.floor((v - _MARGIN) / resolution) * resolution for v in (x0, y0))
    width, height = (math.ceil((v + _MARGIN - o) / resolution) for v, o in ((x1, left), (y1, bottom)))
    if width * height > MAX_CELLS:
        msg = f"the map of {floor} would have {width} by {height} cells; the resolution should be coarser"
        raise SimError(msg)
    wall = np.zeros((height, width), np.bool_)
    for piece in _standing(there):
        _mark(wall, piece, left, bottom, resolution)
    free = _reached(wall, [((x - left) / resolution, (y - bottom) / resolution) for x, y, _ in _inside(there)])
    flags = np.where(wall, MapFlag.WALL, np.where(free, MapFlag.FREE, MapFlag.UNKNOWN)).astype(np.uint8)
    return MapGrid2D.of(flags[::-1].copy(), name=floor, resolution=resolution, origin=(left, bottom, 0.0))


def places(plan: Plan) -> Places:
    """Locations and areas of all floors; where there are several, a name begins with its floor's."""
    found = Places()
    for floor, there in plan.floors.items():
        for name, (x, y, degrees) in there.places.items():
            found.locations[_named(plan, floor, name)] = Map2DLocation(floor, x, y, degrees, "")
        for name, room in there.rooms.items():
            corners = [Vec2D(float(x), float(y)) for x, y in room.area]
            found.areas[f"{_named(plan, floor, name)}_area"] = Map2DArea(floor, corners, name)
    return found


def links(plan: Plan) -> dict[str, MapLink]:
    """The ways between floors, by their names."""
    made = {}
    for link in plan.links:
        first, second = (_named(plan, floor, place) for floor, place in link.split)
        made[link.name] = MapLink(first, second, link.cost)
    return made


def save(plan: Plan, folder: Path, resolution: float = 0.05) -> list[Path]:
    """Write all of it: each floor's map for YARP (.map) and ROS (.yaml), maps_collection.ini and locations.ini.

    Raises:
        SimError: a map would be too large.
        OSError: it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    maps = {floor: grid(plan, floor, resolution) for floor in plan.floors}
    save_maps(maps, folder / "maps_collection.ini")
    places(plan).save(folder / "locations.ini")
    for floor, made in maps.items():
        made.save(folder / f"{floor}.yaml")
    return sorted(folder.iterdir())


def _named(plan: Plan, floor: str, name: str) -> str:
    return name if len(plan.floors) == 1 else f"{floor}_{name}"


def _standing(floor: Floor) -> list[Piece]:
    boxes = [pieces.of_box(box) for box in floor.boxes if box.mass is None]
    return [*pieces.walls(floor), *boxes, *(pieces.of_round(thing) for thing in floor.rounds)]


def _inside(floor: Floor) -> list[tuple[float, float, float]]:
    return [floor.start, *floor.places.values()]


def _mark(wall: NDArray[np.bool_], piece: Piece, left: float, bottom: float, resolution: float) -> None:
    """Mark the cells whose middle is within half a cell of a piece: so a thin wall has no gaps."""
    reach = piece.reach + resolution
    columns = _range(piece.x, reach, left, resolution, wall.shape[1])
    rows = _range(piece.y, reach, bottom, resolution, wall.shape[0])
    x, y = np.meshgrid(left + (columns + 0.5) * resolution - piece.x, bottom + (rows + 0.5) * resolution - piece.y)
    half = resolution / 2 - 1e-9
    if piece.radius:
        covered = np.hypot(x, y) <= piece.radius + half
    else:
        c, s = math.cos(piece.yaw), math.sin(piece.yaw)
        along, aside = np.abs(c * x + s * y), np.abs(c * y - s * x)
        covered = (along <= piece.length / 2 + half) & (aside <= piece.width / 2 + half)
    wall[np.ix_(rows, columns)] |= covered


def _range(middle: float, reach: float, origin: float, resolution: float, count: int) -> NDArray[np.int64]:
    first = max(0, math.floor((middle - reach - origin) / resolution))
    last = min(count, math.ceil((middle + reach - origin) / resolution) + 1)
    return np.arange(first, max(first, last))


def _reached(wall: NDArray[np.bool_], starts: list[tuple[float, float]]) -> NDArray[np.bool_]:
    """The cells that can be reached from some, by steps to the four sides."""
    height, width = wall.shape
    free = np.zeros(wall.shape, np.bool_)
    ahead = deque((int(y), int(x)) for x, y in starts if 0 <= x < width and 0 <= y < height)
    while ahead:
        y, x = ahead.pop()
        if free[y, x] or wall[y, x]:
            continue
        # the whole run of the row at once
        begin, end = x, x + 1
        while begin > 0 and not wall[y, begin - 1]:
            begin -= 1
        while end < width and not wall[y, end]:
            end += 1
        free[y, begin:end] = True
        for row in (y - 1, y + 1):
            if 0 <= row < height:
                open_ = ~wall[row, begin:end] & ~free[row, begin:end]
                first = np.flatnonzero(np.diff(np.concatenate(([False], open_)).astype(np.int8)) == 1)
                ahead.extend((row, begin + int(i)) for i in first)
    return free
