"""The pieces of a floor as simple solids, for DART and the laser, and people who walk."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.plan import Box, Floor, Person, Point, RoomDoor, Round, Table
from sim.robot import Body

_ON_LINE = 0.02  # maximum distance of a door's post from its wall's middle line, meters


@dataclass(frozen=True)
class Piece:
    """An upright solid: a cylinder if it has a radius, otherwise a box."""

    name: str  #: "" for none
    x: float  #: of the middle, meters
    y: float  #: of the middle, meters
    yaw: float  #: radians
    length: float  #: meters, along its own x
    width: float  #: meters
    height: float  #: meters, from its underside to its top
    radius: float = 0.0  #: meters; 0 for a box
    above: float = 0.0  #: meters from the floor to its underside

    @property
    def top(self) -> float:
        """The height of the top above the floor, in meters."""
        return self.above + self.height

    @property
    def reach(self) -> float:
        """The radius of the bounding circle, in meters."""
        return self.radius or math.hypot(self.length, self.width) / 2

    def moved(self, x: float, y: float, yaw: float) -> Piece:
        """Return the piece at another pose."""
        return replace(self, x=x, y=y, yaw=yaw)

    def corners(self) -> NDArray[np.float64]:
        """Return a box's four corners, counterclockwise, (4, 2) meters."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        half = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (self.length / 2, self.width / 2)
        turned: NDArray[np.float64] = half @ np.array([[c, s], [-s, c]]) + (self.x, self.y)
        return turned

    def segments(self) -> NDArray[np.float64]:
        """Return a box's four sides, (4, 4): x1, y1, x2, y2 in meters."""
        corners = self.corners()
        return np.hstack([corners, np.roll(corners, -1, axis=0)])


def bar(name: str, a: Point, b: Point, thickness: float, height: float, *, beyond: float = 0.0) -> Piece:
    """Return a piece of wall between two points, extended by ``beyond`` meters at both ends."""
    length = math.hypot(b[0] - a[0], b[1] - a[1])
    yaw = math.atan2(b[1] - a[1], b[0] - a[0])
    return Piece(name, (a[0] + b[0]) / 2, (a[1] + b[1]) / 2, yaw, length + 2 * beyond, thickness, height)


def walls(floor: Floor) -> Iterator[Piece]:
    """Yield the walls, with gaps for doors and openings."""
    holes = [door.line for door in floor.doors] + list(floor.openings)
    for line in floor.walls:
        for a, b in itertools.pairwise(line):
            for start, end, first, last in _standing(a, b, holes):
                # the wall's ends are half a thickness longer, which closes the corners; ends at gaps are not
                half = floor.thickness / 2
                length = math.hypot(b[0] - a[0], b[1] - a[1])
                begin, stop = start - half * first, end + half * last
                ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
                begin_point = (a[0] + ux * begin, a[1] + uy * begin)
                end_point = (a[0] + ux * stop, a[1] + uy * stop)
                yield bar("", begin_point, end_point, floor.thickness, floor.height)


def _standing(a: Point, b: Point, holes: Iterable[tuple[Point, Point]]) -> Iterator[tuple[float, float, bool, bool]]:
    """Yield the parts of a wall between holes: begin and end (meters from ``a``), and which of them is a wall's end."""
    length = math.hypot(b[0] - a[0], b[1] - a[1])
    if length < 1e-6:
        return
    cuts = sorted(cut for hole in holes if (cut := _cut(a, b, length, hole)) is not None)
    position = 0.0
    for begin, end in cuts:
        if begin > position + 1e-6:
            yield position, begin, position == 0.0, False
        position = max(position, end)
    if position < length - 1e-6:
        yield position, length, position == 0.0, True


def _cut(a: Point, b: Point, length: float, hole: tuple[Point, Point]) -> tuple[float, float] | None:
    ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
    along = sorted((p[0] - a[0]) * ux + (p[1] - a[1]) * uy for p in hole)
    offset = max(abs((p[1] - a[1]) * ux - (p[0] - a[0]) * uy) for p in hole)
    if offset > _ON_LINE or along[1] <= 1e-6 or along[0] >= length - 1e-6:
        return None
    return max(along[0], 0.0), min(along[1], length)


def leaf(door: RoomDoor, floor: Floor) -> Piece:
    """Return a door's leaf in the closed position."""
    return bar(door.name, *door.line, min(floor.thickness, 0.06), floor.height)


def of_box(box: Box) -> Piece:
    """Return a box as a piece."""
    x, y, yaw = box.at
    return Piece(box.name, x, y, math.radians(yaw), *box.size, above=box.above)


def of_round(thing: Round) -> Piece:
    """Return a round thing as a piece."""
    return Piece(thing.name, *thing.at, 0.0, 0.0, 0.0, thing.height, thing.radius, thing.above)


def of_table(table: Table) -> Iterator[Piece]:
    """Yield a table's board, and its unnamed legs."""
    (x, y, degrees), (length, width, height) = table.at, table.size
    yaw, under = math.radians(degrees), height - table.board
    yield Piece(table.name, x, y, yaw, length, width, table.board, above=under)
    c, s = math.cos(yaw), math.sin(yaw)
    for along, aside in itertools.product((-1, 1), repeat=2):
        dx, dy = along * (length - table.leg) / 2, aside * (width - table.leg) / 2
        yield Piece("", x + c * dx - s * dy, y + s * dx + c * dy, yaw, table.leg, table.leg, under)


def standing(floor: Floor) -> list[Piece]:
    """Return the fixed pieces of a floor except doors."""
    boxes = (of_box(box) for box in floor.boxes if box.mass is None)
    tables = (piece for table in floor.tables for piece in of_table(table))
    return [*walls(floor), *boxes, *(of_round(thing) for thing in floor.rounds), *tables]


def at_start(floor: Floor, *, people: bool) -> list[Piece]:
    """Return all pieces in a robot's way at the start: fixed ones, closed doors, movable boxes, and ``people``."""
    closed = (leaf(door, floor) for door in floor.doors if not door.open)
    crates = (of_box(box) for box in floor.boxes if box.mass is not None)
    persons = (of_person(person) for person in floor.people if people)
    return [*standing(floor), *closed, *persons, *crates]


def occupant(obstacles: Iterable[Piece], body: Body, x: float, y: float) -> str:
    """Return why a robot cannot stand at a place (meters) among these pieces, "" if it can."""
    for piece in obstacles:
        if piece.above < body.tall and distance(piece, x, y) < body.radius:
            return f"the robot cannot stand at {x:.2f}, {y:.2f}: {piece.name or 'a wall'} is there"
    return ""


def distance(piece: Piece, x: float, y: float) -> float:
    """Return the distance from a point to a piece, in meters; 0 inside it."""
    dx, dy = x - piece.x, y - piece.y
    if piece.radius:
        return max(0.0, math.hypot(dx, dy) - piece.radius)
    c, s = math.cos(piece.yaw), math.sin(piece.yaw)
    along, aside = abs(c * dx + s * dy) - piece.length / 2, abs(c * dy - s * dx) - piece.width / 2
    return math.hypot(max(0.0, along), max(0.0, aside))


def of_person(person: Person) -> Piece:
    """Return a person at the plan's start position."""
    return Piece(person.name, *person.at, 0.0, 0.0, 0.0, 1.7, person.radius)


_PATIENCE, _REST = 5.0, 20.0
"""Seconds for which a blocked person waits before turning to another point of the path, and then rests there."""


class Walker:
    """A walking person, who stops for the robot, does not push it, and cannot be pushed.

    After a long wait the person walks to another point of the path, because the robot may be waiting too.

    Attributes:
        person: the person in the plan.
        x: current position, meters.
        y: current position, meters.
    """

    def __init__(self, person: Person) -> None:
        self.person = person
        self.x, self.y = person.at
        self.send(person.path, loop=person.loop)

    def send(self, path: Iterable[Point], *, loop: bool = False) -> None:
        """Make the person walk to these points in sequence, starting at once."""
        self._path, self._loop = deque(path), loop
        self._waited, self._rest, self._turning_back = 0.0, 0.0, False

    def piece(self) -> Piece:
        """Return the person as a solid."""
        return of_person(self.person).moved(self.x, self.y, 0.0)

    def walk(self, seconds: float, robot: Point, room: float) -> bool:
        """Walk for a time, but stop before person and robot are too close; return whether the person moved.

        ``room``: minimum distance from the robot's center to the edge of the person, meters.
        """
        if self._rest > 0.0:
            self._rest -= seconds
            return False
        left = self.person.speed * seconds
        x, y = self.x, self.y
        for _ in range(len(self._path)):  # at most one round, because the points may all be at one place
            goal = self._path[0]
            away = math.hypot(goal[0] - x, goal[1] - y)
            if away > left:
                x, y = x + (goal[0] - x) / away * left, y + (goal[1] - y) / away * left
                break
            (x, y), left = goal, left - away
            self._path.popleft()
            if self._turning_back:
                self._turning_back, self._rest, left = False, _REST, 0.0
            if self._loop:
                self._path.append(goal)
            if left <= 0.0:
                break
        before = math.hypot(self.x - robot[0], self.y - robot[1])
        after = math.hypot(x - robot[0], y - robot[1])
        if after < before and after < room + self.person.radius:
            self._wait(seconds)
            return False
        self._waited = 0.0
        if (x, y) == (self.x, self.y):
            return False
        self.x, self.y = x, y
        return True

    def _wait(self, seconds: float) -> None:
        self._waited += seconds
        if self._waited > _PATIENCE and len(self._path) > 1:
            self._waited, self._turning_back = 0.0, True
            self._path.rotate(-1)
