"""What stands on a floor, as simple solids, and people who walk: DART touches them, the laser sees them."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.plan import Box, Floor, Person, Point, RoomDoor, Round, Table

_ON_LINE = 0.02  # metres that a door's post may lie beside its wall's middle line


@dataclass(frozen=True)
class Piece:
    """An upright solid: a box, or a cylinder where it has a radius."""

    name: str  #: "" for one that nobody names
    x: float  #: its middle, metres
    y: float  #: its middle, metres
    yaw: float  #: radians
    length: float  #: metres, along its own x
    width: float  #: metres
    height: float  #: metres, from its underside to its top
    radius: float = 0.0  #: metres; 0 for a box
    above: float = 0.0  #: metres from the floor to its underside

    @property
    def top(self) -> float:
        """Metres from the floor to its top."""
        return self.above + self.height

    @property
    def reach(self) -> float:
        """How far from its middle it reaches, metres."""
        return self.radius or math.hypot(self.length, self.width) / 2

    def moved(self, x: float, y: float, yaw: float) -> Piece:
        """The same one elsewhere."""
        return replace(self, x=x, y=y, yaw=yaw)

    def corners(self) -> NDArray[np.float64]:
        """A box's four corners, counterclockwise, (4, 2) metres."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        half = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (self.length / 2, self.width / 2)
        turned: NDArray[np.float64] = half @ np.array([[c, s], [-s, c]]) + (self.x, self.y)
        return turned

    def segments(self) -> NDArray[np.float64]:
        """A box's four sides, (4, 4): x1, y1, x2, y2 in metres."""
        corners = self.corners()
        return np.hstack([corners, np.roll(corners, -1, axis=0)])


def bar(name: str, a: Point, b: Point, thickness: float, height: float, *, beyond: float = 0.0) -> Piece:
    """A piece of wall from one point to another, and so much beyond both."""
    length = math.hypot(b[0] - a[0], b[1] - a[1])
    yaw = math.atan2(b[1] - a[1], b[0] - a[0])
    return Piece(name, (a[0] + b[0]) / 2, (a[1] + b[1]) / 2, yaw, length + 2 * beyond, thickness, height)


def walls(floor: Floor) -> Iterator[Piece]:
    """The walls, with holes where doors and openings are."""
    holes = [door.line for door in floor.doors] + list(floor.openings)
    for line in floor.walls:
        for a, b in itertools.pairwise(line):
            for start, end, first, last in _standing(a, b, holes):
                # corners are closed; at a hole the wall ends where the hole begins
                half = floor.thickness / 2
                length = math.hypot(b[0] - a[0], b[1] - a[1])
                begin, stop = start - half * first, end + half * last
                ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
                one = (a[0] + ux * begin, a[1] + uy * begin)
                other = (a[0] + ux * stop, a[1] + uy * stop)
                yield bar("", one, other, floor.thickness, floor.height)


def _standing(a: Point, b: Point, holes: Iterable[tuple[Point, Point]]) -> Iterator[tuple[float, float, bool, bool]]:
    """What is left of a wall: from, to (metres from ``a``), and whether each is the wall's own end."""
    length = math.hypot(b[0] - a[0], b[1] - a[1])
    if length < 1e-6:
        return
    cuts = sorted(cut for hole in holes if (cut := _cut(a, b, length, hole)) is not None)
    at = 0.0
    for begin, end in cuts:
        if begin > at + 1e-6:
            yield at, begin, at == 0.0, False
        at = max(at, end)
    if at < length - 1e-6:
        yield at, length, at == 0.0, True


def _cut(a: Point, b: Point, length: float, hole: tuple[Point, Point]) -> tuple[float, float] | None:
    ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
    along = sorted((p[0] - a[0]) * ux + (p[1] - a[1]) * uy for p in hole)
    beside = max(abs((p[1] - a[1]) * ux - (p[0] - a[0]) * uy) for p in hole)
    if beside > _ON_LINE or along[1] <= 1e-6 or along[0] >= length - 1e-6:
        return None
    return max(along[0], 0.0), min(along[1], length)


def leaf(door: RoomDoor, floor: Floor) -> Piece:
    """A door's leaf when it is closed."""
    return bar(door.name, *door.line, min(floor.thickness, 0.06), floor.height)


def of_box(box: Box) -> Piece:
    """A box."""
    x, y, yaw = box.at
    return Piece(box.name, x, y, math.radians(yaw), *box.size, above=box.above)


def of_round(thing: Round) -> Piece:
    """A round thing."""
    return Piece(thing.name, *thing.at, 0.0, 0.0, 0.0, thing.height, thing.radius, thing.above)


def of_table(table: Table) -> Iterator[Piece]:
    """A table's board, and its legs, which have no name."""
    (x, y, degrees), (length, width, height) = table.at, table.size
    yaw, under = math.radians(degrees), height - table.board
    yield Piece(table.name, x, y, yaw, length, width, table.board, above=under)
    c, s = math.cos(yaw), math.sin(yaw)
    for along, aside in itertools.product((-1, 1), repeat=2):
        dx, dy = along * (length - table.leg) / 2, aside * (width - table.leg) / 2
        yield Piece("", x + c * dx - s * dy, y + s * dx + c * dy, yaw, table.leg, table.leg, under)


def standing(floor: Floor) -> list[Piece]:
    """What stands fast on a floor but for doors."""
    boxes = (of_box(box) for box in floor.boxes if box.mass is None)
    tables = (piece for table in floor.tables for piece in of_table(table))
    return [*walls(floor), *boxes, *(of_round(thing) for thing in floor.rounds), *tables]


def of_person(person: Person) -> Piece:
    """A person, where the plan has them at the start."""
    return Piece(person.name, *person.at, 0.0, 0.0, 0.0, 1.7, person.radius)


_PATIENCE, _REST = 5.0, 20.0
"""Seconds that somebody waits for a robot in the way before turning to the next point of the path, and rests there."""


class Walker:
    """A person on the way. They are neither pushed nor do they push: they wait where somebody is in the way.

    Who has waited for long turns to the next point of the path: two who wait for one another would do so for ever.

    Attributes:
        person: who, as the plan has them.
        x: where, metres.
        y: where, metres.
    """

    def __init__(self, person: Person) -> None:
        self.person = person
        self.x, self.y = person.at
        self.send(person.path, loop=person.loop)

    def send(self, path: Iterable[Point], *, loop: bool = False) -> None:
        """Have the person walk to these points, one after the other, at once."""
        self._way, self._loop = deque(path), loop
        self._waited, self._rest, self._gives_way = 0.0, 0.0, False

    def piece(self) -> Piece:
        """The person as a solid."""
        return of_person(self.person).moved(self.x, self.y, 0.0)

    def walk(self, seconds: float, robot: Point, room: float) -> bool:
        """Walk for so long; whether the person moved. Within ``room`` metres of the robot they come no nearer."""
        if self._rest > 0.0:
            self._rest -= seconds
            return False
        left = self.person.speed * seconds
        x, y = self.x, self.y
        while self._way and left > 0.0:
            goal = self._way[0]
            away = math.hypot(goal[0] - x, goal[1] - y)
            if away > left:
                x, y = x + (goal[0] - x) / away * left, y + (goal[1] - y) / away * left
                break
            (x, y), left = goal, left - away
            self._way.popleft()
            if self._gives_way:
                self._gives_way, self._rest, left = False, _REST, 0.0
            if self._loop:
                self._way.append(goal)
            if away == 0.0 and len(self._way) <= 1:
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
        if self._waited > _PATIENCE and len(self._way) > 1:
            self._waited, self._gives_way = 0.0, True
            self._way.rotate(-1)
