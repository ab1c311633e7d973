"""Floor plans: what stands where, as one writes it in a YAML file. Metres and degrees."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field, model_validator

from bridge.config.sections.section import Section

Point = tuple[float, float]
Pose = tuple[float, float, float]
Line = tuple[Point, ...]
Size = Annotated[float, Field(gt=0, le=1000)]


class Door(Section):
    """A door in a wall; the wall has a hole for it by itself."""

    name: str
    line: tuple[Point, Point] = Field(description="From one post to the other.")
    open: bool = Field(default=True, description="Whether it stands open at the start.")


class Box(Section):
    """A box; with a mass it can be pushed, without it stands fast."""

    name: str = ""
    at: Pose
    size: tuple[Size, Size, Size] = Field(description="Length, width, height.")
    mass: float | None = Field(default=None, gt=0, le=10_000, description="Kilograms.")
    friction: float = Field(default=0.4, ge=0, le=2)


class Round(Section):
    """A round thing that stands fast: a column, a table."""

    name: str = ""
    at: Point
    radius: Size
    height: Size = 1.0


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
    doors: tuple[Door, ...] = ()
    boxes: tuple[Box, ...] = ()
    rounds: tuple[Round, ...] = ()
    people: tuple[Person, ...] = ()
    rooms: dict[str, Room] = Field(default_factory=dict)
    locations: dict[str, Pose] = Field(default_factory=dict, description="Named places.")
    start: Pose = Field(default=(0.0, 0.0, 0.0), description="Where the robot stands first.")

    @model_validator(mode="after")
    def _names_differ(self) -> Floor:
        things: tuple[Door | Box | Round | Person, ...] = (*self.doors, *self.boxes, *self.rounds, *self.people)
        names = [thing.name for thing in things if thing.name]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            msg = f"two things are called {twice!r}"
            raise ValueError(msg)
        both = next(iter(self.rooms.keys() & self.locations.keys()), None)
        if both is not None:
            msg = f"{both!r} is a room and a location"
            raise ValueError(msg)
        flat = [value for wall in self.walls for point in wall for value in point]
        if not all(math.isfinite(value) and abs(value) < 10_000 for value in flat):
            msg = "a wall is not within 10 km"
            raise ValueError(msg)
        return self

    @property
    def places(self) -> dict[str, Pose]:
        """Named places, the rooms' among them."""
        return {**{name: room.pose for name, room in self.rooms.items()}, **self.locations}

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """The least and greatest x and y of all walls and what stands fast, metres: x0, y0, x1, y1."""
        points = [p for wall in self.walls for p in wall] + [p for door in self.doors for p in door.line]
        for box in self.boxes:
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
                    msg = f"the link {link.name!r} ends at {floor}/{place}, which is no location of a floor"
                    raise ValueError(msg)
        return self
