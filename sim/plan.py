"""Floor plans: what stands where, written in YAML, or made from a map of cells or an image. Metres and degrees."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bridge.config.sections.section import Section
from sim.environment import SimError, checked, document, find
from yarp_compat.dev.mapfile import MapFileError
from yarp_compat.dev.mapgrid import MAX_CELLS, MapFlag, MapGrid2D

Point = tuple[float, float]
Pose = tuple[float, float, float]
Line = tuple[Point, ...]
Size = Annotated[float, Field(gt=0, le=1000)]


class RoomDoor(Section):
    """A door in a wall; the wall has a hole for it by itself."""

    name: str
    line: tuple[Point, Point] = Field(description="From one post to the other.")
    open: bool = Field(default=True, description="Whether it stands open at the start.")


class Box(Section):
    """A box; with a mass it can be pushed, without it stands fast."""

    name: str = ""
    at: Pose
    size: tuple[Size, Size, Size] = Field(description="Length, width, height.")
    above: float = Field(default=0.0, ge=0, le=1000, description="Between the floor and its underside.")
    mass: float | None = Field(default=None, gt=0, le=10_000, description="Kilograms.")
    friction: float = Field(default=0.4, ge=0, le=2)

    @model_validator(mode="after")
    def _stands(self) -> Box:
        if self.mass is not None and self.above:
            raise ValueError("a box that can be pushed stands on the floor: mass and above do not go together")
        return self


class Round(Section):
    """A round thing that stands fast: a column, a table."""

    name: str = ""
    at: Point
    radius: Size
    height: Size = 1.0
    above: float = Field(default=0.0, ge=0, le=1000, description="Between the floor and its underside.")


class Table(Section):
    """A board on four legs, which stand in its corners."""

    name: str = ""
    at: Pose
    size: tuple[Size, Size, Size] = Field(description="Length, width, height.")
    board: Size = Field(default=0.03, description="How thick the board is.")
    leg: Size = Field(default=0.05, description="How thick a leg is.")

    @model_validator(mode="after")
    def _fits(self) -> Table:
        if self.board >= self.size[2] or 2 * self.leg > min(self.size[:2]):
            raise ValueError("a table's board and legs are thinner than the table")
        return self


class Drop(Section):
    """Where the floor is lower: a step down, a stairwell. Its sides go along x and y."""

    at: Point
    size: tuple[Size, Size] = Field(description="Along x and along y.")
    depth: Size = 0.1


class Person(Section):
    """Somebody who walks; a person waits where the robot is in the way."""

    name: str
    at: Point
    path: Line = Field(default=(), description="Where the person walks to, point after point.")
    speed: float = Field(default=0.8, gt=0, le=5, description="Metres per second.")
    loop: bool = Field(default=True, description="Whether the path begins again, from its first point.")
    radius: float = Field(default=0.2, gt=0, le=1)


class Room(Section):
    """A named part of the floor."""

    area: Line = Field(min_length=3, description="Its corners.")
    at: Pose | None = Field(default=None, description="Where to stand in it; else the middle of its corners.")

    @property
    def pose(self) -> Pose:
        """Where to stand in it."""
        n = len(self.area)
        return self.at or (sum(p[0] for p in self.area) / n, sum(p[1] for p in self.area) / n, 0.0)


class Floor(Section):
    """One floor, one map."""

    thickness: Size = Field(default=0.1, description="Of the walls.")
    height: Size = Field(default=2.0, description="Of the walls.")
    walls: tuple[Line, ...] = Field(default=(), description="Lines through points.")
    openings: tuple[tuple[Point, Point], ...] = Field(default=(), description="Holes in walls that have no door.")
    doors: tuple[RoomDoor, ...] = ()
    boxes: tuple[Box, ...] = ()
    rounds: tuple[Round, ...] = ()
    tables: tuple[Table, ...] = ()
    drops: tuple[Drop, ...] = ()
    people: tuple[Person, ...] = ()
    rooms: dict[str, Room] = Field(default_factory=dict)
    locations: dict[str, Pose] = Field(default_factory=dict, description="Named places.")
    start: Pose = Field(default=(0.0, 0.0, 0.0), description="Where the robot stands first.")

    @model_validator(mode="after")
    def _names_differ(self) -> Floor:
        things: tuple[RoomDoor | Box | Round | Table | Person, ...]
        things = (*self.doors, *self.boxes, *self.rounds, *self.tables, *self.people)
        names = [thing.name for thing in things if thing.name]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"two things are called {twice!r}")
        both = next(iter(self.rooms.keys() & self.locations.keys()), None)
        if both is not None:
            raise ValueError(f"{both!r} is a room and a location")
        flat = [value for wall in self.walls for point in wall for value in point]
        if not all(math.isfinite(value) and abs(value) < 10_000 for value in flat):
            raise ValueError("a wall is not within 10 km")
        return self

    @property
    def places(self) -> dict[str, Pose]:
        """Named places, the rooms' among them."""
        return {**{name: room.pose for name, room in self.rooms.items()}, **self.locations}

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """The least and greatest x and y of all walls and what stands fast, metres: x0, y0, x1, y1."""
        points = [p for wall in self.walls for p in wall] + [p for door in self.doors for p in door.line]
        square: tuple[Box | Table, ...] = (*self.boxes, *self.tables)
        for box in square:
            (x, y, degrees), (length, width, _) = box.at, box.size
            c, s = abs(math.cos(math.radians(degrees))), abs(math.sin(math.radians(degrees)))
            reach = (c * length + s * width) / 2, (s * length + c * width) / 2
            points += [(x - reach[0], y - reach[1]), (x + reach[0], y + reach[1])]
        for thing in self.rounds:
            points += [(thing.at[0] + s * thing.radius, thing.at[1] + s * thing.radius) for s in (-1, 1)]
        points = points or [(-5.0, -5.0), (5.0, 5.0)]
        margin = self.thickness / 2
        xs, ys = [p[0] for p in points], [p[1] for p in points]
        return min(xs) - margin, min(ys) - margin, max(xs) + margin, max(ys) + margin


class Link(Section):
    """A way between two floors: a lift, or stairs. Each end is ``floor/location``."""

    name: str
    ends: tuple[str, str]
    cost: float = Field(default=30.0, ge=0, description="As that of so many metres, or seconds, for a planner.")

    @property
    def split(self) -> tuple[tuple[str, str], tuple[str, str]]:
        """Both ends as floor and location."""
        first, second = (end.partition("/") for end in self.ends)
        return (first[0], first[2]), (second[0], second[2])


class Plan(Section):
    """A building."""

    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,62}$", description="Also the map's, where there is one floor.")
    floors: dict[str, Floor] = Field(min_length=1, description="By the names of their maps; the first is the start.")
    links: tuple[Link, ...] = ()

    @property
    def first(self) -> str:
        """The floor on which the robot begins."""
        return next(iter(self.floors))

    @property
    def without_people(self) -> Plan:
        """The same building with nobody in it."""
        empty = {name: floor.model_copy(update={"people": ()}) for name, floor in self.floors.items()}
        return self.model_copy(update={"floors": empty})

    @model_validator(mode="after")
    def _links_lead_somewhere(self) -> Plan:
        for link in self.links:
            for floor, place in link.split:
                if floor not in self.floors or place not in self.floors[floor].places:
                    raise ValueError(f"the link {link.name!r} ends at {floor}/{place}, which is no location of a floor")
        return self


_MOST_PIECES = 20_000
_HEIGHT = 2.0
_DARK = 128


def of_map_file(file: Path) -> Plan:
    """A plan of a YARP map (.map) or ROS map (.yaml), of its walls alone; raises `SimError` if no map, or too large."""
    try:
        grid = MapGrid2D.load(file)
    except (MapFileError, OSError, ValueError) as err:
        raise SimError(f"{file}: {err}") from None
    return of_grid(grid, file.stem)


def of_grid(grid: MapGrid2D, name: str) -> Plan:
    """A plan of a map. Keep-out cells are none of its solids: nothing stands there."""
    origin = grid.m_origin.to_ros()
    return _plan(name, grid.flags == MapFlag.WALL, grid.getResolution(), (origin[0], origin[1], origin[2]))


def of_image(file: Path, resolution: float) -> Plan:
    """A plan of an image, metres a pixel: dark is wall, lower left the origin; raises `SimError` if none, or large."""
    from PIL import Image  # most plans are no image

    try:
        with Image.open(file) as image:
            if image.width * image.height > MAX_CELLS:
                raise SimError(f"{file}: more than {MAX_CELLS} pixels")
            grey = np.asarray(image.convert("L"))
    except (OSError, ValueError, Image.DecompressionBombError) as err:
        raise SimError(f"{file}: no image that can be read: {err}") from None
    return _plan(file.stem, grey < _DARK, resolution, (0.0, 0.0, 0.0))


def _plan(name: str, solid: NDArray[np.bool_], resolution: float, origin: Pose) -> Plan:
    """A plan of cells, rows from the top one down; the origin (metres, radians) is their lower left corner."""
    c, s = math.cos(origin[2]), math.sin(origin[2])
    boxes = []
    for left, bottom, right, top in rectangles(solid[::-1]):
        x, y = (left + right) / 2 * resolution, (bottom + top) / 2 * resolution
        at = (origin[0] + c * x - s * y, origin[1] + s * x + c * y, math.degrees(origin[2]))
        boxes.append(Box(at=at, size=((right - left) * resolution, (top - bottom) * resolution, _HEIGHT)))
        if len(boxes) > _MOST_PIECES:
            raise SimError(f"{name}: more than {_MOST_PIECES} rectangles of solid cells; is it a map?")
    height, width = solid.shape
    x, y = width / 2 * resolution, height / 2 * resolution
    start = (origin[0] + c * x - s * y, origin[1] + s * x + c * y, 0.0)
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)[:60]
    plain = plain if plain[:1].isalpha() else f"m_{plain}"
    return Plan(name=plain, floors={plain: Floor(boxes=tuple(boxes), start=start)})


def rectangles(solid: NDArray[np.bool_]) -> Iterator[tuple[int, int, int, int]]:
    """Rectangles that cover the solid cells, each cell once: left, bottom, right, top, the last two not within.

    Runs of a row that go on in the next with the same ends grow upwards.
    """
    growing: dict[tuple[int, int], int] = {}
    for row, cells in enumerate(solid):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], cells, [False])).astype(np.int8)))
        runs = set(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
        for left, right in [run for run in growing if run not in runs]:
            yield left, growing.pop((left, right)), right, row
        for run in sorted(runs):
            growing.setdefault(run, row)
    for (left, right), bottom in growing.items():
        yield left, bottom, right, len(solid)


_IMAGES = (".png", ".pgm", ".bmp", ".jpg", ".jpeg", ".gif", ".tif", ".tiff")


def load_plan(name: str, resolution: float = 0.05) -> Plan:
    """A plan that comes with Midspan, or a file: a plan or a ROS map (YAML), a YARP map (.map), or an image.

    Args:
        name: of the plan or the file.
        resolution: metres per pixel of an image.

    Raises:
        SimError: there is none of that name, or the file is wrong.
    """
    file = find("plans", name)
    kind = file.suffix.lower()
    if kind in _IMAGES:
        return of_image(file, resolution)
    if kind == ".map":
        return of_map_file(file)
    if kind not in (".yaml", ".yml"):
        raise SimError(f"{name}: what it is is told by its name's end: .yaml, .map, {', '.join(_IMAGES)}")
    found = document(file)
    if "image" in found.data:
        return of_map_file(file)
    if "floors" in found.data:
        return checked(found, Plan)
    return single(file, checked(found, Floor))


def single(file: Path, floor: Floor) -> Plan:
    """A plan of one floor, called as its file is."""
    name = "".join(c if (c.isalnum() and c.isascii()) or c in "_-" else "_" for c in file.stem)
    return Plan(name=name if name[:1].isalpha() else f"map_{name}", floors={name: floor})
