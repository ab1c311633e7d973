"""Files of places: all versions of YARP's format, Midspan's extras, and exports."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from yarp_compat.dev.exports import to_geojson, to_waypoints
from yarp_compat.dev.extras import AreaBehavior, Extras, MapLink, extras_file
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.dev.mapfile import MapFileError
from yarp_compat.dev.places import Places
from yarp_compat.sig.vec2d import Vec2D

TRIANGLE = [Vec2D(0, 0), Vec2D(1, 0), Vec2D(1, 1)]
V1 = "Version:\n1\nLocations:\nkitchen m1 1 2 90\nAreas:\nhall m1 3 0 0 1 0 1 1\n"
V2 = V1.replace("\n1\n", "\n2\n", 1) + "Paths:\ntour ( m1 1 2 90) ( m1 3 4.5 0)\n"
V3 = (
    'Version:\n3\nLocations:\nkitchen m1 1 2 90 "it is warm"\nAreas:\nhall m1 3 0 0 1 0 1 1 big\n'
    'Paths:\ntour ( m1 1 2 90) ( m1 3 4.5 0) "the tour"\n'
)
V4 = V3.replace("\n3\n", "\n4\n", 1).replace("Areas:", 'Objects:\ncup m1 1 2 3 4 5 6 "of tea"\nAreas:')
TOUR = [Map2DLocation("m1", 1, 2, 90), Map2DLocation("m1", 3, 4.5, 0)]


def test_every_version_of_the_file_of_yarp_is_read() -> None:
    first = Places({"kitchen": Map2DLocation("m1", 1, 2, 90)}, {}, {"hall": Map2DArea("m1", TRIANGLE)})
    assert Places.from_text(V1) == first
    first.paths["tour"] = Map2DPath(TOUR)
    assert Places.from_text(V2) == first
    last = Places(
        {"kitchen": Map2DLocation("m1", 1, 2, 90, "it is warm")},
        {},
        {"hall": Map2DArea("m1", TRIANGLE, "big")},
        {"tour": Map2DPath(TOUR, "the tour")},
    )
    assert Places.from_text(V3) == last
    last.objects["cup"] = Map2DObject("m1", 1, 2, 3, 4, 5, 6, "of tea")
    assert Places.from_text(V4) == last
    assert Places.from_text(V4.replace("\n", "\r\n")) == last
    assert last.to_text() == (
        'Version:\n4\nLocations:\nkitchen m1 1.0 2.0 90.0 "it is warm"\nObjects:\n'
        'cup m1 1.0 2.0 3.0 4.0 5.0 6.0 "of tea"\nAreas:\nhall m1 3 0.0 0.0 1.0 0.0 1.0 1.0 "big"\n'
        'Paths:\ntour (m1 1.0 2.0 90.0) (m1 3.0 4.5 0.0) "the tour"\n'
    )


NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
WORDS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=8)
LOCATIONS = st.builds(Map2DLocation, WORDS, NUMBERS, NUMBERS, NUMBERS, WORDS)
PLAIN = st.builds(Map2DLocation, WORDS, NUMBERS, NUMBERS, NUMBERS)
OBJECTS = st.builds(Map2DObject, WORDS, *[NUMBERS] * 6, WORDS)
AREAS = st.builds(Map2DArea, WORDS, st.lists(st.builds(Vec2D, NUMBERS, NUMBERS), max_size=3), WORDS)
PATHS = st.builds(Map2DPath, st.lists(PLAIN, max_size=3), WORDS)


def named(values: Any) -> Any:
    return st.dictionaries(WORDS, values, max_size=2)


@given(places=st.builds(Places, named(LOCATIONS), named(OBJECTS), named(AREAS), named(PATHS)))
@settings(max_examples=60)
def test_any_places_survive_a_round_trip(places: Places) -> None:
    assert Places.from_text(places.to_text()) == places


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "Version:"),
        ("Version:\n5\n", "'1', '2', '3' or '4'"),
        ("Version:\n4\nk m 1 2 3 d\n", "line 3: the line precedes all sections"),
        ("Version:\n4\nLocations:\nk m 1 2 3\n", "line 4: expected 6 values, not 5"),
        ("Version:\n4\nLocations:\nk m 1 x 3 d\n", "'x' is not a number"),
        ("Version:\n4\nLocations:\n(k) m 1 2 3 d\n", "is not a text"),
        ("Version:\n4\nLocations:\nk m 1 2 3 d\nk m 1 2 3 d\n", "line 5: 'k' is defined twice"),
        ("Version:\n4\nObjects:\nk m 1 2 3 d\n", "9 values"),
        ("Version:\n4\nAreas:\nk m 1000000000 3 d\n", "values, not 5"),
        ("Version:\n4\nAreas:\nk m inf 3 d\n", "not a number of corners"),
        ("Version:\n4\nAreas:\nk\n", "line 4"),
        ("Version:\n4\nPaths:\nk (m 1 2) d\n", "expected 4 values, not 3"),
        ("Version:\n4\nPaths:\nk (m 1 2 3) d e\n", "expected 3 values, not 4"),
    ],
)
def test_invalid_lines_are_rejected(text: str, reason: str) -> None:
    with pytest.raises(MapFileError, match=reason):
        Places.from_text(text)


def test_files_are_saved_and_loaded(tmp_path: Path) -> None:
    path = tmp_path / "locations.ini"
    places = Places.from_text(V4)
    places.save(path)
    assert Places.load(path, jail=tmp_path) == places
    with pytest.raises(MapFileError, match="outside"):
        Places.load(path, jail=tmp_path / "other")
    path.write_bytes(b"x" * (1 << 22) + b"y")
    with pytest.raises(MapFileError, match="longer"):
        Places.load(path)
    extras = Extras({"hall": AreaBehavior(0.3, "wait"), "a b": AreaBehavior(keep_out=True)}, {"lift": LIFT})
    path_of_extras = extras_file(path)
    assert path_of_extras == tmp_path / "locations_extras.ini"
    extras.save(path_of_extras)
    assert path_of_extras.read_text() == (
        'Version:\n1\nBehaviours:\n"a b" keep_out\nhall max_speed=0.3 on_obstacle=wait\nLinks:\nlift up down 12.5\n'
    )
    assert Extras.load(path_of_extras, jail=tmp_path) == extras


LIFT = MapLink("up", "down", 12.5)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("Version:\n2\n", "'Version:' and '1'"),
        ("Version:\n1\nx\n", "precedes the sections"),
        ("Version:\n1\nBehaviours:\na max_speed=0\n", "line 4: max_speed"),
        ("Version:\n1\nBehaviours:\na keep_out\na keep_out\n", "defined twice"),
        ("Version:\n1\nLinks:\nlift a b\n", "line 4"),
        ("Version:\n1\nLinks:\n(lift a b\n", "line 4"),
        ("Version:\n1\nLinks:\nlift a a 1\n", "two locations"),
        ("Version:\n1\nLinks:\nlift a b x\n", "line 4"),
    ],
)
def test_invalid_extras_are_rejected(text: str, reason: str) -> None:
    with pytest.raises(MapFileError, match=reason):
        Extras.from_text(text)


def test_places_are_exported_as_geojson() -> None:
    places = Places.from_text(V4)
    places.areas["back"] = Map2DArea("m2", TRIANGLE[::-1])
    places.locations |= {"up": Map2DLocation("m1"), "down": Map2DLocation("m2")}
    collection = json.loads(to_geojson(places, {"hall": AreaBehavior(0.3, keep_out=True)}, {"lift": LIFT}))
    assert collection["type"] == "FeatureCollection"
    by_id = {feature["id"]: feature for feature in collection["features"]}
    assert by_id["location/kitchen"]["geometry"] == {"type": "Point", "coordinates": [1.0, 2.0]}
    assert by_id["location/up"]["properties"] == {"kind": "location", "name": "up", "map": "m1", "theta": 0.0}
    assert by_id["object/cup"]["geometry"]["coordinates"] == [1.0, 2.0, 3.0]
    ring = [[[0, 0], [1, 0], [1, 1], [0, 0]]]
    assert by_id["area/hall"]["geometry"] == {"type": "Polygon", "coordinates": ring}
    hall = {"kind": "area", "name": "hall", "map": "m1", "description": "big", "max_speed": 0.3, "keep_out": True}
    assert by_id["area/hall"]["properties"] == hall
    # counterclockwise for any order of the corners
    assert by_id["area/back"]["geometry"]["coordinates"] == ring
    assert by_id["path/tour"]["geometry"] == {"type": "LineString", "coordinates": [[1, 2], [3, 4.5]]}
    assert by_id["link/lift"]["properties"]["maps"] == ["m1", "m2"]
    features = json.loads(to_geojson(places, map_name="m2"))["features"]
    assert [feature["id"] for feature in features] == ["location/down", "area/back"]


def test_places_are_exported_as_waypoints_of_nav2() -> None:
    content = yaml.safe_load(to_waypoints({"kitchen": Map2DLocation("m", 1, 1e-9, 90), 'b "x"': Map2DLocation("m")}))
    half = math.sqrt(0.5)
    assert list(content["waypoints"]) == ["kitchen", 'b "x"']
    assert content["waypoints"]["kitchen"]["pose"] == [1.0, 1e-9, 0.0]
    assert content["waypoints"]["kitchen"]["orientation"] == pytest.approx([half, 0, 0, half])
    assert yaml.safe_load(to_waypoints({})) == {"waypoints": {}}
