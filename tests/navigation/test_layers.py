"""Layers on the hub: the points of their cells, and invalid grids."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from bridge.config.sections.obstacles import ObstacleSection
from navigation.layers import LayerError, LayerSubscriptions, on, read_layer
from navigation.pose import Pose


def layer(cells, resolution=0.05, x=1.0, y=2.0, yaw=0.0, changed=None):
    rows = np.array(cells, np.int8)
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    info = {
        "resolution": resolution, "width": rows.shape[1], "height": rows.shape[0],
        "origin": {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn},
    }  # fmt: skip
    return {"info": {**info, **(changed or {})}, "data": rows.ravel()}


def test_cells_from_50_on_become_points():
    points = read_layer(layer([[0, 100, 49], [-1, 50, 0]]))
    assert sorted(map(tuple, points.round(9).tolist())) == [(1.075, 2.025), (1.075, 2.075)]
    assert read_layer(layer([[0, -1]])).shape == (0, 2)


def test_points_of_a_rotated_layer_are_transformed_to_another_frame():
    (points,) = read_layer(layer([[0, 100]], yaw=math.pi / 2))
    np.testing.assert_allclose(points, (1.0 - 0.025, 2.0 + 0.075), atol=1e-9)
    np.testing.assert_allclose(on(np.array([points]), Pose(1.0, 0.0, math.pi)), [(1.0 - 0.975, -2.075)], atol=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_a_large_cell_is_split(yaw):
    points = read_layer(layer([[0, 100]], resolution=0.2, yaw=yaw))
    assert len(points) == 16
    back = on(points - (1.0, 2.0), Pose(0.0, 0.0, -yaw))
    np.testing.assert_allclose(sorted(set(back[:, 0].round(6))), [0.225, 0.275, 0.325, 0.375], atol=1e-6)
    np.testing.assert_allclose(sorted(set(back[:, 1].round(6))), [0.025, 0.075, 0.125, 0.175], atol=1e-6)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"width": 3}, "3 x 1 cells must not have 2"),
        ({"width": 0}, "0 x 1 cells"),
        ({"width": 100_000, "height": 100_000}, "100000"),
        ({"resolution": 0.0}, "0.0"),
        ({"resolution": math.nan}, "nan"),
    ],
)
def test_an_invalid_grid_is_rejected(changed, words):
    with pytest.raises(LayerError, match=words):
        read_layer(layer([[0, 100]], changed=changed))


def test_a_layer_may_arrive_while_another_thread_asks_which_layer_is_silent():
    receive, message = {}, {"header": {"frame_id": "map"}, **layer([[0, 100]])}
    graph = SimpleNamespace(publishers=lambda _topic: [receive["/b"](message)])
    node = SimpleNamespace(
        hub=SimpleNamespace(graph=graph),
        subscription=lambda topic, _kind, on_message, _qos: receive.update({topic: on_message}),
    )
    host = SimpleNamespace(node=node, on_jump=lambda _forget: None)
    sources = [ObstacleSection(topic=topic, type="layer") for topic in ("/a", "/b")]
    frames = SimpleNamespace(map_frame="map")
    layers = LayerSubscriptions(host, sources, frames, lambda _topic, _places: None, lambda: 1.0)
    receive["/a"](message)
    assert layers.silent() == ""
