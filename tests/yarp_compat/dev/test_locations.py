"""Locations, objects, areas and paths."""

from __future__ import annotations

import math

import pytest

from yarp_compat.dev.extras import AreaBehavior, MapLink
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DLocationVector, Map2DObject, Map2DPath
from yarp_compat.sig.vec2d import Vec2D


def area(*corners: tuple[float, float]) -> Map2DArea:
    return Map2DArea("m", [Vec2D(x, y) for x, y in corners], "d")


L_SHAPE = area((-5, -5), (-1, -5), (-1, -4), (-4, -4), (-4, -1), (-5, -1))


def test_nearness_compares_map_distance_and_angle() -> None:
    first = Map2DLocation("m", 1, 2, 170)
    second = Map2DLocation("m", 1.3, 2.4, -170)
    assert first.is_near_to(second, 0.5)
    assert not first.is_near_to(second, 0.49)
    assert first.is_near_to(second, 1, 20)
    assert not first.is_near_to(second, 1, 19)
    assert not first.is_near_to(Map2DLocation("n", 1, 2), 1)
    assert not first.is_near_to(first, -1)
    thing = Map2DObject("m", 1, 2, 3)
    assert thing.is_near_to(first, 0)
    assert not thing.is_near_to(Map2DObject("m", 1, 2, 4), 0.9)
    assert thing.is_near_to(Map2DObject("m", 1, 2, 4), 1)


def test_an_area_contains_points_and_has_bounds() -> None:
    assert L_SHAPE.isValid()
    assert L_SHAPE.checkLocationInsideArea(Map2DLocation("m", -4.5, -2))
    assert not L_SHAPE.checkLocationInsideArea(Map2DLocation("m", -2, -2))
    assert not L_SHAPE.checkLocationInsideArea(Map2DLocation("n", -4.5, -2))
    assert L_SHAPE.checkObjectInsideArea(Map2DObject("m", -2, -4.5))
    assert L_SHAPE.findAreaBounds() == (Map2DLocation("m", -5, -5), Map2DLocation("m", -1, -1))
    assert L_SHAPE.getCentroid() == Map2DLocation("m", -3, -3)
    for _ in range(100):
        spot = L_SHAPE.getRandomLocation()
        assert spot
        assert L_SHAPE.checkLocationInsideArea(spot)
    flat = area((0, 0), (1, 0), (2, 0))
    assert flat.getRandomLocation() is None
    nothing = Map2DArea("m", [Vec2D(1, 1), Vec2D(2, 2)])
    assert (nothing.isValid(), nothing.findAreaBounds(), nothing.getCentroid(), nothing.getRandomLocation()) == (
        False, None, None, None,
    )  # fmt: skip
    assert (L_SHAPE[1], len(L_SHAPE), bool(Map2DArea())) == (Vec2D(-1, -5), 6, True)
    nothing.clear()
    assert nothing == Map2DArea()


def test_a_path_has_a_length_and_maps() -> None:
    path = Map2DPath([Map2DLocation("m", 1, 1), Map2DLocation("m", 4, 5)], "d")
    assert (path.size(), path.getLength(), path.isOnSingleMap()) == (2, 5.0, True)
    path.push_back(Map2DLocation("n", 100, 100))
    assert (len(path), path.getLength(), path.isOnSingleMap()) == (3, 5.0, False)
    assert [place.map_id for place in path] == ["m", "m", "n"]
    path.clear()
    assert path == Map2DPath()
    assert path.isOnSingleMap()


def test_texts_are_those_of_a_real_yarp() -> None:
    """Recorded in `tests/yarp_compat/data/portables.txt`."""
    first = Map2DLocation("map1", 1, 2, 90, "desc")
    assert first.toString() == "map_id:map1 x:1 y:2 theta:90desc:desc"
    corners = [Vec2D(0, 0), Vec2D(1, 0), Vec2D(1, 1)]
    assert Map2DArea("map1", corners, "adesc").toString() == (
        "map_id:map1  point 0(0,0) point 1(1,0) point 2(1,1)desc:adesc"
    )
    path = Map2DPath([first, Map2DLocation("map1", 3, 4, 0)], "pd")
    assert path.toString() == " waypoint 0(map1 1,2,90) waypoint 1(map1 3,4,0) desc: pd"
    assert Map2DObject("m", 1, 2.5, 3, 4, 5, 6, "d").toString() == (
        "map_id:m x:1 y:2.5 z:3 roll:4 pitch:5 yaw:6 desc:d"
    )


@pytest.mark.parametrize(
    ("text", "rules"),
    [
        ("", None),
        ("the room with the max_speed sign", None),
        ("max_speed=0.2 on_obstacle=wait", AreaBehavior(0.2, "wait")),
        ("loading zone, max_speed = 1.5; on_obstacle = around, beware", AreaBehavior(1.5, "around")),
        ("keep_out", AreaBehavior(keep_out=True)),
        ("lab keep_out=true max_speed=1e-1", AreaBehavior(0.1, keep_out=True)),
        ("keep_out=no", AreaBehavior()),
    ],
)
def test_the_rules_of_an_area_are_parsed_from_its_description(text: str, rules: AreaBehavior | None) -> None:
    assert AreaBehavior.from_text(text) == rules
    if rules is not None and rules != AreaBehavior():
        assert AreaBehavior.from_text(rules.to_text()) == rules


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("max_speed=0", "keep_out keeps robots away"),
        ("max_speed=-1", "above 0"),
        ("max_speed=nan", "above 0"),
        ("max_speed=fast", "meters per second, not 'fast'"),
        ("on_obstacle=stop", "wait or around"),
        ("keep_out=maybe", "true or false"),
        ("max_speed=1 max_speed=2", "twice"),
    ],
)
def test_invalid_rules_of_an_area_are_rejected(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        AreaBehavior.from_text(text)


def test_invalid_links_are_rejected() -> None:
    assert MapLink("a", "b", 3) == MapLink("a", "b", 3.0)
    for wrong in (("a", "a", 0), ("", "b", 0), ("a", "b", -1), ("a", "b", math.inf)):
        with pytest.raises(ValueError, match="link"):
            MapLink(*wrong)


def test_places_have_the_methods_of_the_bindings() -> None:
    a, b = Map2DLocation("m1", 1.0, 2.0, 3.0), Map2DLocation("m1", 1.0, 2.0, 4.0)
    for place, other in ((a, b), (Map2DPath([a]), Map2DPath([b])), (Map2DArea("m1"), Map2DArea("m2"))):
        assert place.isEqual(place)
        assert place.notEqual(other)
        assert not place.isEqual(other)
        assert place.toString_c() == place.toString()
    places = Map2DLocationVector(2)
    places[0].x = 1.0
    assert places == [Map2DLocation(x=1.0), Map2DLocation()], "the elements are distinct objects"
    places.push_back(a)
    assert places.size() == 3
