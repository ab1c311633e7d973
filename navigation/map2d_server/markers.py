"""Places on the current map as markers for rviz (``visualization_msgs/msg/MarkerArray``)."""

from __future__ import annotations

import math

from bridge.stores.kinds import AREA, LOCATION, OBJECT, PATH
from bridge.stores.store import Store
from navigation.map2d_server.messages import Head, Message, colour, points
from navigation.messages import pose_message
from navigation.pose import Pose
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath

TOPIC = "/map_locations"
TYPE = "visualization_msgs/msg/MarkerArray"

_ARROW, _CUBE, _LINES, _TEXT = 0, 1, 4, 9
_DELETE_ALL = 3
_TEXT_HEIGHT = 0.2
_GREEN, _BLUE, _ORANGE, _GREY = (
    colour(0.1, 0.7, 0.2),
    colour(0.1, 0.4, 0.9),
    colour(1.0, 0.6, 0.0),
    colour(0.5, 0.5, 0.5),
)


def markers(store: Store, map_name: str, head: Head) -> Message:
    """All places on a map. Markers that were shown before go: the first of the list deletes all."""
    made = _Markers(head)
    for name, location in store.all(LOCATION).items():
        if location.map_id == map_name:
            made.add_location(name, location)
    for name, thing in store.all(OBJECT).items():
        if thing.map_id == map_name:
            made.add_object(name, thing)
    for name, area in store.all(AREA).items():
        if area.map_id == map_name and area.points:
            made.add_area(name, area)
    for name, path in store.all(PATH).items():
        made.add_path(name, path, map_name)
    return {"markers": made.markers}


class _Markers:
    """Makes the markers of places; a place's marker and text have its name as namespace."""

    def __init__(self, head: Head) -> None:
        self._header = head.header()
        self.markers: list[Message] = [{"header": self._header, "action": _DELETE_ALL}]

    def add_location(self, name: str, location: Map2DLocation) -> None:
        shape = {"x": 0.4, "y": 0.08, "z": 0.08}
        place = pose_message(Pose(location.x, location.y, math.radians(location.theta)))
        self._add("location", name, _ARROW, pose=place, scale=shape, color=_GREEN)
        self._text("location", name, location.x, location.y)

    def add_object(self, name: str, thing: Map2DObject) -> None:
        shape = {"x": 0.15, "y": 0.15, "z": 0.15}
        place = pose_message(Pose(thing.x, thing.y, 0.0), thing.z)
        self._add("object", name, _CUBE, pose=place, scale=shape, color=_ORANGE)
        self._text("object", name, thing.x, thing.y)

    def add_area(self, name: str, area: Map2DArea) -> None:
        corners = [(corner.x, corner.y) for corner in (*area.points, area.points[0])]
        self._line("area", name, corners, _BLUE)
        count = len(area.points)
        self._text("area", name, sum(p.x for p in area.points) / count, sum(p.y for p in area.points) / count)

    def add_path(self, name: str, path: Map2DPath, map_name: str) -> None:
        way = [(point.x, point.y) for point in path.waypoints if point.map_id == map_name]
        if len(way) > 1:
            self._line("path", name, way, _GREY)
            self._text("path", name, *way[0])

    def _line(self, kind: str, name: str, corners: list[tuple[float, float]], color: Message) -> None:
        width = {"x": 0.04, "y": 0.0, "z": 0.0}
        place = pose_message(Pose(0.0, 0.0, 0.0))
        self._add(kind, name, _LINES, pose=place, scale=width, color=color, points=points(corners))

    def _text(self, kind: str, name: str, x: float, y: float) -> None:
        shape = {"x": 0.0, "y": 0.0, "z": _TEXT_HEIGHT}
        place = pose_message(Pose(x, y, 0.0), 0.2)
        self._add(f"{kind} name", name, _TEXT, pose=place, scale=shape, color=colour(1, 1, 1), text=name)

    def _add(self, kind: str, name: str, form: int, **fields: object) -> None:
        number = len(self.markers)
        self.markers.append({"header": self._header, "ns": f"{kind} {name}", "id": number, "type": form, **fields})
