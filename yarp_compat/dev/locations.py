"""Places on maps (`yarp/dev/Map2DLocation.h`, `Map2DObject.h`, `Map2DArea.h`, `Map2DPath.h`)."""

from __future__ import annotations

from dataclasses import dataclass, field

from yarp_compat.dev.structure import Structure
from yarp_compat.sig.vec2d import Vec2D


@dataclass
class Map2DLocation(Structure):
    """A pose on a map.

    Attributes:
        map_id: the map's name.
        x: metres.
        y: metres.
        theta: degrees.
        description: for people.
    """

    map_id: str = ""
    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0
    description: str = ""


@dataclass
class Map2DObject(Structure):
    """A pose in space on a map.

    Attributes:
        map_id: the map's name.
        x: metres.
        y: metres.
        z: metres.
        roll: angle about the first axis.
        pitch: angle about the second axis.
        yaw: angle about the third axis.
        description: for people.
    """

    map_id: str = ""
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    description: str = ""


@dataclass
class Map2DArea(Structure):
    """A polygon on a map.

    Attributes:
        map_id: the map's name.
        points: its corners, metres.
        description: for people.
    """

    map_id: str = ""
    points: list[Vec2D] = field(default_factory=list)
    description: str = ""


@dataclass
class Map2DPath(Structure):
    """A way.

    Attributes:
        waypoints: the poses to pass.
        description: for people.
    """

    waypoints: list[Map2DLocation] = field(default_factory=list)
    description: str = ""
