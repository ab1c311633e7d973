"""Markers of places: each is encoded once, and joined to the same array as if all were encoded together."""

from __future__ import annotations

import random

import pytest

from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader, MessageWriter
from navigation.map2d_server.markers import (
    MARKER_TYPE,
    MARKERS_TYPE,
    MarkerEncoder,
    area_markers,
    joined,
    location_markers,
    object_markers,
    path_markers,
)
from navigation.messages import Message
from yarp_compat.dev.locations import Map2DArea, Map2DLocation, Map2DObject, Map2DPath
from yarp_compat.sig.vec2d import Vec2D

CORNERS = [Vec2D(0.1, 0.1), Vec2D(2.9, 0.1), Vec2D(2.9, 2.9)]
WAY = Map2DPath([Map2DLocation("hall", 1, 1), Map2DLocation("hall", 2, 2), Map2DLocation("other map", 3, 3)])


def markers_of_all_kinds(names: list[str]) -> list[Message]:
    return [
        marker
        for name in names
        for marker in (
            *location_markers(name, Map2DLocation("hall", 1, 2, 90)),
            *object_markers(name, Map2DObject("hall", 1, 2, 3)),
            *area_markers(name, Map2DArea("hall", CORNERS)),
            *path_markers(name, WAY, "hall"),
        )
    ]


@pytest.mark.parametrize("frame", ["map", "floor1", ""])
def test_encoded_markers_are_joined_to_the_array_of_all(frame: str) -> None:
    registry = Registry()
    names = ["", "a", "ab", "abc", "abcd", "Küche", "location", "name a"]
    markers = [{"action": 3}, *markers_of_all_kinds(names)]
    random.shuffle(markers)
    encoder = MarkerEncoder(registry.schema(MARKER_TYPE), frame)
    cdr = joined([encoder.encode(marker) for marker in markers])
    whole = [{"header": {"frame_id": frame}, **marker} for marker in markers]
    assert cdr == MessageWriter(registry.schema(MARKERS_TYPE)).message({"markers": whole})
    shown = MessageReader(registry.schema(MARKERS_TYPE), cdr).message()["markers"]
    assert [marker["ns"] for marker in shown] == [marker.get("ns", "") for marker in markers]


def test_no_two_markers_replace_each_other() -> None:
    markers = markers_of_all_kinds(["a", "name a", "name name a"])
    assert len({(marker["ns"], marker.get("id", 0)) for marker in markers}) == len(markers)


def test_a_path_is_shown_as_far_as_it_is_on_the_map() -> None:
    line, text = path_markers("way", WAY, "hall")
    assert [(point["x"], point["y"]) for point in line["points"]] == [(1, 1), (2, 2)]
    assert text["text"] == "way"
    assert path_markers("way", WAY, "other map") == []
