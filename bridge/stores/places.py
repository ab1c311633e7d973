"""Locations, areas, paths, objects and links as JSON: metres, and YARP's degrees, said in the keys' names."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from bridge.stores.errors import StoreError
from yarp_compat.dev.area_behaviour import AreaBehaviour
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.maplink import MapLink
from yarp_compat.sig.vec2d import Vec2D

T = TypeVar("T")
Json = Mapping[str, Any]

_MOST_POINTS = 10_000
_POSE = ("x", "y", "z", "roll", "pitch", "yaw")


def read_json(body: bytes) -> Json:
    """The JSON object that a body holds; raises `StoreError`."""
    try:
        found = json.loads(body)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        msg = "it is not a JSON object"
        raise StoreError(msg)
    return found


def write_json(found: Json) -> bytes:
    """A body that holds a JSON object; raises `StoreError` where a number is none."""
    try:
        return json.dumps(found, ensure_ascii=False, allow_nan=False).encode()
    except ValueError:
        msg = f"it has a number or a text that JSON cannot carry: {found!r:.200}"
        raise StoreError(msg) from None


def location_json(location: Map2DLocation) -> Json:
    """``{"map", "x", "y", "theta_deg", "description"}``."""
    return {
        "map": location.map_id,
        "x": location.x,
        "y": location.y,
        "theta_deg": location.theta,
        "description": location.description,
    }


def json_location(found: Json) -> Map2DLocation:
    """The other way round; raises `StoreError`."""
    x, y, theta = (number(found, key) for key in ("x", "y", "theta_deg"))
    return Map2DLocation(text(found, "map"), x, y, theta, text(found, "description"))


def area_json(area: Map2DArea) -> Json:
    """``{"map", "points": [[x, y], ...], "description"}``."""
    points = [[point.x, point.y] for point in area.points]
    return {"map": area.map_id, "points": points, "description": area.description}


def json_area(found: Json) -> Map2DArea:
    """The other way round; raises `StoreError`."""
    points = [_point(point) for point in several(found, "points")]
    return Map2DArea(text(found, "map"), points, text(found, "description"))


def path_json(path: Map2DPath) -> Json:
    """``{"waypoints": [location, ...], "description"}``."""
    return {"waypoints": [location_json(point) for point in path.waypoints], "description": path.description}


def json_path(found: Json) -> Map2DPath:
    """The other way round; raises `StoreError`."""
    waypoints = [json_location(_object(point)) for point in several(found, "waypoints")]
    return Map2DPath(waypoints, text(found, "description"))


def object_json(thing: Map2DObject) -> Json:
    """``{"map", "x", "y", "z", "roll", "pitch", "yaw", "description"}``."""
    pose = {key: getattr(thing, key) for key in _POSE}
    return {"map": thing.map_id, **pose, "description": thing.description}


def json_object(found: Json) -> Map2DObject:
    """The other way round; raises `StoreError`."""
    x, y, z, roll, pitch, yaw = (number(found, key) for key in _POSE)
    return Map2DObject(text(found, "map"), x, y, z, roll, pitch, yaw, text(found, "description"))


def behaviour_json(behaviour: AreaBehaviour) -> Json:
    """``{"max_speed", "on_obstacle", "keep_out"}``; the speed in m/s, null where there is no limit."""
    return {
        "max_speed": behaviour.max_speed,
        "on_obstacle": behaviour.on_obstacle,
        "keep_out": behaviour.keep_out,
    }


def json_behaviour(found: Json) -> AreaBehaviour:
    """The other way round; raises `StoreError`."""
    speed = found.get("max_speed")
    limit = None if speed is None else finite(speed, "max_speed")
    keep_out = found.get("keep_out", False)
    if not isinstance(keep_out, bool):
        msg = f"keep_out is true or false, not {keep_out!r:.60}"
        raise StoreError(msg)
    try:
        return AreaBehaviour(max_speed=limit, on_obstacle=text(found, "on_obstacle"), keep_out=keep_out)
    except ValueError as err:
        raise StoreError(str(err)) from None


def link_json(link: MapLink) -> Json:
    """``{"from", "to", "cost"}``: the names of two locations."""
    return {"from": link.first, "to": link.second, "cost": link.cost}


def json_link(found: Json) -> MapLink:
    """The other way round; raises `StoreError`."""
    try:
        return MapLink(text(found, "from"), text(found, "to"), number(found, "cost"))
    except ValueError as err:
        raise StoreError(str(err)) from None


def current_json(name: str) -> Json:
    """``{"map"}``."""
    return {"map": name}


def json_current(found: Json) -> str:
    """The other way round; raises `StoreError`."""
    return text(found, "map")


def number(found: Json, key: str, default: float = 0.0) -> float:
    """A finite number; raises `StoreError`."""
    return finite(found.get(key, default), key)


def finite(value: Any, what: str) -> float:
    """A finite number; raises `StoreError`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        msg = f"{what} is no number: {value!r:.60}"
        raise StoreError(msg)
    try:
        found = float(value)
    except OverflowError:
        found = math.inf
    if not math.isfinite(found):
        msg = f"{what} is no finite number"
        raise StoreError(msg)
    return found


def text(found: Json, key: str) -> str:
    """A text; raises `StoreError`."""
    value = found.get(key, "")
    if not isinstance(value, str):
        msg = f"{key} is no text: {value!r:.60}"
        raise StoreError(msg)
    return value


def several(found: Json, key: str) -> Sequence[Any]:
    """A list of bounded length; raises `StoreError`."""
    value = found.get(key, [])
    if not isinstance(value, list) or len(value) > _MOST_POINTS:
        msg = f"{key} is no list of up to {_MOST_POINTS}"
        raise StoreError(msg)
    return value


def json_codec(
    write: Callable[[T], Json], read: Callable[[Json], T]
) -> tuple[Callable[[str, T], bytes], Callable[[str, bytes], T]]:
    """The codec of a kind whose bodies are JSON and do not hold their own name."""
    return lambda _name, value: write_json(write(value)), lambda _name, body: read(read_json(body))


def _point(value: Any) -> Vec2D:
    if not isinstance(value, list) or len(value) != 2:
        msg = f"a point is [x, y], not {value!r:.60}"
        raise StoreError(msg)
    return Vec2D(finite(value[0], "x"), finite(value[1], "y"))


def _object(value: Any) -> Json:
    if not isinstance(value, dict):
        msg = f"a waypoint is a JSON object, not {value!r:.60}"
        raise StoreError(msg)
    return value
