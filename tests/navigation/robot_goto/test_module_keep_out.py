"""The module on a hub keeps the robot out of the keep-out areas of a map, or stands if they are unknown."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.messages.actions import GoalState
from bridge.stores.kinds import AREA, BEHAVIOR, CURRENT, MAP, ValueKind
from navigation.constraints import Constraints
from navigation.maps.grid import to_grid
from navigation.pose import Pose
from navigation.status import Fault, PlanError
from tests.navigation.robot_goto.deployed import Goto
from tests.support.wait import until
from yarp_compat.dev.extras import AreaBehavior
from yarp_compat.dev.locations import Map2DArea
from yarp_compat.dev.mapflag import MapFlag
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.sig.vec2d import Vec2D


def clear_store(place: Goto) -> None:
    """Delete the maps and areas, and the choice of the current map, which outlasts its map."""
    for kind in (BEHAVIOR, AREA, MAP, CURRENT):
        place.host.store.clear(kind)
    until(lambda: "no current map" in place.module.status().document()["keep_out"], "no map is used", 20)
    until(lambda: place.module.health().state == "running", "the robot may drive", 20)


def free(name: str) -> MapGrid2D:
    """Return a map of the room without obstacles."""
    return MapGrid2D.of(np.zeros((120, 120), np.uint8), name=name, resolution=0.05, origin=(-3.0, -3.0, 0.0))


def aborted_by(place: Goto, kind: ValueKind[Any], name: str, damaged: bytes) -> str:
    """Damage a value of the store while the robot drives on the map; return the error that ends its goal."""
    store, robot = place.host.store, place.robot
    store.put(MAP, "room", free("room"))
    store.use_map("room")
    until(lambda: place.module.status().document()["keep_out"] == "known", "the map is used", 20)
    sent = robot.send(2.0, 0.0, 0.0, Constraints(max_lin_speed=0.1).to_text())
    until(lambda: robot.x > 0.05, "the robot drives", 30)
    store.replica.write({(kind.name, name): (damaged, kind.encoding)})
    status, result = sent.end()
    assert (status, result["error_code"]) == (GoalState.ABORTED, Fault.NO_MAP)
    until(lambda: robot.commands[-1] == (0.0, 0.0, 0.0), "the robot stops", 20)
    return str(result["error_msg"])


def test_keep_out_areas_of_the_stores_map_are_obstacles(place: Goto) -> None:
    store, module = place.host.store, place.module
    ahead = Map2DArea("room", [Vec2D(1.0, -0.5), Vec2D(1.4, -0.5), Vec2D(1.4, 0.5), Vec2D(1.0, 0.5)])

    def blocked() -> bool:
        grid = place.host.loop.call(module.local_map)
        column, row = grid.cells_at((1.02, 0.0))
        return bool(grid.flags[row, column] == MapFlag.WALL)

    try:
        store.put(AREA, "ahead", ahead)
        store.put(BEHAVIOR, "ahead", AreaBehavior(keep_out=True))
        store.put(MAP, "room", free("room"))
        assert "no current map" in module.status().document()["keep_out"]
        assert not blocked()
        store.use_map("room")
        until(blocked, "the area is an obstacle", 20)
        assert module.status().document()["keep_out"] == "known"
        store.delete(BEHAVIOR, "ahead")
        until(lambda: not blocked(), "the area is free", 20)
    finally:
        clear_store(place)


def test_a_robot_stands_on_a_map_with_an_area_that_cannot_be_read(place: Goto) -> None:
    store, robot, module = place.host.store, place.robot, place.module
    broken = b'{"map": "room", "points": [[1, "a"]], "description": "keep_out"}'
    try:
        error = aborted_by(place, AREA, "ahead", broken)
        for text in (error, robot.send(2.0, 0.0).end()[1]["error_msg"], module.health().text):
            assert "robots keep out of the map 'room'" in text
            assert "remove --kind area ahead" in text
        with pytest.raises(PlanError, match="keep out of the map"):
            place.host.loop.call(lambda: module.approach(0.0, 0.1, 1.0))
        store.put(AREA, "ahead", Map2DArea("room", [Vec2D(2, 2), Vec2D(2.5, 2), Vec2D(2.5, 2.5)], "max_speed=fast"))
        until(lambda: module.health().state == "running", "the area can be read", 20)
        document = place.far.hub.ask("status", {}, worker="robot_goto", timeout=20.0)[0].value
        assert any("robots keep out of the area 'ahead'" in text for text in document["warnings"])
        assert len(module.driver.keep_out.near(0.3, Pose(1.0, 1.0, 0.0), Pose(1.0, 1.0, 0.0)))
    finally:
        clear_store(place)


def test_the_health_is_running_only_once_all_areas_are_obstacles(place: Goto, monkeypatch: pytest.MonkeyPatch) -> None:
    store, module = place.host.store, place.module
    entered, go = threading.Event(), threading.Event()
    use = module.driver.keep_out.use

    def slow(grid: MapGrid2D | None, areas: Iterable[Map2DArea] = ()) -> None:
        if areas:
            entered.set()
            assert go.wait(20)
        use(grid, areas)

    try:
        aborted_by(place, AREA, "ahead", b"damaged")
        monkeypatch.setattr(module.driver.keep_out, "use", slow)
        store.put(AREA, "ahead", Map2DArea("room", [Vec2D(2, 2), Vec2D(2.5, 2), Vec2D(2.5, 2.5)], "max_speed=fast"))
        assert entered.wait(20)
        assert module.health().state == "waiting"
        go.set()
        until(lambda: module.health().state == "running", "the area can be read", 20)
        assert len(module.driver.keep_out.near(0.3, Pose(1.0, 1.0, 0.0), Pose(1.0, 1.0, 0.0)))
    finally:
        go.set()
        clear_store(place)


def test_a_robot_stands_if_the_map_cannot_be_read(place: Goto) -> None:
    """Its keep-out cells are unknown, and those of an earlier map may not be the same."""
    robot, module = place.robot, place.module
    try:
        error = aborted_by(place, MAP, "room", b"damaged")
        for text in (error, robot.send(2.0, 0.0).end()[1]["error_msg"], module.health().text):
            assert "robots keep out of an unknown map: map 'room'" in text
        assert "map 'room'" in module.status().document()["keep_out"]
    finally:
        clear_store(place)


def test_a_robot_stands_until_the_map_of_a_topic_arrives(tmp_path: Path) -> None:
    with Goto(tmp_path, keep_out_map="/floor") as place:
        robot, module = place.robot, place.module
        result = robot.send(1.0, 0.0).end()[1]
        assert result["error_code"] == Fault.NO_MAP
        for text in (result["error_msg"], module.health().text):
            assert text == "robots keep out of an unknown map: waiting for a map on /floor"
        floor = place.far.advertise("/floor", "nav_msgs/OccupancyGrid", latched=True)
        place.far.publish(floor, to_grid(free("floor")))
        until(lambda: module.health().state == "running", "the robot may drive", 30)
        assert robot.send(1.0, 0.0).end()[0] is GoalState.SUCCEEDED


def test_a_goal_ends_when_another_map_is_used_while_the_robot_drives(place: Goto) -> None:
    store, robot = place.host.store, place.robot
    try:
        for name in ("room", "other"):
            store.put(MAP, name, free(name))
        store.use_map("room")
        sent = robot.send(2.0, 0.0, 0.0, Constraints(max_lin_speed=0.1).to_text())
        until(lambda: robot.x > 0.05, "the robot drives", 30)
        store.put(MAP, "room", free("room"))  # a new version of the same map does no harm
        store.use_map("other")
        status, result = sent.end()
        assert (status, result["error_code"]) == (GoalState.ABORTED, Fault.MAP_CHANGED)
        assert result["error_msg"] == "the map changed from room to other while driving"
        until(lambda: robot.commands[-1] == (0.0, 0.0, 0.0), "the robot stops", 20)
        assert robot.send(0.5, 0.0).end()[0] is GoalState.SUCCEEDED
    finally:
        clear_store(place)
