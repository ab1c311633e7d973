"""GridMaps, whose cells are in the opposite order to those of an OccupancyGrid."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from navigation.maps.grid_map import to_grid_map, values_at

VALUES = np.arange(6, dtype=np.float32).reshape(2, 3)
"""Rows along y, columns along x: 5 is at the largest x and y."""
PLACES = np.array([(1.25 + 0.5 * column, 2.25 + 0.5 * row) for row in range(2) for column in range(3)])


def message(**changed: Any) -> dict[str, Any]:
    grid_map = to_grid_map({"one": -VALUES, "two": VALUES}, (1.0, 2.0), 0.5, {"frame_id": "map"})
    return {**grid_map, "inner_start_index": 0, "outer_start_index": 0, **changed}


def test_cells_are_in_grid_maps_order() -> None:
    grid_map = message()
    assert grid_map["data"][1]["data"].tolist() == [5.0, 4.0, 3.0, 2.0, 1.0, 0.0]  # cells of one y are contiguous
    assert [(dim["label"], dim["size"], dim["stride"]) for dim in grid_map["data"][1]["layout"]["dim"]] == [
        ("column_index", 2, 6), ("row_index", 3, 3),
    ]  # fmt: skip
    info = grid_map["info"]
    assert (info["length_x"], info["length_y"], info["pose"]["position"]) == (1.5, 1.0, {"x": 1.75, "y": 2.5, "z": 0.0})


def test_values_are_read_by_position() -> None:
    assert values_at(message(), "two", PLACES).tolist() == VALUES.reshape(-1).tolist()
    assert np.isnan(values_at(message(), "two", np.array([(0.99, 2.1), (2.51, 2.1), (1.1, 1.99), (1.1, 3.01)]))).all()


def test_a_rotated_map_and_one_with_a_start_index_are_read() -> None:
    """After `move` of `grid_map_core`, the first row in memory is not the first row of the map."""
    grid_map = message()
    grid_map["info"]["pose"]["orientation"] = {"z": math.sin(math.pi / 4), "w": math.cos(math.pi / 4)}
    apart = PLACES - (1.75, 2.5)
    turned = np.stack([1.75 - apart[:, 1], 2.5 + apart[:, 0]], 1)
    assert values_at(grid_map, "two", turned).tolist() == VALUES.reshape(-1).tolist()
    rolled = np.roll(grid_map["data"][1]["data"].reshape(2, 3), (1, 2), (0, 1)).reshape(-1)
    data = [grid_map["data"][0], {**grid_map["data"][1], "data": rolled}]
    moved = message(data=data, inner_start_index=1, outer_start_index=2)
    assert values_at(moved, "two", PLACES).tolist() == VALUES.reshape(-1).tolist()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"layers": ["one", "three"]}, "no 'two'; the message has one, three"),
        ({"data": []}, "data: 0 arrays for 2 layers"),
        ({"data": [{}, {"layout": {"dim": []}, "data": []}]}, r"data.layout.dim: labels must be .*, not \[\]"),
        ({"info": {"resolution": 0.0}}, "info.resolution: invalid cell size 0"),
    ],
)
def test_an_invalid_map_is_rejected_with_the_field_name(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        values_at(message(**changed), "two", PLACES)


@pytest.mark.parametrize(
    ("sizes", "words"), [((3, 3), "6 values instead of 3 x 3"), ((1 << 16, 1 << 16), "65536 x 65536 cells exceed")]
)
def test_wrong_declared_sizes_are_rejected(sizes: tuple[int, int], words: str) -> None:
    grid_map = message()
    for dim, size in zip(grid_map["data"][1]["layout"]["dim"], sizes, strict=True):
        dim["size"] = size
    with pytest.raises(ValueError, match=words):
        values_at(grid_map, "two", PLACES)
