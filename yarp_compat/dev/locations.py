"""Places on maps (`yarp/dev/Map2DLocation.h`, `Map2DObject.h`, `Map2DArea.h`, `Map2DPath.h`).

Equality includes the descriptions, which YARP ignores.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from yarp_compat.dev.fields import Structure
from yarp_compat.os.data.stdvector import StdVector
from yarp_compat.overriding import override
from yarp_compat.sig.vec2d import Vec2D


class _Place(Structure):
    """The methods that all places have in YARP."""

    def toString(self) -> str:
        """Return all fields as text."""
        raise NotImplementedError

    def toString_c(self) -> str:
        """Return all fields as text."""
        return self.toString()

    def isEqual(self, other: object) -> bool:
        return self == other

    def notEqual(self, other: object) -> bool:
        return self != other


@dataclass
class Map2DLocation(_Place):
    """A pose on the map ``map_id``: x and y in meters, theta in degrees; the description is for users."""

    map_id: str = ""
    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    description: str = ""

    def is_near_to(
        self, other_loc: Map2DLocation, linear_tolerance: float, angular_tolerance: float = math.inf
    ) -> bool:
        """Whether another pose is on the same map and within the tolerances, in meters and degrees."""
        if self.map_id != other_loc.map_id or linear_tolerance < 0 or angular_tolerance < 0:
            return False
        if math.hypot(self.x - other_loc.x, self.y - other_loc.y) > linear_tolerance:
            return False
        return (
            math.isinf(angular_tolerance)
            or abs(math.remainder(other_loc.theta - self.theta, 360.0)) <= angular_tolerance
        )

    @override
    def toString(self) -> str:
        return f"map_id:{self.map_id} x:{self.x:g} y:{self.y:g} theta:{self.theta:g}desc:{self.description}"


class Map2DLocationVector(StdVector):
    """A vector of locations."""

    def __init__(self, content: int | Iterable[Map2DLocation] = ()) -> None:
        super().__init__((Map2DLocation() for _ in range(content)) if isinstance(content, int) else content)


@dataclass
class Map2DObject(_Place):
    """A pose in space on the map ``map_id``: meters, and angles about the three axes; the description is for users."""

    map_id: str = ""
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    description: str = ""

    def is_near_to(self, other_loc: Map2DObject | Map2DLocation, linear_tolerance: float) -> bool:
        """Whether a place is on the same map and within the tolerance in meters (of a location, only x and y count)."""
        if self.map_id != other_loc.map_id or linear_tolerance < 0:
            return False
        height = self.z - other_loc.z if isinstance(other_loc, Map2DObject) else 0.0
        return math.hypot(self.x - other_loc.x, self.y - other_loc.y, height) <= linear_tolerance

    @override
    def toString(self) -> str:
        place = f"map_id:{self.map_id} x:{self.x:g} y:{self.y:g} z:{self.z:g}"
        return f"{place} roll:{self.roll:g} pitch:{self.pitch:g} yaw:{self.yaw:g} desc:{self.description}"


@dataclass
class Map2DArea(_Place):
    """A polygon on the map ``map_id``, with corners in meters; the description is for users."""

    map_id: str = ""
    points: list[Vec2D] = field(default_factory=list)
    description: str = ""

    def isValid(self) -> bool:
        """Whether the area has at least three corners and is on a map."""
        return len(self.points) >= 3 and self.map_id != ""

    def checkLocationInsideArea(self, loc: Map2DLocation) -> bool:
        """Whether a location is inside the area."""
        return loc.map_id == self.map_id and self.contains(loc.x, loc.y)

    def checkObjectInsideArea(self, obj: Map2DObject) -> bool:
        """Whether an object is inside the area."""
        return obj.map_id == self.map_id and self.contains(obj.x, obj.y)

    def contains(self, x: float, y: float) -> bool:
        """Whether a point on the area's map (meters) is inside."""
        return len(self.points) >= 3 and sum(border <= x for border in self._borders(y)) % 2 == 1

    def findAreaBounds(self) -> tuple[Map2DLocation, Map2DLocation] | None:
        """Return the corners of the bounding box, None if the area is invalid.

        Unlike in YARP, the maximum may be negative.
        """
        if not self.isValid():
            return None
        xs, ys = [point.x for point in self.points], [point.y for point in self.points]
        return Map2DLocation(self.map_id, min(xs), min(ys)), Map2DLocation(self.map_id, max(xs), max(ys))

    def getCentroid(self) -> Map2DLocation | None:
        """Return the center of the bounding box; None for an invalid area. YARP returns half the box's size instead."""
        bounds = self.findAreaBounds()
        if bounds is None:
            return None
        low, high = bounds
        return Map2DLocation(self.map_id, (low.x + high.x) / 2, (low.y + high.y) / 2)

    def getRandomLocation(self) -> Map2DLocation | None:
        """Return a random location inside, with theta 0; None if the area is invalid or empty."""
        bounds = self.findAreaBounds()
        if bounds is None:
            return None
        low, high = bounds
        for _ in range(100):
            y = random.uniform(low.y, high.y)  # noqa: S311
            borders = sorted(self._borders(y))
            pieces = list(zip(borders[::2], borders[1::2], strict=True))
            if any(end > start for start, end in pieces):
                start, end = random.choices(pieces, [end - start for start, end in pieces])[0]  # noqa: S311
                return Map2DLocation(self.map_id, random.uniform(start, end), y)  # noqa: S311
        return None

    def clear(self) -> None:
        """Remove the map, the corners and the description."""
        self.map_id, self.description = "", ""
        self.points.clear()

    @override
    def toString(self) -> str:
        points = "".join(f" point {i}({point.x:g},{point.y:g})" for i, point in enumerate(self.points))
        return f"map_id:{self.map_id} {points}desc:{self.description}"

    def __getitem__(self, index: int) -> Vec2D:
        return self.points[index]

    def __len__(self) -> int:
        return len(self.points)

    def __bool__(self) -> bool:
        return True  # even without corners

    def _borders(self, y: float) -> list[float]:
        """Return the x of each crossing of the polygon and the line at ``y``."""
        corners = zip(self.points, [*self.points[1:], *self.points[:1]], strict=True)
        return [
            (end.x - start.x) * (y - start.y) / (end.y - start.y) + start.x
            for start, end in corners
            if (start.y > y) != (end.y > y)
        ]


@dataclass
class Map2DPath(_Place):
    """A path: the poses to pass, and a description for users."""

    waypoints: list[Map2DLocation] = field(default_factory=list)
    description: str = ""

    def size(self) -> int:
        """Return the number of poses."""
        return len(self.waypoints)

    def getLength(self) -> float:
        """Return the length in meters, without steps to another map; YARP adds the poses' distances from the origin."""
        steps = zip(self.waypoints, self.waypoints[1:], strict=False)
        return sum(math.hypot(b.x - a.x, b.y - a.y) for a, b in steps if a.map_id == b.map_id)

    def isOnSingleMap(self) -> bool:
        """Whether all poses are on one map."""
        return len({waypoint.map_id for waypoint in self.waypoints}) <= 1

    def push_back(self, loc: Map2DLocation) -> None:
        """Append a pose."""
        self.waypoints.append(loc)

    def clear(self) -> None:
        """Remove the poses and the description."""
        self.waypoints.clear()
        self.description = ""

    @override
    def toString(self) -> str:
        places = "".join(
            f" waypoint {i}({place.map_id} {place.x:.2g},{place.y:.2g},{place.theta:.2g})"
            for i, place in enumerate(self.waypoints)
        )
        return f"{places} desc: {self.description}"

    def __getitem__(self, index: int) -> Map2DLocation:
        return self.waypoints[index]

    def __iter__(self) -> Iterator[Map2DLocation]:
        return iter(self.waypoints)

    def __len__(self) -> int:
        return len(self.waypoints)

    def __bool__(self) -> bool:
        return True  # even without poses
