"""The kinds of values in the store, and how each is encoded.

All kinds except maps are JSON, in meters; ``theta_deg`` is in degrees, and the angles of an object are as its YARP
client gave them. A map is a line of JSON, then the occupancy and the flags, each a zlib stream. The line is
``{"midspan": "map", "version": 1, "name", "width", "height", "resolution", "origin": [x, y, theta_deg],
"occupancy": <bytes>, "flags": <bytes>}`` and a newline. Each cell is a byte, row by row from the top: occupancy 0 to
100 or 255 for unknown, flags 0 to 5 with YARP's values. A three-dimensional map is a file: OctoMap's ``.bt`` or
``.ot``, or a binary ``.pcd``.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from bridge.stores.entry import StoreError, json_object
from yarp_compat.dev.extras import AreaBehavior, MapLink
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapgrid import MAX_CELLS, MapFlag, MapGrid2D, too_large
from yarp_compat.octomap import Octomap
from yarp_compat.sig.cloudfile import read_cloud, write_pcd
from yarp_compat.sig.pointcloud import PointCloud
from yarp_compat.sig.vec2d import Vec2D
from yarp_compat.wire.errors import WireError

T = TypeVar("T")
Json = Mapping[str, Any]

_MOST_POINTS = 10_000
_POSE = ("x", "y", "z", "roll", "pitch", "yaw")


def _write_json(value: Json) -> bytes:
    """Encode a JSON object; raises `StoreError` for values that JSON cannot represent."""
    try:
        return json.dumps(value, ensure_ascii=False, allow_nan=False).encode()
    except ValueError:
        raise StoreError(f"a number or text cannot be represented in JSON: {value!r:.200}") from None


def location_json(location: Map2DLocation) -> Json:
    """Return ``{"map", "x", "y", "theta_deg", "description"}``."""
    pose = {"x": location.x, "y": location.y, "theta_deg": location.theta}
    return {"map": location.map_id, **pose, "description": location.description}


def _json_location(document: Json) -> Map2DLocation:
    x, y, theta = (_number(document, key) for key in ("x", "y", "theta_deg"))
    return Map2DLocation(_text(document, "map"), x, y, theta, _text(document, "description"))


def area_json(area: Map2DArea) -> Json:
    """Return ``{"map", "points": [[x, y], ...], "description"}``."""
    points = [[point.x, point.y] for point in area.points]
    return {"map": area.map_id, "points": points, "description": area.description}


def _json_area(document: Json) -> Map2DArea:
    points = [_point(point) for point in _several(document, "points")]
    return Map2DArea(_text(document, "map"), points, _text(document, "description"))


def path_json(path: Map2DPath) -> Json:
    """Return ``{"waypoints": [location, ...], "description"}``."""
    return {"waypoints": [location_json(point) for point in path.waypoints], "description": path.description}


def _json_path(document: Json) -> Map2DPath:
    waypoints = [_json_location(_object(point)) for point in _several(document, "waypoints")]
    return Map2DPath(waypoints, _text(document, "description"))


def object_json(thing: Map2DObject) -> Json:
    """Return ``{"map", "x", "y", "z", "roll", "pitch", "yaw", "description"}``."""
    pose = {key: getattr(thing, key) for key in _POSE}
    return {"map": thing.map_id, **pose, "description": thing.description}


def _json_object(document: Json) -> Map2DObject:
    x, y, z, roll, pitch, yaw = (_number(document, key) for key in _POSE)
    return Map2DObject(_text(document, "map"), x, y, z, roll, pitch, yaw, _text(document, "description"))


def behavior_json(behavior: AreaBehavior) -> Json:
    """Return ``{"max_speed", "on_obstacle", "keep_out"}``; the speed in m/s, null without a limit."""
    return {key: getattr(behavior, key) for key in ("max_speed", "on_obstacle", "keep_out")}


def _json_behavior(document: Json) -> AreaBehavior:
    speed = document.get("max_speed")
    limit = None if speed is None else _finite(speed, "max_speed")
    keep_out = document.get("keep_out", False)
    if not isinstance(keep_out, bool):
        raise StoreError(f"keep_out must be true or false, not {keep_out!r:.60}")
    try:
        return AreaBehavior(max_speed=limit, on_obstacle=_text(document, "on_obstacle"), keep_out=keep_out)
    except ValueError as err:
        raise StoreError(str(err)) from None


def link_json(link: MapLink) -> Json:
    """Return ``{"from", "to", "cost"}``, with the names of two locations."""
    return {"from": link.first, "to": link.second, "cost": link.cost}


def _json_link(document: Json) -> MapLink:
    try:
        return MapLink(_text(document, "from"), _text(document, "to"), _number(document, "cost"))
    except ValueError as err:
        raise StoreError(str(err)) from None


def _number(document: Json, key: str) -> float:
    return _finite(document.get(key, 0.0), key)


def _finite(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise StoreError(f"{what} is not a number: {value!r:.60}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise StoreError(f"{what} is not a finite number")
    return number


def _text(document: Json, key: str) -> str:
    value = document.get(key, "")
    if not isinstance(value, str):
        raise StoreError(f"{key} is not a text: {value!r:.60}")
    return value


def _several(document: Json, key: str) -> Sequence[Any]:
    value = document.get(key, [])
    if not isinstance(value, list) or len(value) > _MOST_POINTS:
        raise StoreError(f"{key} is not a list of up to {_MOST_POINTS} elements")
    return value


def _point(value: Any) -> Vec2D:
    if not isinstance(value, list) or len(value) != 2:
        raise StoreError(f"a point must be [x, y], not {value!r:.60}")
    return Vec2D(_finite(value[0], "x"), _finite(value[1], "y"))


def _object(value: Any) -> Json:
    if not isinstance(value, dict):
        raise StoreError(f"a waypoint must be a JSON object, not {value!r:.60}")
    return value


_VERSION = 1
_MOST_HEAD = 4096
_LEVEL = 1
_OCCUPANCY = bytes([*range(101), 255])
_FLAGS = bytes(MapFlag)


def _write_map(name: str, grid: MapGrid2D) -> bytes:
    """Encode a map under this name, which may differ from the map's own name."""
    streams = [zlib.compress(np.ascontiguousarray(cells).data, _LEVEL) for cells in (grid.occupancy, grid.flags)]
    _check(grid.occupancy.tobytes(), _OCCUPANCY, "occupancy")
    _check(grid.flags.tobytes(), _FLAGS, "flags")
    head = {
        "midspan": "map",
        "version": _VERSION,
        "name": name,
        "width": grid.width(),
        "height": grid.height(),
        "resolution": grid.resolution,
        "origin": list(grid.origin),
        "occupancy": len(streams[0]),
        "flags": len(streams[1]),
    }
    return b"".join((_write_json(head), b"\n", *streams))


def _read_map(name: str, body: bytes) -> MapGrid2D:
    """Decode a map, under its name in the store; raises `StoreError`."""
    head, start = _head(body)
    width, height = _size(head)
    middle = start + _whole(head, "occupancy")
    end = middle + _whole(head, "flags")
    if end != len(body):
        raise StoreError(f"the map has {len(body)} bytes, but its head requires {end}")
    occupancy = _cells(body[start:middle], width, height, _OCCUPANCY, "occupancy")
    flags = _cells(body[middle:], width, height, _FLAGS, "flags")
    x, y, theta = _origin(head)
    resolution = _finite(head.get("resolution"), "resolution")
    try:
        return MapGrid2D.of(flags, occupancy, name=name, resolution=resolution, origin=(x, y, theta))
    except ValueError as err:
        raise StoreError(str(err)) from None


def _head(body: bytes) -> tuple[Any, int]:
    end = body.find(b"\n", 0, _MOST_HEAD)
    head = json_object(body[: max(end, 0)])
    if head.get("midspan") != "map" or head.get("version") != _VERSION:
        raise StoreError(f"not a map of version {_VERSION}: {json.dumps(head)[:80]}")
    return head, end + 1


def _size(head: Any) -> tuple[int, int]:
    width, height = _whole(head, "width"), _whole(head, "height")
    if not width or not height:
        raise StoreError(f"a map of {width} x {height} cells is empty")
    if width * height > MAX_CELLS:
        raise StoreError(too_large(width, height))
    return width, height


def _origin(head: Any) -> list[float]:
    origin = [_finite(number, "origin") for number in _several(head, "origin")]
    if len(origin) != 3:
        raise StoreError("a map's origin must have three numbers")
    return origin


def _whole(head: Any, key: str) -> int:
    value = head.get(key)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise StoreError(f"{key} is not a non-negative integer: {value!r:.60}")
    return value


def _cells(part: bytes, width: int, height: int, good: bytes, what: str) -> NDArray[np.uint8]:
    try:
        # one byte more than expected detects a longer stream, without unpacking the rest
        data = zlib.decompressobj().decompress(part, width * height + 1)
    except zlib.error as err:
        raise StoreError(f"the map's {what} cannot be decompressed: {err}") from None
    if len(data) != width * height:
        raise StoreError(f"the map's {what} does not have the {width * height} cells that its head states")
    _check(data, good, what)
    return np.frombuffer(data, np.uint8).reshape(height, width).copy()


def _check(data: bytes, good: bytes, what: str) -> None:
    if wrong := data.translate(None, good):
        raise StoreError(f"the map's {what} has a cell with the invalid value {wrong[0]}")


Map3D = Octomap | PointCloud
"""A three-dimensional map."""


def read_map3d(body: bytes) -> Map3D:
    """Parse an octomap or point cloud completely; raises `StoreError` with the reason if it is invalid."""
    try:
        if not body.startswith(b"# Octomap"):
            return read_cloud(body)
        octomap = Octomap.from_file(body)
        octomap.tree()
    except WireError as err:
        raise StoreError(str(err)) from None
    return octomap


def write_map3d(value: Map3D) -> bytes:
    """Encode a three-dimensional map as a file; raises `StoreError`."""
    try:
        if isinstance(value, PointCloud):
            return write_pcd(value)
        return value.bt() if value.binary else value.ot()
    except WireError as err:
        raise StoreError(str(err)) from None


JSON = "application/json"
GRID = "application/octet-stream;midspan-map"
FILE = "application/octet-stream;midspan-map3d"


@dataclass(frozen=True, slots=True)
class ValueKind(Generic[T]):
    """One kind of value, with functions that encode and decode it; they raise `StoreError`."""

    name: str
    encoding: str
    limit: int
    write: Callable[[str, T], bytes]
    read: Callable[[str, bytes], T]

    def encode(self, name: str, value: T) -> tuple[bytes, str]:
        """Return a value's body and encoding; raises `StoreError`."""
        try:
            body = self.write(name, value)
        except StoreError as err:
            raise StoreError(f"{self.name} {name!r}: {err}") from None
        self._check_size(name, body)
        return body, self.encoding

    def decode(self, name: str, body: bytes) -> T:
        """Return the value of a body; raises `StoreError`."""
        self._check_size(name, body)
        try:
            return self.read(name, body)
        except StoreError as err:
            raise StoreError(f"{self.name} {name!r}: {err}") from None

    def _check_size(self, name: str, body: bytes) -> None:
        if len(body) > self.limit:
            raise StoreError(f"{self.name} {name!r} has {len(body)} bytes; the limit is {self.limit}")


def _json_kind(name: str, write: Callable[[T], Json], read: Callable[[Json], T]) -> ValueKind[T]:
    """Return a kind whose bodies are JSON that does not contain the name."""
    return ValueKind(
        name, JSON, 1 << 20, lambda _, value: _write_json(write(value)), lambda _, body: read(json_object(body))
    )


MAP: ValueKind[MapGrid2D] = ValueKind("map", GRID, 64 << 20, _write_map, _read_map)
MAP3D: ValueKind[Map3D] = ValueKind(
    "map3d", FILE, 64 << 20, lambda _, value: write_map3d(value), lambda _, body: read_map3d(body)
)
LOCATION = _json_kind("location", location_json, _json_location)
AREA = _json_kind("area", area_json, _json_area)
PATH = _json_kind("path", path_json, _json_path)
OBJECT = _json_kind("object", object_json, _json_object)
LINK = _json_kind("link", link_json, _json_link)
BEHAVIOR = _json_kind("behaviour", behavior_json, _json_behavior)
"""The rules of an area for robots, under the area's name."""
CURRENT: ValueKind[str] = _json_kind("current", lambda name: {"map": name}, lambda document: _text(document, "map"))
"""The current value of a kind; the key ``map`` has the name of the current map."""

KINDS: dict[str, ValueKind[Any]] = {
    kind.name: kind for kind in (MAP, MAP3D, LOCATION, AREA, BEHAVIOR, PATH, OBJECT, LINK, CURRENT)
}
