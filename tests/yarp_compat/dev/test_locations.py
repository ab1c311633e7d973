"""Locations, objects, areas and paths."""

from __future__ import annotations

import math

import pytest

from yarp_compat.dev.extras import AreaBehaviour, MapLink
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DLocationVector, Map2DObject, Map2DPath
from yarp_compat.sig.vec2d import Vec2D


def area(*corners: tuple[float, float]) -> Map2DArea:
    return Map2DArea("m", [Vec2D(x, y) for x, y in corners], "d")


L_SHAPE = area((-5, -5), (-1, -5), (-1, -4), (-4, -4), (-4, -1), (-5, -1))


def test_nearness() -> None:
    here = Map2DLocation("m", 1, 2, 170)
    there = Map2DLocation("m", 1.3, 2.4, -170)
    assert here.is_near_to(there, 0.5)
    assert not here.is_near_to(there, 0.49)
    assert here.is_near_to(there, 1, 20)
    assert not here.is_near_to(there, 1, 19)
    assert not here.is_near_to(Map2DLocation("n", 1, 2), 1)
    assert not here.is_near_to(here, -1)
    thing = Map2DObject("m", 1, 2, 3)
    assert thing.is_near_to(here, 0)
    assert not thing.is_near_to(Map2DObject("m", 1, 2, 4), 0.9)
    assert thing.is_near_to(Map2DObject("m", 1, 2, 4), 1)


def test_what_is_in_an_area() -> None:
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


def test_paths() -> None:
    path = Map2DPath([Map2DLocation("m", 1, 1), Map2DLocation("m", 4, 5)], "d")
    assert (path.size(), path.getLength(), path.isOnSingleMap()) == (2, 5.0, True)
    path.push_back(Map2DLocation("n", 100, 100))
    assert (len(path), path.getLength(), path.isOnSingleMap()) == (3, 5.0, False)
    assert [place.map_id for place in path] == ["m", "m", "n"]
    path.clear()
    assert path == Map2DPath()
    assert path.isOnSingleMap()


def test_texts_are_those_of_a_real_yarp() -> None:
    """As `tests/yarp_compat/data/portables.txt` has them."""
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
    ("text", "said"),
    [
        ("", None),
        ("the room with the max_speed sign", None),
        ("max_speed=0.2 on_obstacle=wait", AreaBehaviour(0.2, "wait")),
        ("loading zone, max_speed = 1.5; on_obstacle = around, beware", AreaBehaviour(1.5, "around")),
        ("keep_out", AreaBehaviour(keep_out=True)),
        ("lab keep_out=true max_speed=1e-1", AreaBehaviour(0.1, keep_out=True)),
        ("keep_out=no", AreaBehaviour()),
    ],
)
def test_behaviour_stands_in_a_description(text: str, said: AreaBehaviour | None) -> None:
    assert AreaBehaviour.from_text(text) == said
    if said is not None and said != AreaBehaviour():
        assert AreaBehaviour.from_text(said.to_text()) == said


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("max_speed=0", "keep_out to keep robots away"),
        ("max_speed=-1", "above 0"),
        ("max_speed=nan", "above 0"),
        ("max_speed=fast", "metres per second, not 'fast'"),
        ("on_obstacle=stop", "wait or around"),
        ("keep_out=maybe", "true or false"),
        ("max_speed=1 max_speed=2", "twice"),
    ],
)
def test_behaviour_that_cannot_be_meant(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        AreaBehaviour.from_text(text)


def test_links() -> None:
    assert MapLink("a", "b", 3) == MapLink("a", "b", 3.0)
    for wrong in (("a", "a", 0), ("", "b", 0), ("a", "b", -1), ("a", "b", math.inf)):
        with pytest.raises(ValueError, match="link"):
            MapLink(*wrong)


def test_places_have_the_methods_of_the_bindings() -> None:
    here, there = Map2DLocation("m1", 1.0, 2.0, 3.0), Map2DLocation("m1", 1.0, 2.0, 4.0)
    for one, other in ((here, there), (Map2DPath([here]), Map2DPath([there])), (Map2DArea("m1"), Map2DArea("m2"))):
        assert one.isEqual(one)
        assert one.notEqual(other)
        assert not one.isEqual(other)
        assert one.toString_c() == one.toString()
    places = Map2DLocationVector(2)
    places[0].x = 1.0
    assert places == [Map2DLocation(x=1.0), Map2DLocation()], "each its own"
    places.push_back(here)
    assert places.size() == 3
