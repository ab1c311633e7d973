"""The robot's shape, the store's places and the keep-out cells, as the app receives them."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.client.store import StoreClient
from bridge.foxglove.scene import KEEP_OUT, SCENE
from bridge.stores.kinds import AREA, CURRENT, LOCATION, MAP
from bridge.stores.store import THE_MAP, Store, Write
from bridge.web.feeds import maps
from tests.foxglove.conftest import Desk
from tests.peers.browser.foxglove_app import App
from tests.stores.parts import Shared
from tests.support.wait import until
from yarp_compat.dev.locations import Map2DArea, Map2DLocation
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.sig.vec2d import Vec2D


@pytest.fixture
def store(desk: Desk, tmp_path: Path) -> Iterator[Store]:
    with Shared(tmp_path, "here", desk.hubs.endpoint) as shared:
        grid = MapGrid2D.of(
            np.zeros((4, 6), np.uint8), np.zeros((4, 6), np.uint8), name="hall", resolution=0.5, origin=(1.0, 2.0, 0.0)
        )
        grid.flags[3, 0] = MapFlag.KEEP_OUT  # the cell at the origin, because rows go from top to bottom
        shared.store.write([
            Write(MAP, "hall", grid), Write(CURRENT, THE_MAP, "hall"),
            Write(LOCATION, "kitchen", Map2DLocation("hall", 2.0, 3.0, 90.0)),
            Write(LOCATION, "far", Map2DLocation("other", 2.0, 3.0, 90.0)),
            Write(AREA, "desk", Map2DArea("hall", [Vec2D(1, 2), Vec2D(2, 2), Vec2D(2, 3)])),
        ])  # fmt: skip
        yield shared.store


class Proto:
    """A protobuf message, accessed by field number (protobuf.dev, "Encoding")."""

    def __init__(self, data: bytes) -> None:
        self._fields: dict[int, list[Any]] = {}
        self._data, self._at = data, 0
        while self._at < len(data):
            number, kind = divmod(self._varint(), 8)
            self._fields.setdefault(number, []).append(self._value(kind))

    def _varint(self) -> int:
        entities = shift = 0
        while True:
            byte = self._data[self._at]
            self._at += 1
            entities |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return entities

    def _value(self, kind: int) -> Any:
        if kind == 0:
            return self._varint()
        size = {1: 8, 5: 4}.get(kind) or self._varint()
        part = self._data[self._at : self._at + size]
        self._at += size
        return struct.unpack("<d", part)[0] if kind == 1 else part

    def all_of(self, number: int) -> list[Proto]:
        return [Proto(part) for part in self._fields.get(number, [])]

    def inner(self, *numbers: int) -> Proto:
        """Return a nested message."""
        return self if not numbers else self.all_of(numbers[0])[0].inner(*numbers[1:])

    def text(self, number: int) -> str:
        return bytes(self._fields[number][0]).decode()

    def number(self, number: int) -> Any:
        return self._fields.get(number, [0])[0]

    def spot(self) -> tuple[float, float]:
        """Return x and y of a Point3 or Vector3."""
        return self.number(1), self.number(2)


FRAME, ID, LOCKED, ARROWS, LINES, TEXTS = 2, 3, 5, 7, 11, 13
"""Fields of foxglove.SceneEntity (foxglove/foxglove-sdk, schemas/proto)."""


def scene(app: App) -> dict[str, Proto]:
    """Return the newest scene's entities by id."""
    channel = app.channel(SCENE)
    assert (channel["encoding"], channel["schemaName"]) == ("protobuf", "foxglove.SceneUpdate")
    update = Proto(app.messages[SCENE][-1][1])
    assert [all_of.number(2) for all_of in update.all_of(1)] == [1], "the previous content is deleted"
    return {all_of.text(ID): all_of for all_of in update.all_of(2)}


def corners(entity: Proto) -> list[tuple[float, float]]:
    return [point.spot() for point in entity.inner(LINES).all_of(5)]


def test_the_robots_shape_is_shown_without_a_store(desk: Desk) -> None:
    desk.open_with(web={"footprint": [[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]]})
    with desk.app() as app:
        app.subscribe(SCENE)
        app.received(SCENE)
        (robot,) = scene(app).values()
        assert (robot.text(ID), robot.text(FRAME), robot.number(LOCKED)) == ("robot", "base_link", 1)
        assert corners(robot) == [(0.4, 0.3), (-0.4, 0.3), (-0.4, -0.3), (0.4, -0.3)]


def test_places_and_areas_of_the_current_map_are_shown(desk: Desk, store: Store) -> None:
    with desk.app() as app:
        app.subscribe(SCENE)
        app.received(SCENE)
        entities = app.until(
            lambda: scene(app) if len(scene(app)) == 3 else None, "the scene has the robot, the place and the area"
        )
        assert set(entities) == {"robot", "place:kitchen", "area:desk"}
        kitchen, area = entities["place:kitchen"], entities["area:desk"]
        assert (kitchen.text(FRAME), kitchen.inner(TEXTS).text(6)) == ("map", "kitchen")
        assert kitchen.inner(ARROWS, 1, 1).spot() == (2.0, 3.0)
        assert kitchen.inner(ARROWS, 1, 2).number(3) == pytest.approx(0.5**0.5, abs=1e-3)
        assert corners(area) == [(1.0, 2.0), (2.0, 2.0), (2.0, 3.0)]
        store.write([Write(LOCATION, "door", Map2DLocation("hall", 1.0, 1.0, 0.0))])
        app.until(lambda: "place:door" in scene(app), "the scene has the new place")
        with desk.app() as late:
            late.subscribe(SCENE)
            late.received(SCENE)
            assert "place:door" in scene(late)


def test_keep_out_cells_have_the_maps_orientation(desk: Desk, store: Store) -> None:
    assert store is not None
    with desk.app() as app:
        app.subscribe(KEEP_OUT)
        app.received(KEEP_OUT)
        entities = app.decoded(KEEP_OUT)
        assert (entities.header.frame_id, entities.info.width, entities.info.height) == ("map", 6, 4)
        assert (entities.info.origin.position.x, entities.info.origin.position.y) == (1.0, 2.0)
        assert np.asarray(entities.data).tolist() == [100] + [0] * 23


def test_the_store_is_polled_only_while_a_client_watches(
    desk: Desk, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert store is not None
    digest, clients = StoreClient.digest, list[StoreClient]()

    def counted_digest(client: StoreClient) -> Any:
        clients.append(client)
        return digest(client)

    monkeypatch.setattr(StoreClient, "digest", counted_digest)
    monkeypatch.setattr(maps, "POLL_SECONDS", 0.1)

    def is_idle() -> bool:
        before = len(clients)
        time.sleep(1.0)
        return len(clients) == before

    with desk.app() as app:
        app.channel(SCENE)
        assert is_idle()
        assert not clients, "no client watches yet"
        number = app.subscribe(SCENE)
        app.until(lambda: app.messages[SCENE], "a scene arrives")
        app.until(lambda: len(clients) > 3, "the store is polled repeatedly")
        app.unsubscribe(number)
        until(is_idle, "polling has stopped")
