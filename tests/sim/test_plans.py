"""Floor plans: included ones, files, doors, people, added things, floors and links."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sim import pieces
from sim.base import BasePose
from sim.environment import SimError, ready
from sim.pieces import Walker
from sim.plan import Box, Floor, Link, Person, Plan, load_plan, rectangles
from sim.section import SimSection
from sim.simulation import Simulation
from tests.peers.sim.floors import INSIDE, ROOM, drive, simulation
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D

BOX = Box(name="crate", at=(0.0, 1.2, 0.0), size=(0.4, 0.4, 0.4), mass=5.0)


@pytest.mark.parametrize("name", ready("plans"))
def test_the_robot_can_stand_at_every_place_of_every_plan(name: str) -> None:
    plan = load_plan(name)
    for floor_name, floor in plan.floors.items():
        sim = Simulation(SimSection(), plan.model_copy(update={"floors": {floor_name: floor}, "links": ()}))
        for person in list(sim.world.people):
            sim.world.remove(person)
        for place, (x, y, degrees) in floor.places.items():
            try:
                sim.teleport(BasePose(x, y, math.radians(degrees)))
            except SimError as err:
                pytest.fail(f"{name}/{floor_name}/{place}: {err}")


def test_the_plans_that_come_with_midspan_are_found_by_name() -> None:
    assert ready("plans") == ["apartment", "hall", "lab", "office", "tables", "two_storeys"]
    assert {"kitchen", "bedroom"} < load_plan("apartment").floors["apartment"].rooms.keys()
    with pytest.raises(SimError, match="neither a file nor one of the plans"):
        load_plan("castle")


def test_walls_have_gaps_for_doors_and_openings_and_closed_corners() -> None:
    floor = Floor(
        walls=(((0, 0), (4, 0), (4, 3)),),
        openings=(((4, 1), (4, 2)),),
        doors=({"name": "d", "line": ((1, 0), (2, 0))},),
    )
    walls = sorted((round(p.x, 3), round(p.y, 3), round(p.length, 3)) for p in pieces.walls(floor))
    assert walls == [(0.475, 0.0, 1.05), (3.025, 0.0, 2.05), (4.0, 0.475, 1.05), (4.0, 2.525, 1.05)]


def test_the_robot_passes_only_open_doors() -> None:
    sim = simulation(
        floor={"walls": (((1, -2), (1, 2)),), "doors": ({"name": "d", "line": ((1, -0.5), (1, 0.5)), "open": False},)}
    )
    drive(sim, 7, 0.3)
    assert sim.base.pose().x < 0.8
    sim.world.open("d", is_open=True)
    drive(sim, 1.5, 0.3)
    with pytest.raises(SimError, match="the robot stands in it"):
        sim.world.open("d", is_open=False)
    drive(sim, 3, 0.3)
    assert sim.base.pose().x > 1.4
    sim.world.open("d", is_open=False)
    with pytest.raises(SimError, match="unknown door 'e'; doors: d"):
        sim.world.open("e", is_open=True)


def test_people_walk_and_wait_for_the_robot() -> None:
    sim = simulation(floor={"people": ({"name": "p", "at": (-1.5, 0.0), "path": ((1.5, 0.0),), "loop": False},)})
    person = sim.world.people["p"]
    drive(sim, 3, 0.0)
    assert -0.6 < person.x < -0.4  # in front of the robot
    assert np.allclose(sim.base.pose(), (0.0, 0.0, 0.0), atol=5e-3)
    person.send([(-1.5, 0.0), (-1.5, 1.5)])
    drive(sim, 5, 0.0)
    assert (person.x, person.y) == (-1.5, 1.5)
    sim.teleport(BasePose(-1.5, 0.5, math.pi / 2))
    drive(sim, 5, 0.3)
    assert sim.base.pose().y < 1.5 - 0.2 - 0.2  # the robot does not pass through a person
    assert (person.x, person.y) == (-1.5, 1.5)


def test_a_blocked_person_turns_round_and_rests_and_follows_a_new_path_at_once() -> None:
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


@pytest.mark.parametrize("path", [((0.0, 0.0), (0.0, 0.0)), ((1.0, 0.0), (1.0, 0.0)), ((0.1, 0.0), (0.1, 1e-9))])
def test_a_person_whose_path_has_no_length_stands_at_its_place(path: tuple[tuple[float, float], ...]) -> None:
    walker = Walker(Person(name="p", at=(0.0, 0.0), path=path, speed=1.0))
    for _ in range(20):
        walker.walk(0.1, (9.0, 0.0), 0.3)
    assert walker.x == path[0][0]


def test_things_are_added_and_removed() -> None:
    sim = simulation()
    sim.world.spawn(Box(at=(1, 0, 0), size=(0.4, 0.4, 0.4), mass=3), "crate")
    sim.world.spawn(Person(name="eve", at=(0, 1.5)), "eve")
    sim.world.spawn(pieces.of_box(Box(name="chest", at=(0, -1, 0), size=(0.6, 0.4, 0.5))), "chest")
    sim.run(0.2)
    assert sim.scan.ranges[360] == pytest.approx(0.8, abs=5e-3)
    for name in ("crate", "eve"):
        with pytest.raises(SimError, match="taken"):
            sim.world.spawn(Box(at=(1, 1, 0), size=(0.1, 0.1, 0.1)), name)
    with pytest.raises(SimError, match="the robot stands there"):
        sim.world.spawn(Box(at=(0.1, 0, 0), size=(0.1, 0.1, 0.1)), "in_the_way")
    with pytest.raises(SimError, match="chest is there"):
        sim.teleport(BasePose(0.0, -0.8, 0.0))
    for name in ("crate", "eve", "chest"):
        sim.world.remove(name)
    sim.run(0.2)
    assert sim.scan.ranges[360] == pytest.approx(INSIDE, abs=5e-3)
    sim.teleport(BasePose(0.0, -0.8, 0.0))
    with pytest.raises(SimError, match="cannot remove 'eve'; removable things: none"):
        sim.world.remove("eve")


def test_a_lift_moves_the_robot_to_the_other_floor_and_back() -> None:
    sim = Simulation(SimSection(plan="two_storeys"))
    with pytest.raises(SimError, match="not within 1 m of an end of the link 'lift'"):
        sim.ride("lift")
    x, y, _ = sim.world.floor.locations["lift"]
    sim.teleport(BasePose(x - 0.3, y, 0.0))
    assert sim.ride("lift") == "upper"
    assert np.allclose(sim.base.pose(), (11.0, 5.6, math.pi), atol=1e-3)
    drive(sim, 3, 0.3)
    assert sim.base.pose().x < 10.6
    sim.teleport(BasePose(11.0, 5.6, 0.0))
    assert sim.ride("lift") == "ground"
    with pytest.raises(SimError, match="links: lift"):
        sim.ride("stairs")


def test_the_robot_stays_on_its_floor_if_the_other_end_of_the_lift_is_occupied() -> None:
    floors = {
        "ground": Floor(walls=ROOM, locations={"lift": (1.0, 0.0, 0.0)}),
        "upper": Floor(walls=ROOM, locations={"lift": (0.0, 1.0, 0.0)}, boxes=(BOX,)),
    }
    link = Link(name="lift", ends=("ground/lift", "upper/lift"))
    sim = Simulation(SimSection(), Plan(name="house", floors=floors, links=(link,)))
    with pytest.raises(SimError, match=r"the robot cannot stand at 0.00, 1.00: crate is there"):
        sim.ride("lift")
    assert sim.floor == "ground"
    drive(sim, 12, 0.3)
    assert 1.3 < sim.base.pose().x < INSIDE - 0.2  # it drives, and a wall of this floor stops it


def test_errors_in_a_plan_are_reported_with_their_line(tmp_path: Path) -> None:
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


def test_a_map_and_an_image_load_as_the_same_room(tmp_path: Path) -> None:
    flags = np.full((40, 60), MapFlag.FREE, np.uint8)
    flags[[0, -1], :] = flags[:, [0, -1]] = MapFlag.WALL
    flags[5:9, 20] = MapFlag.WALL  # four cells high, near the top
    grid = MapGrid2D.of(flags, name="room", resolution=0.1, origin=(0.0, 0.0, 0.0))
    grid.save(tmp_path / "room.map")
    grid.save(tmp_path / "other.yaml")
    Image.fromarray(np.where(flags == MapFlag.WALL, 0, 255).astype(np.uint8)).save(tmp_path / "room.png")
    scans = []
    for name in ("room.map", "other.yaml", "room.png"):
        sim = Simulation(SimSection(laser={"beams": 8}), load_plan(str(tmp_path / name), 0.1))
        assert sim.base.pose()[:2] == pytest.approx((3.0, 2.0))
        scans.append(sim.scan.ranges)
        sim.teleport(BasePose(1.0, 3.25, 0.0))
        sim.run(0.1)
        assert sim.scan.ranges[4] == pytest.approx(1.0, abs=5e-3)
    assert np.allclose(scans[0], scans[1])
    assert np.allclose(scans[0], scans[2])
    assert scans[0] == pytest.approx([2.9, math.hypot(1.9, 1.9), 1.9, math.hypot(1.9, 1.9)] * 2)
    (tmp_path / "no.png").write_bytes(b"nothing")
    with pytest.raises(SimError, match="cannot read the image"):
        load_plan(str(tmp_path / "no.png"))


def test_only_nearby_walls_of_two_thousand_collide() -> None:
    rng = np.random.default_rng(1)
    boxes = tuple(Box(at=(*rng.uniform(-60, 60, 2), 0.0), size=(1.5, 0.1, 2.0)) for _ in range(2000))
    away = tuple(box for box in boxes if math.hypot(*box.at[:2]) > 3)
    sim = simulation(floor={"walls": (), "boxes": away})
    assert len(sim.world.pieces) > 1950
    most = 0
    for _ in range(10):
        drive(sim, 0.5, 0.3)
        most = max(most, sim.world.window.count)
    assert most < 20
