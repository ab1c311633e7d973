"""Floor plans, which are read from YAML, a grid map or an image; in meters and degrees."""

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
from yarp_compat.dev.yarpmap import files_of_map

Point = tuple[float, float]
Pose = tuple[float, float, float]
Line = tuple[Point, ...]
Size = Annotated[float, Field(gt=0, le=1000)]


class RoomDoor(Section):
    """A door in a wall; it also defines the gap in the wall."""

    name: str
    line: tuple[Point, Point] = Field(description="From one post to the other.")
    open: bool = Field(default=True, description="Whether the door is open at the start.")


class Box(Section):
    """A box; movable if it has a mass, otherwise fixed."""

    name: str = ""
    at: Pose
    size: tuple[Size, Size, Size] = Field(description="Length, width, height.")
    above: float = Field(default=0.0, ge=0, le=1000, description="Height of the box's underside above the floor.")
    mass: float | None = Field(default=None, gt=0, le=10_000, description="Kilograms.")
    friction: float = Field(default=0.4, ge=0, le=2)

    @model_validator(mode="after")
    def _check_support(self) -> Box:
        if self.mass is not None and self.above:
            raise ValueError("mass and above exclude each other, because a movable box stands on the floor")
        return self


class Round(Section):
    """A fixed round thing: a column, a table."""

    name: str = ""
    at: Point
    radius: Size
    height: Size = 1.0
    above: float = Field(default=0.0, ge=0, le=1000, description="Height of the underside above the floor.")


class Table(Section):
    """A board on four legs, at its corners."""

    name: str = ""
    at: Pose
    size: tuple[Size, Size, Size] = Field(description="Length, width, height.")
    board: Size = Field(default=0.03, description="Thickness of the board.")
    leg: Size = Field(default=0.05, description="Thickness of a leg.")

    @model_validator(mode="after")
    def _fits(self) -> Table:
        if self.board >= self.size[2] or 2 * self.leg > min(self.size[:2]):
            raise ValueError("a table's board and legs must be thinner than the table")
        return self


class Drop(Section):
    """A lower part of the floor, such as a step or stairwell; its sides are parallel to x and y."""

    at: Point
    size: tuple[Size, Size] = Field(description="Along x and along y.")
    depth: Size = 0.1


class Person(Section):
    """A walking person, who waits if the robot blocks the path."""

    name: str
    at: Point
    path: Line = Field(default=(), description="Points to walk to, in sequence.")
    speed: float = Field(default=0.8, gt=0, le=5, description="Meters per second.")
    loop: bool = Field(default=True, description="Whether the path is repeated.")
    radius: float = Field(default=0.2, gt=0, le=1)


class Room(Section):
    """A named part of the floor."""

    area: Line = Field(min_length=3, description="The room's corners.")
    at: Pose | None = Field(
        default=None, description="Where the robot stands in the room; default: the middle of the corners."
    )

    @property
    def pose(self) -> Pose:
        """The pose for the robot in the room."""
        n = len(self.area)
        return self.at or (sum(p[0] for p in self.area) / n, sum(p[1] for p in self.area) / n, 0.0)


class Floor(Section):
    """One floor, with one map."""

    thickness: Size = Field(default=0.1, description="Thickness of the walls.")
    height: Size = Field(default=2.0, description="Height of the walls.")
    walls: tuple[Line, ...] = Field(default=(), description="Lines through points.")
    openings: tuple[tuple[Point, Point], ...] = Field(default=(), description="Gaps in walls without a door.")
    doors: tuple[RoomDoor, ...] = ()
    boxes: tuple[Box, ...] = ()
    rounds: tuple[Round, ...] = ()
    tables: tuple[Table, ...] = ()
    drops: tuple[Drop, ...] = ()
    people: tuple[Person, ...] = ()
    rooms: dict[str, Room] = Field(default_factory=dict)
    locations: dict[str, Pose] = Field(default_factory=dict, description="Named places.")
    start: Pose = Field(default=(0.0, 0.0, 0.0), description="The robot's pose at the start.")

    @model_validator(mode="after")
    def _names_differ(self) -> Floor:
        things: tuple[RoomDoor | Box | Round | Table | Person, ...]
        things = (*self.doors, *self.boxes, *self.rounds, *self.tables, *self.people)
        names = [thing.name for thing in things if thing.name]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"two things have the name {twice!r}")
        both = next(iter(self.rooms.keys() & self.locations.keys()), None)
        if both is not None:
            raise ValueError(f"{both!r} is both a room and a location")
        flat = [value for wall in self.walls for point in wall for value in point]
        if not all(math.isfinite(value) and abs(value) < 10_000 for value in flat):
            raise ValueError("walls must be within 10 km of the origin")
        return self

    @property
    def places(self) -> dict[str, Pose]:
        """All named places, including the rooms."""
        return {**{name: room.pose for name, room in self.rooms.items()}, **self.locations}

    @property
    def reach(self) -> float:
        """Half the side of the ground, a square around the origin, in meters."""
        return max(50.0, *(abs(value) for value in self.extent)) + 10.0

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """The bounds of all walls, doors, boxes, tables and round things, in meters: x0, y0, x1, y1."""
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
    """A link between two floors: a lift or stairs. Each end is ``floor/location``."""

    name: str
    ends: tuple[str, str]
    cost: float = Field(default=30.0, ge=0, description="Cost of the link for a planner, in meters or seconds.")

    @property
    def split(self) -> tuple[tuple[str, str], tuple[str, str]]:
        """Both ends, each as (floor, location)."""
        first, second = (end.partition("/") for end in self.ends)
        return (first[0], first[2]), (second[0], second[2])


class Plan(Section):
    """A building."""

    name: str = Field(
        pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,62}$", description="Also the map's name if there is one floor."
    )
    floors: dict[str, Floor] = Field(min_length=1, description="The floors by map name; the robot starts on the first.")
    links: tuple[Link, ...] = ()

    @property
    def first(self) -> str:
        """The floor on which the robot starts."""
        return next(iter(self.floors))

    @property
    def without_people(self) -> Plan:
        """The same building without people."""
        empty = {name: floor.model_copy(update={"people": ()}) for name, floor in self.floors.items()}
        return self.model_copy(update={"floors": empty})

    @model_validator(mode="after")
    def _links_lead_somewhere(self) -> Plan:
        for link in self.links:
            for floor, place in link.split:
                if floor not in self.floors or place not in self.floors[floor].places:
                    raise ValueError(f"the link {link.name!r} ends at the unknown location {floor}/{place}")
        return self


_MOST_PIECES = 20_000  # maximum number of walls made from a map or an image
_HEIGHT = 2.0  # height of these walls, meters
_DARK = 128  # darker pixels (gray values) are walls


def of_map_file(file: Path) -> Plan:
    """Return a plan with the walls of a map of YARP (.map) or ROS (.yaml).

    Raises `SimError` if the map is invalid or has too many walls.
    """
    try:
        grid = MapGrid2D.load(file)
    except (MapFileError, OSError, ValueError) as err:
        raise SimError(f"{file}: {err}") from None
    return of_grid(grid, file.stem)


def of_grid(grid: MapGrid2D, name: str) -> Plan:
    """Return a plan with the walls of a map; keep-out cells are free."""
    origin = grid.m_origin.to_ros()
    return _plan(name, grid.flags == MapFlag.WALL, grid.getResolution(), (origin[0], origin[1], origin[2]))


def of_image(file: Path, resolution: float) -> Plan:
    """Return a plan from an image, whose dark pixels are walls, and whose lower left corner is the origin.

    Args:
        file: the image.
        resolution: meters per pixel.

    Raises:
        SimError: the image is invalid or too large.
    """
    from PIL import Image  # not imported for other plans

    try:
        with Image.open(file) as image:
            if image.width * image.height > MAX_CELLS:
                raise SimError(f"{file}: more than {MAX_CELLS} pixels")
            gray = np.asarray(image.convert("L"))
    except (OSError, ValueError, Image.DecompressionBombError) as err:
        raise SimError(f"{file}: cannot read the image: {err}") from None
    return _plan(file.stem, gray < _DARK, resolution, (0.0, 0.0, 0.0))


def _plan(name: str, solid: NDArray[np.bool_], resolution: float, origin: Pose) -> Plan:
    """Return a plan from solid cells, the top row first.

    ``resolution``: meters per cell. ``origin``: the pose of the lower left corner, meters and radians.
    """
    c, s = math.cos(origin[2]), math.sin(origin[2])
    boxes = []
    for left, bottom, right, top in rectangles(solid[::-1]):
        x, y = (left + right) / 2 * resolution, (bottom + top) / 2 * resolution
        at = (origin[0] + c * x - s * y, origin[1] + s * x + c * y, math.degrees(origin[2]))
        boxes.append(Box(at=at, size=((right - left) * resolution, (top - bottom) * resolution, _HEIGHT)))
        if len(boxes) > _MOST_PIECES:
            raise SimError(f"{name}: more than {_MOST_PIECES} rectangles of solid cells; is it an occupancy map?")
    height, width = solid.shape
    x, y = width / 2 * resolution, height / 2 * resolution
    start = (origin[0] + c * x - s * y, origin[1] + s * x + c * y, 0.0)
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)[:60]
    plain = plain if plain[:1].isalpha() else f"m_{plain}"
    return Plan(name=plain, floors={plain: Floor(boxes=tuple(boxes), start=start)})


def rectangles(solid: NDArray[np.bool_]) -> Iterator[tuple[int, int, int, int]]:
    """Yield rectangles that cover each solid cell once: left, bottom, right, top in cells, the last two exclusive.

    The first row of ``solid`` is the bottom one. Runs with the same ends in consecutive rows are merged.
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


def load_plan(name: str | Path, resolution: float = 0.05) -> Plan:
    """Load a plan that comes with Midspan, or a file: a plan or a ROS map (YAML), a YARP map (.map), or an image.

    Args:
        name: the plan's name, or the file.
        resolution: meters per pixel of an image.

    Raises:
        SimError: the name is unknown, or the file is invalid.
    """
    file = find("plans", name)
    kind = file.suffix.lower()
    if kind in _IMAGES:
        return of_image(file, resolution)
    if kind == ".map":
        return of_map_file(file)
    if kind not in (".yaml", ".yml"):
        raise SimError(f"{name}: unknown file type; supported: .yaml, .map, {', '.join(_IMAGES)}")
    loaded = document(file)
    if "image" in loaded.data:
        return of_map_file(file)
    if "floors" in loaded.data:
        return checked(loaded, Plan)
    return single(file, checked(loaded, Floor))


def files_of_plan(file: Path) -> list[Path]:
    """Return the file of a plan that has been checked, and for a map those with its cells."""
    kind = file.suffix.lower()
    try:
        if kind == ".map" or (kind in (".yaml", ".yml") and "image" in document(file).data):
            return files_of_map(file)
    except (SimError, MapFileError):  # it has changed since it was checked
        pass
    return [file]


def single(file: Path, floor: Floor) -> Plan:
    """Return a plan of one floor, named after its file."""
    name = "".join(c if (c.isalnum() and c.isascii()) or c in "_-" else "_" for c in file.stem)
    return Plan(name=name if name[:1].isalpha() else f"map_{name}", floors={name: floor})
