"""Exports a floor plan's maps, locations and areas for planners, and draws the floor from above.

On a map, doors are open; movable things are left out, as are things that the R1's laser does not hit at its height. The
drawing code is Midspan's own, because DART's package needs a display.
"""

from __future__ import annotations

import math
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim import pieces
from sim.environment import SimError
from sim.pieces import Piece
from sim.plan import Plan
from sim.simulation import Simulation
from yarp_compat.dev.extras import Extras, MapLink, extras_file
from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.dev.mapgrid import MAX_CELLS, MapFlag, MapGrid2D
from yarp_compat.dev.places import Places, save_maps
from yarp_compat.sig.vec2d import Vec2D

_MARGIN = 0.5  # meters around a floor's walls and furniture
SEEN = 0.19  # height of the mapping laser above the floor, meters


def grid(plan: Plan, floor: str, resolution: float = 0.05) -> MapGrid2D:
    """Return a floor's map; cells that cannot be reached from the start or from any place are unknown.

    Raises `SimError` if the map is too large.
    """
    plan_floor = plan.floors[floor]
    x0, y0, x1, y1 = plan_floor.extent
    left, bottom = (math.floor((v - _MARGIN) / resolution) * resolution for v in (x0, y0))
    width, height = (math.ceil((v + _MARGIN - o) / resolution) for v, o in ((x1, left), (y1, bottom)))
    if width * height > MAX_CELLS:
        raise SimError(f"the map of {floor} would have {width} by {height} cells; use a coarser resolution")
    wall = np.zeros((height, width), np.bool_)
    for piece in pieces.standing(plan_floor):
        if piece.above <= SEEN < piece.top:
            _mark(wall, piece, left, bottom, resolution)
    inside = (plan_floor.start, *plan_floor.places.values())
    free = _reachable(wall, [((x - left) / resolution, (y - bottom) / resolution) for x, y, _ in inside])
    flags = np.where(wall, MapFlag.WALL, np.where(free, MapFlag.FREE, MapFlag.UNKNOWN)).astype(np.uint8)
    return MapGrid2D.of(flags[::-1].copy(), name=floor, resolution=resolution, origin=(left, bottom, 0.0))


def places(plan: Plan) -> Places:
    """Return the locations and areas of all floors; with several floors, a name begins with the floor's name."""
    result = Places()
    for floor, plan_floor in plan.floors.items():
        for name, (x, y, degrees) in plan_floor.places.items():
            result.locations[_full_name(plan, floor, name)] = Map2DLocation(floor, x, y, degrees, "")
        for name, room in plan_floor.rooms.items():
            corners = [Vec2D(float(x), float(y)) for x, y in room.area]
            result.areas[f"{_full_name(plan, floor, name)}_area"] = Map2DArea(floor, corners, name)
    return result


def links(plan: Plan) -> dict[str, MapLink]:
    """Return the links between floors, by name."""
    result = {}
    for link in plan.links:
        first, second = (_full_name(plan, floor, place) for floor, place in link.split)
        result[link.name] = MapLink(first, second, link.cost)
    return result


def save(plan: Plan, folder: Path, resolution: float = 0.05) -> list[Path]:
    """Write each floor's map for YARP (.map) and ROS (.yaml), maps_collection.ini, locations.ini, and the links.

    Raises:
        SimError: a map is too large.
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    maps = {floor: grid(plan, floor, resolution) for floor in plan.floors}
    save_maps(maps, folder / "maps_collection.ini")
    locations = folder / "locations.ini"
    places(plan).save(locations)
    links_file = extras_file(locations)
    # written even without links, because importers would read the links of an earlier plan from an old file
    if plan.links or links_file.exists():
        Extras(links=links(plan)).save(links_file)
    for floor, occupancy in maps.items():
        occupancy.save(folder / f"{floor}.yaml")
    return sorted(folder.iterdir())


def _full_name(plan: Plan, floor: str, name: str) -> str:
    return name if len(plan.floors) == 1 else f"{floor}_{name}"


def _mark(wall: NDArray[np.bool_], piece: Piece, left: float, bottom: float, resolution: float) -> None:
    """Mark the cells whose center is within half a cell of a piece, so that thin walls have no gaps."""
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


def _reachable(wall: NDArray[np.bool_], starts: list[tuple[float, float]]) -> NDArray[np.bool_]:
    """Return the free cells that are 4-connected to the start cells."""
    height, width = wall.shape
    free = np.zeros(wall.shape, np.bool_)
    ahead = deque((int(y), int(x)) for x, y in starts if 0 <= x < width and 0 <= y < height)
    while ahead:
        y, x = ahead.pop()
        if free[y, x] or wall[y, x]:
            continue
        # fill the whole run of the row at once
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


_LONGEST = 800  # pixels of the picture's longer side
_PICTURE_MARGIN = 0.3  # meters around the floor's extent
_FLOOR, _WALL, _DOOR, _CRATE = (250, 250, 247), (60, 62, 70), (190, 140, 80), (200, 165, 110)
_PERSON, _ROBOT, _NOSE, _HIT, _BUMP = (60, 120, 200), (40, 160, 90), (255, 255, 255), (220, 60, 60), (255, 120, 0)


def draw(simulation: Simulation) -> NDArray[np.uint8]:
    """Draw the floor's current state: (height, width, 3) bytes, north up."""
    canvas = _Canvas(simulation.world.floor.extent)
    world = simulation.world
    for piece in (*world.pieces[: world.first_leaf], *world.leaves(is_open=False)):
        canvas.solid(piece, _DOOR if piece.name in world.doors else _WALL)
    for piece in world.leaves(is_open=True):
        canvas.outline(piece, _DOOR)
    for crate in world.crates.values():
        canvas.solid(crate.now(), _CRATE)
    for walker in world.people.values():
        canvas.disc(walker.x, walker.y, walker.person.radius, _PERSON)
    canvas.dots(_hits(simulation), _HIT)
    x, y, yaw = simulation.base.pose()
    radius = simulation.robot.body.radius
    canvas.disc(x, y, radius, _ROBOT)
    canvas.line((x, y), (x + radius * math.cos(yaw), y + radius * math.sin(yaw)), _NOSE)
    canvas.dots(np.array(simulation.bumps).reshape(-1, 2), _BUMP, 3)
    return canvas.pixels()


def png(simulation: Simulation, file: Any) -> None:
    """Draw the floor's current state as PNG to a path or an open file."""
    from PIL import Image  # imported only by processes that draw

    Image.fromarray(draw(simulation)).save(file, format="PNG")


def _hits(simulation: Simulation) -> NDArray[np.float64]:
    """Return the end points of the laser's beams, (n, 2) meters."""
    scan, (x, y, yaw) = simulation.scan, simulation.base.pose()
    angles = yaw + scan.first + np.arange(len(scan.ranges)) * scan.step
    seen = np.isfinite(scan.ranges)
    far = scan.ranges[seen]
    return np.stack([x + far * np.cos(angles[seen]), y + far * np.sin(angles[seen])], axis=1)


class _Canvas:
    def __init__(self, extent: tuple[float, float, float, float]) -> None:
        from PIL import Image, ImageDraw  # imported only by processes that draw

        self._left, low, right, self._top = (
            extent[0] - _PICTURE_MARGIN,
            extent[1] - _PICTURE_MARGIN,
            extent[2] + _PICTURE_MARGIN,
            extent[3] + _PICTURE_MARGIN,
        )
        self._scale = _LONGEST / max(right - self._left, self._top - low)
        size = max(1, round((right - self._left) * self._scale)), max(1, round((self._top - low) * self._scale))
        self._image = Image.new("RGB", size, _FLOOR)
        self._draw = ImageDraw.Draw(self._image)

    def _pixel(self, x: float, y: float) -> tuple[float, float]:
        return (x - self._left) * self._scale, (self._top - y) * self._scale

    def solid(self, piece: Piece, color: tuple[int, int, int]) -> None:
        if piece.radius:
            self.disc(piece.x, piece.y, piece.radius, color)
        else:
            self._draw.polygon([self._pixel(float(x), float(y)) for x, y in piece.corners()], fill=color)

    def outline(self, piece: Piece, color: tuple[int, int, int]) -> None:
        self._draw.polygon([self._pixel(float(x), float(y)) for x, y in piece.corners()], outline=color)

    def disc(self, x: float, y: float, radius: float, color: tuple[int, int, int]) -> None:
        self._draw.ellipse([self._pixel(x - radius, y + radius), self._pixel(x + radius, y - radius)], fill=color)

    def line(self, a: tuple[float, float], b: tuple[float, float], color: tuple[int, int, int]) -> None:
        self._draw.line([self._pixel(*a), self._pixel(*b)], fill=color, width=2)

    def dots(self, points: NDArray[np.float64], color: tuple[int, int, int], size: int = 1) -> None:
        for x, y in points:
            px, py = self._pixel(float(x), float(y))
            self._draw.rectangle([px - size, py - size, px + size - 1, py + size - 1], fill=color)

    def pixels(self) -> NDArray[np.uint8]:
        return np.asarray(self._image)
