"""A map and the graph of its scans are replaced together: no fault leaves a map with the graph of another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navigation.algorithms.submaps import Submaps
from navigation.mapper2d import graph_file
from navigation.mapper2d.graph_file import SavedGraph
from navigation.pose import Pose


def saved(x: float) -> SavedGraph:
    """Return a graph whose first submap is at x."""
    submaps = Submaps()
    submaps.begin(Pose(x, 0.0, 0.0))
    return SavedGraph(submaps, np.zeros((1, 1), np.uint8), (0.0, 0.0))


def first(path: Path) -> float:
    """Return the x of a file's first submap."""
    return graph_file.read(path).submaps.graph.poses[0].x


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "map.graph.npz"
    with graph_file.replacing(path, saved(1.0)):
        assert not path.exists()
    assert first(path) == 1.0
    return path


@pytest.mark.parametrize("with_graph", [True, False])
def test_a_process_that_is_killed_while_it_saves_the_map_leaves_no_graph(path: Path, with_graph: bool) -> None:
    with graph_file.replacing(path, saved(2.0) if with_graph else None):
        assert not path.exists()
    assert path.exists() is with_graph
    assert not with_graph or first(path) == 2.0
    assert len(list(path.parent.iterdir())) == with_graph, "no other file remains"


def test_a_map_that_cannot_be_saved_keeps_its_graph(path: Path) -> None:
    with pytest.raises(OSError, match="the map"), graph_file.replacing(path, saved(2.0)):
        raise OSError("the map cannot be saved")
    assert first(path) == 1.0
    assert list(path.parent.iterdir()) == [path]


def test_a_graph_that_cannot_be_saved_leaves_the_map_as_it_was(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(OSError, match="no space left"), graph_file.replacing(path, saved(2.0)):
        pytest.fail("the map is saved")
    assert first(path) == 1.0


def test_the_previous_graph_of_a_killed_process_is_not_used(path: Path) -> None:
    path.replace(path.with_name(path.name + ".before"))  # the process was killed while it saved the map
    with pytest.raises(OSError, match="the map"), graph_file.replacing(path, None):
        raise OSError("the map cannot be saved")
    assert not path.exists()
