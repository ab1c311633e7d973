"""Places on the current map as markers for rviz, latched on ``/map_locations``.

Each place is encoded once, because a site may have thousands of them and each change is published with all of them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from bridge.hub.wire.qos import LATCHED
from bridge.messages.definitions.schema import Schema
from bridge.messages.values import HEADER, MessageWriter
from bridge.modules.host import ModuleNode
from bridge.stores.kinds import AREA, LOCATION, OBJECT, PATH
from bridge.stores.store import MapAreas, Store
from navigation.map2d_server.publishers import CurrentMap, Keys
from navigation.messages import Message, pose_message
from navigation.pose import Pose
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath

MARKERS, MARKER_TYPE, MARKERS_TYPE = (
    "/map_locations",
    "visualization_msgs/msg/Marker",
    "visualization_msgs/msg/MarkerArray",
)

_ARROW, _CUBE, _LINES, _TEXT = 0, 1, 4, 9
_DELETE_ALL = 3
_TEXT_HEIGHT = 0.2
_KINDS = (LOCATION, OBJECT, AREA, PATH)


def _color(red: float, green: float, blue: float) -> Message:
    return {"r": red, "g": green, "b": blue, "a": 1.0}


_GREEN, _BLUE, _ORANGE, _GRAY, _WHITE = (
    _color(0.1, 0.7, 0.2),
    _color(0.1, 0.4, 0.9),
    _color(1.0, 0.6, 0.0),
    _color(0.5, 0.5, 0.5),
    _color(1.0, 1.0, 1.0),
)


class Markers:
    """Publishes the places on the current map; the first marker deletes all previous ones.

    The namespaces of a place's marker and text contain the place's name. Stamps are 0, with which rviz uses the newest
    transform; a latched stamp would be older than the transforms of a program that starts later.
    """

    def __init__(self, node: ModuleNode, store: Store, frame: str) -> None:
        self._store, self._end = store, node.publisher(MARKERS, MARKERS_TYPE, LATCHED, priority="state")
        self._encoder = MarkerEncoder(node.registry.schema(MARKER_TYPE), frame)
        self._places: dict[tuple[str, str], list[tuple[bytes, bytes]]] = {}
        self._clear = [self._encoder.encode({"action": _DELETE_ALL})]

    def update(self, current: CurrentMap, areas: MapAreas, changed: Keys, *, map_changed: bool) -> None:
        """Publish the markers of the current map and its areas if a place or the map has changed."""
        names = {kind.name for kind in _KINDS}
        keys = {key for key in changed if key[0] in names}
        if map_changed:
            self._places.clear()
            keys = {(kind.name, name) for kind in _KINDS for name in self._store.names(kind)}
        if not (keys or map_changed):
            return
        for key in keys:
            markers = self._markers_of(*key, current.name, areas)
            self._places[key] = [self._encoder.encode(marker) for marker in markers]
            if not markers:
                del self._places[key]
        placed = [marker for key in sorted(self._places) for marker in self._places[key]]
        self._end.publish_cdr(joined(self._clear + placed))

    def _markers_of(self, kind: str, name: str, map_name: str, areas: MapAreas) -> list[Message]:
        """Return a place's markers on a map: none if it is on another map or does not exist."""
        if kind == AREA.name:
            area = areas.named[name][0] if name in areas.named else None
            return area_markers(name, area) if area is not None and area.points else []
        if kind == PATH.name:
            path = self._store.get(PATH, name)
            return [] if path is None else path_markers(name, path, map_name)
        if kind == OBJECT.name:
            thing = self._store.get(OBJECT, name)
            return object_markers(name, thing) if thing is not None and thing.map_id == map_name else []
        location = self._store.get(LOCATION, name)
        return location_markers(name, location) if location is not None and location.map_id == map_name else []


class MarkerEncoder:
    """Encodes markers so that they can be joined at any position.

    Args:
        schema: the schema of ``visualization_msgs/msg/Marker``.
        frame: the markers' frame.
    """

    def __init__(self, schema: Schema, frame: str) -> None:
        self._schema, self._header = schema, {"frame_id": frame}

    def encode(self, marker: Message) -> tuple[bytes, bytes]:
        """Return the CDR up to ``action``, whose values are aligned to 4 bytes, and from ``pose`` on, aligned to 8."""
        data = MessageWriter(self._schema).message({"header": self._header, **marker})[len(HEADER) :]
        # the stamp; frame_id and ns; id, type and action
        pose = 8 + _text_size(self._header["frame_id"]) + _text_size(marker.get("ns", "")) + 12
        return data[:pose], data[pose + -pose % 8 :]


def _text_size(text: str) -> int:
    """Return the size of a string in CDR with the padding of the next value: length, content, final zero."""
    size = 4 + len(text.encode()) + 1
    return size + -size % 4


def joined(markers: Sequence[tuple[bytes, bytes]]) -> bytes:
    """Return the ``MarkerArray`` of encoded markers in CDR."""
    data = bytearray(struct.pack("<I", len(markers)))
    for head, rest in markers:
        data += bytes(-len(data) % 4)
        data += head
        data += bytes(-len(data) % 8)
        data += rest
    return HEADER + data


def location_markers(name: str, location: Map2DLocation) -> list[Message]:
    """Return the markers of a location: an arrow and its name."""
    place = pose_message(Pose(location.x, location.y, math.radians(location.theta)))
    return [
        _marker("location", name, _ARROW, pose=place, scale={"x": 0.4, "y": 0.08, "z": 0.08}, color=_GREEN),
        _text("location", name, location.x, location.y),
    ]


def object_markers(name: str, thing: Map2DObject) -> list[Message]:
    """Return the markers of an object: a cube and its name."""
    place = pose_message(Pose(thing.x, thing.y, 0.0), thing.z)
    return [
        _marker("object", name, _CUBE, pose=place, scale={"x": 0.15, "y": 0.15, "z": 0.15}, color=_ORANGE),
        _text("object", name, thing.x, thing.y),
    ]


def area_markers(name: str, area: Map2DArea) -> list[Message]:
    """Return the markers of an area: its outline and its name."""
    corners = [(corner.x, corner.y) for corner in (*area.points, area.points[0])]
    count = len(area.points)
    x, y = sum(p.x for p in area.points) / count, sum(p.y for p in area.points) / count
    return [_line("area", name, corners, _BLUE), _text("area", name, x, y)]


def path_markers(name: str, path: Map2DPath, map_name: str) -> list[Message]:
    """Return the markers of a path's part on a map: a line and its name; none for fewer than two points."""
    points = [(point.x, point.y) for point in path.waypoints if point.map_id == map_name]
    return [_line("path", name, points, _GRAY), _text("path", name, *points[0])] if len(points) > 1 else []


def _line(kind: str, name: str, corners: Sequence[tuple[float, float]], color: Message) -> Message:
    points = [{"x": x, "y": y, "z": 0.02} for x, y in corners]
    place = pose_message(Pose(0.0, 0.0, 0.0))
    return _marker(kind, name, _LINES, pose=place, scale={"x": 0.04}, color=color, points=points)


def _text(kind: str, name: str, x: float, y: float) -> Message:
    place = pose_message(Pose(x, y, 0.0), 0.2)
    look = {"scale": {"z": _TEXT_HEIGHT}, "color": _WHITE}
    return _marker(f"{kind} name", name, _TEXT, id=1, pose=place, text=name, **look)


def _marker(kind: str, name: str, form: int, **fields: object) -> Message:
    return {"ns": f"{kind} {name}", "type": form, **fields}
