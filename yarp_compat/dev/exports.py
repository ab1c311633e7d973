"""Export of places for other programs: GeoJSON (RFC 7946), and waypoints for Nav2.

GeoJSON is meant for longitudes and latitudes; here, as in Nav2's route graphs, its numbers are meters in the frame of
the map that each feature names.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

from yarp_compat.dev.extras import AreaBehavior, MapLink
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapfile import decimal
from yarp_compat.dev.places import Places


def to_geojson(
    places: Places,
    behaviors: Mapping[str, AreaBehavior] | None = None,
    links: Mapping[str, MapLink] | None = None,
    map_name: str = "",
) -> str:
    """Return places as GeoJSON: points, polygons and lines in meters and degrees.

    Behaviors become properties of their areas, links become features without a geometry; ``map_name`` selects one map.
    """
    features = [
        feature
        for feature in (*_points(places), *_areas(places, behaviors or {}), *_lines(places, links or {}))
        if map_name in ("", feature["properties"]["map"])
    ]
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1, ensure_ascii=False) + "\n"


def to_waypoints(locations: Mapping[str, Map2DLocation]) -> str:
    """Return the waypoint file of Nav2's panel in rviz, for its "Waypoint mode".

    ``waypoints: {NAME: {pose: [x, y, z], orientation: [w, x, y, z]}}``, in the order of ``locations``; the file does
    not name the map.
    """
    lines = ["waypoints:" if locations else "waypoints: {}"]
    for name, place in locations.items():
        half = math.radians(place.theta) / 2
        rotation = ", ".join(map(decimal, (math.cos(half), 0.0, 0.0, math.sin(half))))
        lines += [
            f"  {json.dumps(name, ensure_ascii=False)}:",
            f"    pose: [{decimal(place.x)}, {decimal(place.y)}, 0.0]",
            f"    orientation: [{rotation}]",
        ]
    return "\n".join(lines) + "\n"


def _feature(kind: str, name: str, map_name: str, shape: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    given = {key: value for key, value in properties.items() if value is not False and value not in ("", None)}
    return {
        "type": "Feature",
        "id": f"{kind}/{name}",
        "geometry": {"type": shape, "coordinates": coordinates},
        "properties": {"kind": kind, "name": name, "map": map_name, **given},
    }


def _points(places: Places) -> Iterable[dict[str, Any]]:
    for name, place in sorted(places.locations.items()):
        yield _feature(
            "location", name, place.map_id, "Point", [place.x, place.y],
            theta=place.theta, description=place.description,
        )  # fmt: skip
    for name, thing in sorted(places.objects.items()):
        yield _feature(
            "object", name, thing.map_id, "Point", [thing.x, thing.y, thing.z],
            roll=thing.roll, pitch=thing.pitch, yaw=thing.yaw, description=thing.description,
        )  # fmt: skip


def _areas(places: Places, behaviors: Mapping[str, AreaBehavior]) -> Iterable[dict[str, Any]]:
    for name, area in sorted(places.areas.items()):
        corners = [[point.x, point.y] for point in area.points]
        area2 = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, [*corners[1:], *corners[:1]], strict=True))
        ring = corners if area2 >= 0 else corners[::-1]  # RFC 7946: an outer ring goes counterclockwise
        rules = behaviors.get(name, AreaBehavior())
        yield _feature(
            "area", name, area.map_id, "Polygon", [[*ring, *ring[:1]]] if ring else [],
            description=area.description, max_speed=rules.max_speed, on_obstacle=rules.on_obstacle,
            keep_out=rules.keep_out,
        )  # fmt: skip


def _lines(places: Places, links: Mapping[str, MapLink]) -> Iterable[dict[str, Any]]:
    for name, path in sorted(places.paths.items()):
        maps = list(dict.fromkeys(waypoint.map_id for waypoint in path))
        poses = [[waypoint.x, waypoint.y] for waypoint in path]
        yield _feature(
            "path", name, maps[0] if len(maps) == 1 else "", "LineString", poses,
            theta=[waypoint.theta for waypoint in path], maps=maps, description=path.description,
        )  # fmt: skip
    for name, link in sorted(links.items()):
        ends = [places.locations.get(end) for end in (link.first, link.second)]
        yield {
            "type": "Feature",
            "id": f"link/{name}",
            "geometry": None,  # its ends are on two maps
            "properties": {
                "kind": "link", "name": name, "map": "", "first": link.first, "second": link.second,
                "maps": [end.map_id for end in ends if end is not None], "cost": link.cost,
            },
        }  # fmt: skip
