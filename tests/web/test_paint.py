"""Flags painted by pages, on a real hub."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from bridge.stores.kinds import LOCATION, MAP
from bridge.stores.store import Store, Write
from bridge.web.feeds.map_pictures import CLEAR, TILE, Pictures, flags_picture, occupancy_picture
from bridge.web.verbs.paint import MOST_CELLS, MOST_PIECES, MOST_RUNS, Run, paint, runs_of
from bridge.web.verbs.verbs import VerbError
from tests.peers.browser.page import TestPage
from tests.web.conftest import Desk
from yarp_compat.dev.locations import Map2DLocation
from yarp_compat.dev.mapgrid import UNKNOWN, MapFlag, MapGrid2D

FREE, KEEP_OUT, TEMPORARY, WALL = MapFlag.FREE, MapFlag.KEEP_OUT, MapFlag.TEMPORARY_OBSTACLE, MapFlag.WALL


def house(width: int = 6, height: int = 4) -> MapGrid2D:
    """Return a free map with a wall in the last column."""
    flags = np.zeros((height, width), np.uint8)
    flags[:, -1] = WALL
    return MapGrid2D.of(flags, name="house", resolution=0.1)


def runs_from(*runs: list[Any]) -> list[Run]:
    return runs_of(list(runs))


def test_painting_returns_the_undo() -> None:
    grid = house()
    before = grid.flags.copy()
    undo = paint(grid, runs_from([1, 0, 6, KEEP_OUT], [1, 2, 2, TEMPORARY]))
    assert grid.flags[1].tolist() == [1, 1, 2, 2, 1, 1]
    assert (grid.flags[[0, 2, 3]] == before[[0, 2, 3]]).all()
    redo = paint(grid, undo)
    assert (grid.flags == before).all()
    paint(grid, redo)
    assert grid.flags[1].tolist() == [1, 1, 2, 2, 1, 1]


def test_an_undo_preserves_later_changes_of_others() -> None:
    grid = house()
    undo = paint(grid, runs_from([1, 0, 4, KEEP_OUT]))
    paint(grid, runs_from([1, 1, 1, WALL]))
    redo = paint(grid, undo)
    assert grid.flags[1].tolist() == [0, WALL, 0, 0, 0, WALL]
    assert sum(run.length for run in redo) == 3


def test_erased_cells_get_their_flag_from_the_occupancy() -> None:
    grid = house()
    grid.occupancy[1, 3] = UNKNOWN
    paint(grid, runs_from([1, 0, 6, KEEP_OUT]))
    paint(grid, runs_from([1, 0, 6, None]))
    assert grid.flags[1].tolist() == [0, 0, 0, MapFlag.UNKNOWN, 0, WALL]


@pytest.mark.parametrize("run", [[4, 0, 1, 1], [0, 5, 2, 1], [0, 6, 1, 1]])
def test_runs_outside_the_map_are_refused(run: list[int]) -> None:
    with pytest.raises(VerbError, match="the map has 6 x 4"):
        paint(house(), runs_from(run))


def test_the_size_of_an_undo_is_limited() -> None:
    wide = 2 * MOST_PIECES
    grid = MapGrid2D.of(np.arange(wide, dtype=np.uint8).reshape(1, wide) % 2, name="house")
    with pytest.raises(VerbError, match="paint less at once"):
        paint(grid, runs_from([0, 0, wide, KEEP_OUT + 1]))


@pytest.mark.parametrize(
    "runs",
    ["", [], [[1, 2, 3]], [[1, 2, 3, 4, 5, 6]], [[0, 0, 1, 6]], [[0, 0, 1, -1]], [[0, 0, 1.5, 1]], [[0, True, 1, 1]],
     [[-1, 0, 1, 1]], [[0, 0, 1 << 40, 1]], [[0, 0, 1, 1]] * (MOST_RUNS + 1), [[0, 0, MOST_CELLS + 1, 1]], [None]],
)  # fmt: skip
def test_invalid_runs_are_refused(runs: Any) -> None:
    with pytest.raises(ValueError, match=r"^must (be|have)"):
        runs_of(runs)


def test_image_addresses_depend_on_the_content() -> None:
    grid, pictures = house(), Pictures()
    assert flags_picture(grid) is None
    walls = pictures.put("occupancy", occupancy_picture(grid))
    grid.flags[1, 1] = KEEP_OUT
    assert pictures.put("occupancy", occupancy_picture(grid)) == walls, "keep-out cells are only in the image of flags"
    tints = flags_picture(grid)
    assert tints is not None
    assert np.argwhere(tints).tolist() == [[1, 1]]
    grid.flags[1, 2], grid.flags[1, 5] = WALL, MapFlag.UNKNOWN
    grid.occupancy[2, 2], grid.flags[2, 2] = UNKNOWN, FREE
    cells = occupancy_picture(grid)
    assert (cells[1, 2], cells[1, 5]) == (100, 101), "the cells are a wall and an unknown cell"
    assert cells[2, 2] == 101, "planners do not know this cell either"


@pytest.mark.parametrize("dark", [False, True])
def test_images_have_the_colors_of_the_theme(*, dark: bool) -> None:
    grid, pictures = house(), Pictures()
    grid.flags[1, 2], grid.flags[1, 5] = WALL, MapFlag.UNKNOWN
    ((address,),) = pictures.put("occupancy", occupancy_picture(grid))["tiles"]
    png = pictures.get("occupancy", address.partition("=")[2], dark=dark)
    assert png is not None
    picture = np.asarray(Image.open(io.BytesIO(png)).convert("RGBA"))
    assert picture[1, 2].tolist() == ([160, 176, 190, 255] if dark else [0, 0, 0, 255]), (
        "a wall is gray in the dark theme and black in the light one"
    )
    assert picture[1, 0].tolist() == ([20, 25, 30, 255] if dark else [255, 255, 255, 255]), (
        "a free cell is dark in the dark theme and white in the light one"
    )
    assert picture[1, 5, 3] == 0, "an unknown cell is transparent"


def test_a_change_replaces_one_tile() -> None:
    cells, pictures = np.zeros((1500, 2100), np.uint8), Pictures()
    cells[:, :1024] = CLEAR["occupancy"]
    before = pictures.put("occupancy", cells)
    assert before["size"] == TILE
    assert [row[0] for row in before["tiles"]] == [None, None], "the tiles are transparent"
    cells[1100, 2050] = 100
    after = pictures.put("occupancy", cells)
    changed = [
        (y, x)
        for y, row in enumerate(after["tiles"])
        for x, address in enumerate(row)
        if address != before["tiles"][y][x]
    ]
    assert changed == [(1, 2)]
    png = pictures.get("occupancy", after["tiles"][1][2].partition("=")[2])
    assert png is not None
    assert Image.open(io.BytesIO(png)).size == (2100 - 2048, 1500 - 1024)
    old = before["tiles"][1][2].partition("=")[2]
    assert pictures.get("occupancy", old) is not None, "a page may still be fetching the old picture"
    pictures.put("occupancy", cells)
    assert pictures.get("occupancy", old) is None


@pytest.fixture
def store(store: Store) -> Store:
    """Return a store with a current map."""
    store.put(MAP, "house", house())
    store.use_map("house")
    return store


def flags(store: Store) -> list[list[int]]:
    grid = store.get(MAP, "house")
    assert grid is not None
    rows: list[list[int]] = grid.flags.tolist()
    return rows


def test_all_pages_see_painted_flags(desk: Desk, store: Store) -> None:
    whole = {"map": "house", "size": [6, 4]}
    with TestPage(desk.port) as painter, TestPage(desk.port) as other:
        other.watch("map")
        assert other.value("map")["flags"] is None
        first = painter.call("paint_flags", runs=[[1, 0, 3, KEEP_OUT]], **whole)["value"]
        assert first == {"changed": 3, "undo": [[1, 0, 3, FREE, KEEP_OUT]]}
        other.value("map", lambda value: value["flags"])
        assert other.call("paint_flags", runs=[[1, 2, 3, TEMPORARY]], **whole)["ok"]
        assert flags(store)[1] == [1, 1, 2, 2, 2, WALL]
        painter.call("paint_flags", runs=first["undo"], **whole)
        assert flags(store)[1] == [0, 0, 2, 2, 2, WALL], "the other page's flags are preserved"
        image = other.values["map"]["value"]["image"]
        store.write([Write(LOCATION, "desk", Map2DLocation("house", 1.0))])
        painter.watch("places")
        painter.value("places", lambda value: value["locations"])
        assert other.values["map"]["value"]["image"] == image


@pytest.mark.parametrize(
    ("args", "why"),
    [
        ({"map": "none", "size": [6, 4]}, "no map 'none' in the store; existing maps: house"),
        ({"map": "house", "size": [6, 5]}, "the size of the map 'house' has changed: 6 x 4 cells"),
        ({"map": "house", "size": [6]}, "paint_flags: size must be [width, height] of the map"),
    ],
)
def test_invalid_paint_calls_are_reported(desk: Desk, store: Store, args: dict[str, Any], why: str) -> None:
    with TestPage(desk.port) as page:
        reply = page.call("paint_flags", runs=[[0, 0, 1, KEEP_OUT]], **args)
        assert why in reply["error"]
    assert flags(store) == house().flags.tolist()
