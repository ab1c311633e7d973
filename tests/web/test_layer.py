"""The console's feed of a layer: blocked cells on the map, and the obstacles' heights."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bridge.web.feeds.layers import MOST_TINTED, tint
from navigation.maps.grid_map import to_grid_map
from navigation.pose import Pose
from tests.peers.browser.page import TestPage
from tests.web.conftest import Desk

NAN = float("nan")
ORIGIN = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "orientation": {"w": 1.0}}
GRID = {
    "header": {"frame_id": "map"},
    "info": {"resolution": 0.5, "width": 4, "height": 2, "origin": ORIGIN},
    "data": [0, 100, 100, -1, 100, 0, 49, 50],
}
HERE = Pose(0.0, 0.0, 0.0)


def heights(frame: str = "map") -> dict[str, Any]:
    """Return the heights of the obstacles in the three columns on the left."""
    lowest = np.array([[NAN, 0.72, 1.104], [0.1, NAN, NAN]], np.float32)
    message = to_grid_map({"lowest": lowest}, (1.0, 2.0), 0.5, {"frame_id": frame})
    return {**message, "inner_start_index": 0, "outer_start_index": 0}


def plain(message: dict[str, Any]) -> dict[str, Any]:
    """Return the message in its JSON form."""
    return {**message, "data": [{**layer, "data": layer["data"].tolist()} for layer in message["data"]]}


def test_the_layer_is_shown_with_its_heights(desk: Desk) -> None:
    far = desk.far
    layer = far.advertise("/mapper3d/layer", "nav_msgs/OccupancyGrid", latched=True, depth=1)
    above = far.advertise("/mapper3d/layer_heights", "grid_map_msgs/GridMap", latched=True, depth=1)
    far.publish(layer, GRID)
    with TestPage(desk.port) as page:
        page.watch("layer")
        shown = page.value("layer")
        assert (shown["origin"], shown["size"]) == ({"x": 1.0, "y": 2.0, "theta": 0.0}, 0.5)
        assert shown["runs"] == [[0, 1, None, None], [1, 0, None], [1, 3, None]]
        far.publish(above, plain(heights()))
        wanted = [[0, 1, 0.72, 1.1], [1, 0, 0.1], [1, 3, None]]
        page.value("layer", lambda value: value["runs"] == wanted, "its heights are shown")
        far.publish(layer, {**GRID, "data": [0] * 8})
        page.value("layer", lambda value: value["runs"] == [], "there is no obstacle any longer")
        far.publish(layer, {**GRID, "header": {"frame_id": "attic"}})
        page.until(lambda: "attic" in page.values["layer"].get("why", ""), "the missing frame is reported")
    with TestPage(desk.port) as late:
        far.publish(layer, GRID)
        late.watch("layer")
        late.value("layer", lambda value: value and value["runs"] == wanted, "a late page gets both")


def test_an_unconfigured_layer_has_a_reason(desk: Desk) -> None:
    desk.open_with(web={"layer": ""})
    with TestPage(desk.port) as page:
        page.watch("layer")
        page.until(lambda: "web.layer" in page.values.get("layer", {}).get("why", ""), "the reason is reported")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"data": [0]}, "data: 1 cells instead of 4 x 2"),
        ({"info": {**GRID["info"], "resolution": 0.0}}, "info.resolution"),
    ],
)
def test_an_invalid_layer_is_reported_with_its_field(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        tint({**GRID, **changed}, None, HERE)


def test_invalid_heights_are_reported() -> None:
    with pytest.raises(ValueError, match="heights: layers: no 'lowest'; the message has x"):
        tint(GRID, {**heights(), "layers": ["x"]}, HERE)


def test_heights_in_another_frame_are_ignored() -> None:
    assert tint(GRID, heights("odom"), HERE)["runs"][0] == [0, 1, None, None]


def test_a_page_gets_a_bounded_number_of_cells() -> None:
    side = 301
    info = {**GRID["info"], "width": side, "height": side}
    lowest = np.full((side, side), 0.9, np.float32)
    lowest[2, 5] = 0.3
    above = {
        **to_grid_map({"lowest": lowest}, (1.0, 2.0), 0.5, {"frame_id": "map"}),
        **dict.fromkeys(("inner_start_index", "outer_start_index"), 0),
    }
    layer = tint({**GRID, "info": info, "data": np.full(side * side, 100, np.int8)}, above, HERE)
    assert layer["size"] == 2.0
    assert sum(len(run) - 2 for run in layer["runs"]) == 76 * 76 <= MOST_TINTED
    assert layer["runs"][0][:5] == [0, 0, 0.9, 0.3, 0.9]  # the lowest of sixteen heights
