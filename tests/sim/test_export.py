"""Maps, locations and pictures of floor plans, including those that ``midspan sim`` exports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bridge.cli.main import main
from bridge.stores.kinds import LINK
from bridge.stores.service import read_files
from sim import export
from sim.export import draw
from sim.plan import load_plan
from tests.peers.sim.floors import simulation
from yarp_compat.dev.extras import Extras, extras_file
from yarp_compat.dev.mapgrid import MapFlag, MapGrid2D
from yarp_compat.dev.places import Places


def test_a_plans_map_agrees_with_the_laser() -> None:
    plan = load_plan("apartment")
    grid = export.grid(plan, "apartment", 0.05)
    floor = plan.floors["apartment"]

    def flag(x: float, y: float) -> int:
        left, bottom, _ = grid.getOrigin()
        return int(grid.flags[grid.height() - 1 - int((y - bottom) / 0.05), int((x - left) / 0.05)])

    assert flag(0.0, 3.0) == MapFlag.WALL
    assert flag(2.5, 4.0) == MapFlag.FREE  # a door
    assert flag(10.5, 4.0) == MapFlag.FREE  # a closed door
    assert flag(4.9, 6.6) == MapFlag.FREE  # a movable box
    assert flag(3.4, 2.2) == MapFlag.WALL  # the table
    assert flag(-0.4, -0.4) == MapFlag.UNKNOWN  # outside
    for place, (x, y, _) in floor.places.items():
        assert flag(x, y) == MapFlag.FREE, place
    sim = simulation(floor=floor.model_dump(), start=floor.start)
    scan, (x, y, yaw) = sim.scan, sim.base.pose()
    angles = yaw + scan.first + np.arange(len(scan.ranges)) * scan.step
    hits = [(x + (r + 0.01) * np.cos(a), y + (r + 0.01) * np.sin(a)) for r, a in zip(scan.ranges, angles, strict=True)]
    known = [flag(*hit) == MapFlag.WALL for hit in hits]
    assert sum(known) > 0.9 * len(known)  # hits on the parcel and a person are not walls on the map


def test_two_floors_are_exported_as_two_maps_and_a_link(tmp_path: Path) -> None:
    plan = load_plan("two_storeys")
    written = {file.name for file in export.save(plan, tmp_path / "out", 0.1)}
    assert {"ground.map", "upper.map", "ground.yaml", "locations.ini", "maps_collection.ini"} <= written
    grid = MapGrid2D.load(tmp_path / "out" / "ground.map")
    assert grid.isIdenticalTo(export.grid(plan, "ground", 0.1))
    again = load_plan(str(tmp_path / "out" / "upper.yaml"))
    assert len(next(iter(again.floors.values())).boxes) > 5
    places = Places.load(tmp_path / "out" / "locations.ini")
    assert places.locations["upper_lift"].map_id == "upper"
    assert len(places.areas["ground_hall_area"].points) == 4
    (link,) = export.links(plan).values()
    assert {link.first, link.second} <= places.locations.keys()
    assert link.cost == 30
    links_file = extras_file(tmp_path / "out" / "locations.ini")
    assert links_file.name in written
    assert Extras.load(links_file).links == {"lift": link}
    stored = {(entry.kind.name, entry.name): entry.value for entry in read_files(tmp_path / "out" / "locations.ini")}
    assert stored[LINK.name, "lift"] == link, "an import includes the link between its locations"


def test_an_export_removes_the_links_of_an_earlier_export(tmp_path: Path) -> None:
    export.save(load_plan("two_storeys"), tmp_path, 0.2)
    written = {file.name for file in export.save(load_plan("hall"), tmp_path, 0.2)}
    assert "locations_extras.ini" in written
    assert Extras.load(tmp_path / "locations_extras.ini").links == {}
    only_hall = {file.name for file in export.save(load_plan("hall"), tmp_path / "hall", 0.2)}
    assert "locations_extras.ini" not in only_hall


def test_the_picture_shows_walls_and_the_robot() -> None:
    sim = simulation()
    picture = draw(sim)
    height, width, _ = picture.shape
    assert tuple(picture[height // 2 + 5, width // 2]) == (40, 160, 90)
    walls = (picture == (60, 62, 70)).all(axis=2).sum()
    assert walls > 1000


def test_the_command_writes_maps_and_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sim", "--list"]) == 0
    assert "apartment, hall, lab, office, tables, two_storeys" in capsys.readouterr().out
    config = tmp_path / "midspan.yaml"
    config.write_text(f"state: {tmp_path}\nsim: {{plan: hall}}\n")
    assert main(["sim", "--config", str(config), "--picture", str(tmp_path / "hall.png")]) == 0
    with Image.open(tmp_path / "hall.png") as image:
        assert image.size[0] == 800
    assert main(["sim", "--config", str(config), "--export", str(tmp_path / "maps"), "--resolution", "0.2"]) == 0
    assert (tmp_path / "maps" / "hall.map").exists()
    capsys.readouterr()
    for wrong, message in (
        (["--plan", "castle", "--picture", "x.png"], "plans that come with Midspan"),
        (["--speed", "fast"], "a number, 'max' or 'step'"),
        (["--speed", "-1"], "0.01 to 1000"),
        (["--export", "x", "--resolution", "99"], "0.001 to 10 meters"),
        (["--export", "x", "--resolution", "0"], "0.001 to 10 meters"),
    ):
        assert main(["sim", "--config", str(config), *wrong]) == 1
        assert message in capsys.readouterr().err


FOLDER = "; --export takes a folder that this user may write to, with enough space\n"
FILE = "; --picture takes a file in a folder that this user may write to, with enough space\n"


@pytest.mark.parametrize(
    ("option", "path", "error"),
    [
        ("--export", "file", f"the maps into {{path}}: {{path}}: file exists{FOLDER}"),
        ("--export", "file/maps", f"the maps into {{path}}: {{path}}: not a directory{FOLDER}"),
        ("--export", "/proc/maps", f"the maps into {{path}}: {{path}}: no such file or directory{FOLDER}"),
        ("--export", "taken", f"the maps into {{path}}: {{path}}/locations.ini: Is a directory{FOLDER}"),
        ("--picture", "none/a.png", f"the picture {{path}}: {{path}}: no such file or directory{FILE}"),
        ("--picture", "taken", f"the picture {{path}}: {{path}}: is a directory{FILE}"),
        ("--picture", "/dev/full", f"the picture {{path}}: no space left on device{FILE}"),
    ],
)
def test_a_place_that_cannot_be_written_is_a_plain_error(
    option: str, path: str, error: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "taken" / "locations.ini").mkdir(parents=True)
    (tmp_path / "m.yaml").write_text(f"state: {tmp_path}")
    place = str(tmp_path / path)
    assert main(["sim", "--config", str(tmp_path / "m.yaml"), "--plan", "hall", option, place]) == 1
    assert capsys.readouterr().err == f"midspan: cannot write {error.format(path=place)}"
