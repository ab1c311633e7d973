"""Floor plans: those that come with Midspan, files, doors, people, things that come and go, floors and links."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bridge.config.sections.sim import SimSection
from sim import pieces
from sim.base import BasePose
from sim.environment import SimError, ready
from sim.pieces import Walker
from sim.plan import Box, Floor, Person, load_plan, rectangles
from sim.simulation import Simulation
from tests.sim.floors import INSIDE, drive, simulation
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D


@pytest.mark.parametrize("name", ready("plans"))
def test_one_can_stand_at_every_place_of_every_plan(name: str) -> None:
    plan = load_plan(name)
    for floor_name, floor in plan.floors.items():
        there = Simulation(SimSection(), plan.model_copy(update={"floors": {floor_name: floor}, "links": ()}))
        for person in list(there.world.people):
            there.world.remove(person)
        for place, (x, y, degrees) in floor.places.items():
            try:
                there.teleport(BasePose(x, y, math.radians(degrees)))
            except SimError as err:
                pytest.fail(f"{name}/{floor_name}/{place}: {err}")


def test_the_plans_that_are_there() -> None:
    assert ready("plans") == ["apartment", "hall", "lab", "office", "tables", "two_storeys"]
    assert {"kitchen", "bedroom"} < load_plan("apartment").floors["apartment"].rooms.keys()
    with pytest.raises(SimError, match="neither a file nor one of the plans"):
        load_plan("castle")


def test_walls_have_holes_for_doors_and_openings_and_closed_corners() -> None:
    floor = Floor(
        walls=(((0, 0), (4, 0), (4, 3)),),
        openings=(((4, 1), (4, 2)),),
        doors=({"name": "d", "line": ((1, 0), (2, 0))},),
    )
    made = sorted((round(p.x, 3), round(p.y, 3), round(p.length, 3)) for p in pieces.walls(floor))
    assert made == [(0.475, 0.0, 1.05), (3.025, 0.0, 2.05), (4.0, 0.475, 1.05), (4.0, 2.525, 1.05)]


def test_a_door_lets_through_when_it_is_open_alone() -> None:
    there = simulation(
        floor={"walls": (((1, -2), (1, 2)),), "doors": ({"name": "d", "line": ((1, -0.5), (1, 0.5)), "open": False},)}
    )
    drive(there, 7, 0.3)
    assert there.base.pose().x < 0.8
    there.world.open("d", is_open=True)
    drive(there, 1.5, 0.3)
    with pytest.raises(SimError, match="the robot stands in it"):
        there.world.open("d", is_open=False)
    drive(there, 3, 0.3)
    assert there.base.pose().x > 1.4
    there.world.open("d", is_open=False)
    with pytest.raises(SimError, match="no door 'e'; doors: d"):
        there.world.open("e", is_open=True)


def test_people_walk_and_wait_for_the_robot() -> None:
    there = simulation(floor={"people": ({"name": "p", "at": (-1.5, 0.0), "path": ((1.5, 0.0),), "loop": False},)})
    person = there.world.people["p"]
    drive(there, 3, 0.0)
    assert -0.6 < person.x < -0.4  # in front of the robot
    assert np.allclose(there.base.pose(), (0.0, 0.0, 0.0), atol=5e-3)
    person.send([(-1.5, 0.0), (-1.5, 1.5)])
    drive(there, 5, 0.0)
    assert (person.x, person.y) == (-1.5, 1.5)
    there.teleport(BasePose(-1.5, 0.5, math.pi / 2))
    drive(there, 5, 0.3)
    assert there.base.pose().y < 1.5 - 0.2 - 0.2  # a person is not driven through
    assert (person.x, person.y) == (-1.5, 1.5)


def test_who_waited_for_long_turns_round_and_rests_and_goes_at_once_where_he_is_sent() -> None:
    walker = Walker(Person(name="p", at=(0.0, 0.0), path=((1.0, 0.0), (-1.0, 0.0)), speed=1.0))

    def walk(seconds: float) -> float:
        for _ in range(round(seconds / 0.1)):
            walker.walk(0.1, (0.9, 0.0), 0.3)
        return walker.x

    assert 0.0 < walk(4.0) < 0.6
    assert walk(3.5) == -1.0
    assert walk(10.0) == -1.0
    walker.send([(0.0, 0.0)])
    assert walk(2.0) == 0.0


def test_things_come_and_go() -> None:
    there = simulation()
    there.world.spawn(Box(at=(1, 0, 0), size=(0.4, 0.4, 0.4), mass=3), "crate")
    there.world.spawn(Person(name="eve", at=(0, 1.5)), "eve")
    there.world.spawn(pieces.of_box(Box(name="chest", at=(0, -1, 0), size=(0.6, 0.4, 0.5))), "chest")
    there.run(0.2)
    assert there.scan.ranges[360] == pytest.approx(0.8, abs=5e-3)
    for name in ("crate", "eve"):
        with pytest.raises(SimError, match="taken"):
            there.world.spawn(Box(at=(1, 1, 0), size=(0.1, 0.1, 0.1)), name)
    with pytest.raises(SimError, match="the robot stands there"):
        there.world.spawn(Box(at=(0.1, 0, 0), size=(0.1, 0.1, 0.1)), "in_the_way")
    with pytest.raises(SimError, match="chest is there"):
        there.teleport(BasePose(0.0, -0.8, 0.0))
    for name in ("crate", "eve", "chest"):
        there.world.remove(name)
    there.run(0.2)
    assert there.scan.ranges[360] == pytest.approx(INSIDE, abs=5e-3)
    there.teleport(BasePose(0.0, -0.8, 0.0))
    with pytest.raises(SimError, match="cannot be taken away; what can be: nothing"):
        there.world.remove("eve")


def test_a_lift_leads_to_the_other_floor_and_back() -> None:
    there = Simulation(SimSection(plan="two_storeys"))
    with pytest.raises(SimError, match="not within 1 m of an end of the link 'lift'"):
        there.ride("lift")
    x, y, _ = there.world.floor.locations["lift"]
    there.teleport(BasePose(x - 0.3, y, 0.0))
    assert there.ride("lift") == "upper"
    assert np.allclose(there.base.pose(), (11.0, 5.6, math.pi), atol=1e-3)
    drive(there, 3, 0.3)
    assert there.base.pose().x < 10.6
    there.teleport(BasePose(11.0, 5.6, 0.0))
    assert there.ride("lift") == "ground"
    with pytest.raises(SimError, match="links: lift"):
        there.ride("stairs")


def test_a_plans_mistakes_are_named_with_their_line(tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text("walls:\n  - [[0, 0], [1, 0]]\ndoors:\n  - {name: d, line: [[0, 0]]}\nrooom: {}\n")
    with pytest.raises(SimError) as caught:
        load_plan(str(file))
    assert f"{file}:4" in str(caught.value)
    assert f"{file}:5" in str(caught.value)
    assert "rooms" in str(caught.value)


def test_rectangles_cover_the_solid_cells_once() -> None:
    rng = np.random.default_rng(2)
    solid = rng.random((40, 30)) < 0.4
    covered = np.zeros(solid.shape, int)
    for left, bottom, right, top in rectangles(solid):
        covered[bottom:top, left:right] += 1
    assert (covered == solid).all()


def test_a_map_and_an_image_become_the_same_room(tmp_path: Path) -> None:
    flags = np.full((40, 60), MapFlag.FREE, np.uint8)
    flags[[0, -1], :] = flags[:, [0, -1]] = MapFlag.WALL
    flags[5:9, 20] = MapFlag.WALL  # four cells high, near the top
    grid = MapGrid2D.of(flags, name="room", resolution=0.1, origin=(0.0, 0.0, 0.0))
    grid.save(tmp_path / "room.map")
    grid.save(tmp_path / "other.yaml")
    Image.fromarray(np.where(flags == MapFlag.WALL, 0, 255).astype(np.uint8)).save(tmp_path / "room.png")
    found = []
    for name in ("room.map", "other.yaml", "room.png"):
        there = Simulation(SimSection(laser={"beams": 8}), load_plan(str(tmp_path / name), 0.1))
        assert there.base.pose()[:2] == pytest.approx((3.0, 2.0))
        found.append(there.scan.ranges)
        there.teleport(BasePose(1.0, 3.25, 0.0))
        there.run(0.1)
        assert there.scan.ranges[4] == pytest.approx(1.0, abs=5e-3)
    assert np.allclose(found[0], found[1])
    assert np.allclose(found[0], found[2])
    assert found[0] == pytest.approx([2.9, math.hypot(1.9, 1.9), 1.9, math.hypot(1.9, 1.9)] * 2)
    (tmp_path / "no.png").write_bytes(b"nothing")
    with pytest.raises(SimError, match="no image"):
        load_plan(str(tmp_path / "no.png"))


def test_two_thousand_walls_do_not_slow_it_down() -> None:
    rng = np.random.default_rng(1)
    boxes = tuple(Box(at=(*rng.uniform(-60, 60, 2), 0.0), size=(1.5, 0.1, 2.0)) for _ in range(2000))
    away = tuple(box for box in boxes if math.hypot(*box.at[:2]) > 3)
    there = simulation(floor={"walls": (), "boxes": away})
    assert len(there.world.pieces) > 1950
    most = 0
    for _ in range(10):
        drive(there, 0.5, 0.3)
        most = max(most, there.world.window.count)
    assert most < 20
