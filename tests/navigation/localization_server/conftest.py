"""A hub with a host of modules, and a standing robot."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.peers.hub.modules import Place
from tests.peers.sim.laboratory import Robot


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    with Place(tmp_path) as place:
        yield place


@pytest.fixture
def robot(place: Place) -> Iterator[Robot]:
    standing = Robot(place.far.hub, place.far.registry)
    yield standing
    standing.close()
