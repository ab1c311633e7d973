"""Map files of YARP and ROS: round trips, files as users have them, and malicious ones."""

from __future__ import annotations

import os
import struct
import sys
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from tests.yarp_compat.dev.maps import maps
from yarp_compat.dev.mapfile import MapFileError, read_image
from yarp_compat.dev.mapflag import COLORS, UNKNOWN, MapFlag, flags_of
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.dev.places import load_maps, map_files, save_maps

try:
    import resource
except ImportError:  # missing on Windows
    resource = None  # type: ignore[assignment]

HEAD = "image: m.pgm\nresolution: 0.05\norigin: [-1.5, 2.0, 0.0]\n"
USUAL = HEAD + "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
GRAYS = np.array([[0, 90, 128], [205, 254, 255]], np.uint8)
TRINARY = [[100, 65, 255], [255, 0, 0]]


def ros(folder: Path, text: str = USUAL, image: str = "m.pgm", pixels: Any = GRAYS) -> Path:
    (folder / image).parent.mkdir(exist_ok=True)
    Image.fromarray(np.asarray(pixels)).save(folder / image)
    (folder / "m.yaml").write_text(text)
    return folder / "m.yaml"


def cells(path: Path, **jail: Any) -> list[list[int]]:
    return MapGrid2D.load(path, **jail).occupancy.tolist()


@given(grid=maps())
@settings(max_examples=40)
def test_a_map_of_yarp_survives_a_round_trip(grid: MapGrid2D) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "x.map")
        grid.save(path)
        loaded = MapGrid2D.load(path, jail=Path(folder))
        assert loaded.isIdenticalTo(grid)
        header = yaml.safe_load(Path(folder, f"{grid.name}_grid.yaml").read_text(encoding="utf-8"))
        assert header["origin"] == pytest.approx(grid.origin.to_ros())
        assert {path.name for path in Path(folder).iterdir()} == {
            "x.map", *(f"{grid.name}_{end}" for end in ("grid.yaml", "grid.pgm", "yarpflags.ppm"))
        }  # fmt: skip


@given(grid=maps(), kind=st.sampled_from(["pgm", "png", "bmp", "scale", "negated scale"]))
@settings(max_examples=60)
def test_the_occupancy_of_a_map_of_ros_survives_a_round_trip(grid: MapGrid2D, kind: str) -> None:
    options: dict[str, Any] = {"image": kind}
    if "scale" in kind:
        options = {"image": "png", "mode": "scale", "negate": "negated" in kind}
    with tempfile.TemporaryDirectory() as folder:
        grid.save(Path(folder, "m1.yaml"), **options)
        again = MapGrid2D.load(Path(folder, "m1.yaml"))
    assert (again.occupancy == grid.occupancy).all()
    assert (again.flags == flags_of(grid.occupancy)).all()
    assert (again.name, again.resolution) == ("m1", grid.resolution)
    assert again.getOrigin() == pytest.approx(grid.getOrigin(), abs=1e-9)


@pytest.mark.parametrize("negate", [False, True])
@pytest.mark.parametrize("image", ["pgm", "png", "bmp"])
def test_a_map_of_ros_is_trinary_by_default(tmp_path: Path, image: str, negate: bool) -> None:
    grid = MapGrid2D.of(np.array([[0, 4, 5]], np.uint8))
    grid.save(tmp_path / "m.yaml", image=image, negate=negate)
    assert yaml.safe_load((tmp_path / "m.yaml").read_text())["mode"] == "trinary"
    pixels = np.asarray(Image.open(tmp_path / f"m.{image}")).tolist()
    assert pixels == [[1, 255, 50]] if negate else [[254, 0, 205]]
    assert cells(tmp_path / "m.yaml") == [[0, 100, 255]]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (USUAL, [[100, 255, 255], [255, 0, 0]]),
        (USUAL.replace("free_thresh: 0.196", "free_thresh: 0.25"), [[100, 255, 255], [0, 0, 0]]),
        (HEAD, [[100, 255, 255], [255, 0, 0]]),
        (USUAL + "mode: trinary\n", [[100, 255, 255], [255, 0, 0]]),
        (USUAL.replace("negate: 0", "negate: 1"), [[0, 255, 255], [100, 100, 100]]),
        (USUAL.replace("negate: 0", "negate: true"), [[0, 255, 255], [100, 100, 100]]),
        (USUAL + "mode: scale\n", [[100, 99, 67], [0, 0, 0]]),
        (USUAL + "mode: raw\n", [[0, 90, 255], [255, 255, 255]]),
        (USUAL.replace("0.65", "0.8"), [[100, 255, 255], [255, 0, 0]]),
        (USUAL.replace("0.65", "0.6"), [[100, 100, 255], [255, 0, 0]]),
    ],
)
def test_grays_are_read_as_by_map_servers(tmp_path: Path, text: str, wanted: list[list[int]]) -> None:
    """The rules are those of map_io.cpp in nav2_map_server."""
    assert cells(ros(tmp_path, text)) == wanted


LEVELS = np.array([[0, 128, 205, 254]], np.uint8)
DECODED = [[100, 255, 255, 0]]
CLEAR = np.full((1, 4, 1), 255, np.uint8)
COLOR = np.repeat(LEVELS[..., None], 3, axis=2)


@pytest.mark.parametrize(
    ("image", "pixels"),
    [
        ("m.pgm", LEVELS),
        ("m.png", LEVELS),
        ("m.bmp", LEVELS),
        ("m.png", LEVELS.astype(np.uint16) * 257),
        ("m.pgm", LEVELS.astype(np.uint16) * 257),
        ("m.png", COLOR),
        ("m.bmp", COLOR),
        ("m.ppm", COLOR),
    ],
)
def test_images_of_every_kind_and_depth_are_read(tmp_path: Path, image: str, pixels: Any) -> None:
    assert cells(ros(tmp_path, USUAL.replace("m.pgm", image), image, pixels)) == DECODED


@pytest.mark.parametrize("image", ["m.pgm", "m.bmp", "m.ppm"])
@pytest.mark.parametrize("width", [1, 3, 4])
def test_images_read_without_pillow_equal_those_read_with_it(tmp_path: Path, image: str, width: int) -> None:
    pixels = np.random.default_rng(width).integers(0, 256, (5, width, 3)).astype(np.uint8)
    Image.fromarray(pixels if image == "m.ppm" else pixels[..., 0]).save(tmp_path / image)
    with Image.open(tmp_path / image) as opened:
        assert np.array_equal(read_image(tmp_path / image), np.asarray(opened))
    (tmp_path / image).write_bytes((tmp_path / image).read_bytes()[:-4])
    with pytest.raises(MapFileError, match="cannot be read"):
        read_image(tmp_path / image)


def test_a_map_of_several_bands_is_read(tmp_path: Path) -> None:
    pixels = np.resize(np.arange(256, dtype=np.uint8), (1301, 1003))
    grid = MapGrid2D.load(ros(tmp_path, USUAL + "mode: raw\n", pixels=pixels))
    assert np.array_equal(grid.occupancy, np.where(pixels <= 100, pixels, UNKNOWN))
    assert np.array_equal(grid.flags, flags_of(grid.occupancy))


def test_palette_and_bilevel_images_are_read(tmp_path: Path) -> None:
    path = ros(tmp_path, USUAL.replace("m.pgm", "m.png"), "m.png", LEVELS)
    Image.fromarray(COLOR).quantize(4).save(tmp_path / "m.png")
    assert cells(path) == DECODED
    Image.fromarray(np.array([[0, 255]], np.uint8)).convert("1").save(tmp_path / "m.png")
    assert cells(path) == [[100, 0]]


def test_opacity_counts_as_in_map_servers(tmp_path: Path) -> None:
    pixels = np.concatenate((COLOR, CLEAR), axis=2)
    # (3 * 205 + 255) / 4 is bright enough to be free
    assert cells(ros(tmp_path, USUAL.replace("m.pgm", "m.png"), "m.png", pixels)) == [[100, 255, 0, 0]]
    pixels[0, 0, 3] = 0
    scale = USUAL.replace("m.pgm", "m.png") + "mode: scale\n"
    assert cells(ros(tmp_path, scale, "m.png", pixels)) == [[255, 67, 0, 0]]


@pytest.mark.parametrize(
    "content",
    [
        b"P5\n# CREATOR: map_saver 0.05 m/pix\n4 1\n255\n\x00\x80\xcd\xfe",
        b"P5 4 1 255 \x00\x80\xcd\xfe",
        b"P2\n# by hand\n4 1\n255\n0 128\n205 254\n",
        b"P5\n4 1\n65535\n\x00\x00\x80\x80\xcd\xcd\xfe\xfe",
        b"P3\n4 1 255\n0 0 0 128 128 128 205 205 205 254 254 254\n",
    ],
)
def test_every_kind_of_pgm_is_read(tmp_path: Path, content: bytes) -> None:
    path = ros(tmp_path)
    (tmp_path / "m.pgm").write_bytes(content)
    assert cells(path) == DECODED


def test_yaml_files_of_users_are_read(tmp_path: Path) -> None:
    path = ros(
        tmp_path,
        "# my map\n---\nimage: 'm.pgm'  # comment\nresolution: 5e-2\norigin:\n- -1.5\n- 2\n- 0.5\nextra: {a: [1]}\n",
    )
    grid = MapGrid2D.load(path)
    assert (grid.name, grid.resolution, grid.origin.to_ros()) == ("m", 0.05, pytest.approx((-1.5, 2.0, 0.5)))
    # as written by YARP: without commas, in degrees
    grid = MapGrid2D.load(ros(tmp_path, USUAL.replace("[-1.5, 2.0, 0.0]", "[ -1.5 2 30 ]")))
    assert grid.getOrigin() == (-1.5, 2.0, 30.0)
    path = ros(tmp_path, USUAL.replace("m.pgm", f"'{tmp_path}/m.pgm'"))
    assert cells(path) == [[100, 255, 255], [255, 0, 0]]
    assert cells(ros(tmp_path, USUAL.replace("m.pgm", "images/m.pgm"), "images/m.pgm"))[1] == [255, 0, 0]


def yarp(folder: Path, text: str) -> MapGrid2D:
    (folder / "x.map").write_text(text)
    return MapGrid2D.load(folder / "x.map")


def test_map_files_of_users_are_read(tmp_path: Path) -> None:
    ros(tmp_path)
    flags = np.array([[*COLORS.values()][:3], [(0, 0, 0), (254, 254, 254), (9, 9, 9)]], np.uint8)
    Image.fromarray(flags).save(tmp_path / "f.ppm")
    both = yarp(tmp_path, '# comment\nMapName   my map // of the house\nYarpMapData f.ppm\nRosMapData = "m.yaml"\n\n')
    assert (both.name, both.resolution, both.getOrigin()) == ("my map", 0.05, (-1.5, 2.0, 0.0))
    assert both.flags.tolist() == [[0, 1, 2], [4, 0, 5]]
    assert both.occupancy.tolist() == [[100, 65, 50], [UNKNOWN, 0, UNKNOWN]]  # as in YARP, not as by a map server
    plain = yarp(tmp_path, "MapName m\nYarpMapData f.ppm\nresolution 0.1\norigin (1 2.5, -30)\n")
    assert plain.occupancy.tolist() == [[0, 0, 0], [100, 0, UNKNOWN]]
    assert (plain.resolution, plain.getOrigin()) == (0.1, (1.0, 2.5, -30.0))
    only = yarp(tmp_path, "MapName m\nRosMapData m.yaml\n")
    assert only.flags.tolist() == [[4, 5, 5], [5, 0, 0]]
    # YARP reads the yaw of a YAML file as its theta, unchanged
    rotated = ros(tmp_path, USUAL.replace("2.0, 0.0]", "2.0, 1.5707963267948966]"))
    assert yarp(tmp_path, "MapName m\nRosMapData m.yaml\n").getOrigin() == pytest.approx((-1.5, 2.0, 90.0))
    assert MapGrid2D.load(rotated).getOrigin() != pytest.approx((-1.5, 2.0, 90.0))


def test_the_methods_of_yarp_return_whether_they_succeeded(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    grid, other = MapGrid2D.of(np.array([[1, 2, 3]], np.uint8), name="m"), MapGrid2D()
    assert grid.saveToFile(f"{tmp_path}/m.map")
    assert other.loadFromFile(f"{tmp_path}/m.map")
    assert other == grid
    assert not other.loadFromFile(f"{tmp_path}/none.map")
    assert other == grid
    assert not MapGrid2D().saveToFile(f"{tmp_path}/n.map")
    assert "No such file" in caplog.text
    assert "cannot be saved" in caplog.text


def test_collections_of_maps_are_saved_and_loaded(tmp_path: Path) -> None:
    known = np.full((3, 3), UNKNOWN, np.uint8)
    known[1, 1] = 0
    grids = {name: MapGrid2D.of(flags_of(known), known, name=name) for name in ("b", "first floor")}
    path = tmp_path / "maps_collection.ini"
    save_maps(grids, path)
    assert path.read_text() == "mapfile: b.map\nmapfile: first floor.map\n"
    assert load_maps(path, jail=tmp_path) == grids
    path.write_text("\nmapfile: first floor.map crop\n")
    assert map_files(path) == [(tmp_path / "first floor.map", True)]
    assert load_maps(path)["first floor"].getSize_in_cells() == (1, 1)
    path.write_text("mapfile: b.map\nmapfile: b.map\n")
    with pytest.raises(MapFileError, match="already has a map named 'b'"):
        load_maps(path)
    path.write_text("b.map\n")
    with pytest.raises(MapFileError, match="line 1: expected 'mapfile"):
        load_maps(path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "no keys"),
        ("- a\n", "no keys"),
        ("a: [", "is not valid YAML"),
        ("a: &a [x]\nb: *a\n", "aliases .* not allowed"),
        ("a: " + "[" * 30_000, "too deep|maximum nesting depth"),  # the second by PyYAML, from 6.0.4 on
        ("#" * 70_000, "too long"),
        (HEAD.replace("image: m.pgm\n", ""), "key image is missing"),
        (HEAD.replace("m.pgm", "[1]"), "must be a file name"),
        (HEAD.replace("0.05", "0"), "above 0"),
        (HEAD.replace("0.05", ".nan"), "resolution must be a number"),
        (HEAD.replace("0.05", "coarse"), "resolution must be a number"),
        (HEAD.replace("[-1.5, 2.0, 0.0]", "[1, 2]"), "three numbers"),
        (HEAD.replace("[-1.5, 2.0, 0.0]", "{x: 1}"), "three numbers"),
        (HEAD.replace("[-1.5, 2.0, 0.0]", "[1, 2, .inf]"), "three numbers"),
        (HEAD + "mode: best\n", "trinary, scale, raw"),
        (HEAD + "occupied_thresh: 65\n", "ascending numbers from 0 to 1"),
        (HEAD.replace("m.pgm", "other.pgm"), "No such file"),
        (HEAD.replace("m.pgm", "."), "is not a file"),
        (HEAD.replace("m.pgm", '"a\\0b"'), "is not a file name"),
        (HEAD.replace("m.pgm", "m.yaml"), "cannot be read as pgm"),
    ],
)
def test_invalid_yaml_files_are_rejected(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(MapFileError, match=reason):
        MapGrid2D.load(ros(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("RosMapData m.yaml\n", "MapName is missing"),
        ("MapName m\n", "one of the keys YarpMapData and RosMapData"),
        ("MapName m\nYarpMapData f.ppm\nRosMapData m.yaml\n", "flags are 2 x 1 cells, the occupancy 3 x 2"),
        ("MapName m\nRosMapData m.yaml\norigin (1 2)\n", "three numbers"),
        ("MapName m\nRosMapData m.yaml\nresolution nan\n", "resolution"),
        ("MapName m\nYarpMapData m16.png\n", "8-bit colors"),
    ],
)
def test_invalid_map_files_are_rejected(tmp_path: Path, text: str, reason: str) -> None:
    ros(tmp_path)
    Image.fromarray(np.zeros((1, 2, 3), np.uint8)).save(tmp_path / "f.ppm")
    Image.fromarray(np.zeros((1, 2), np.uint16)).save(tmp_path / "m16.png")
    with pytest.raises(MapFileError, match=reason):
        yarp(tmp_path, text)


def png_of(width: int, height: int) -> bytes:
    """Return a PNG file that declares this size, but contains no pixels."""
    head = struct.pack(">2I5B", width, height, 8, 0, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(b""))]
    parts = [struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def peak() -> int:
    """Return the most memory that this process has had, in bytes."""
    if resource is None:
        memory = psutil.Process().memory_info()
        return getattr(memory, "peak_wset", memory.rss)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"P5\n31623 31623\n255\n", "cells"),
        (b"P5\n1 1000000000\n255\n", "cells"),
        (b"P5\n9000 9000\n255\n", "9000 x 9000 cells is too large"),
        (b"P5\n99999999999 9\n255\n", "cannot be read"),
        (b"P2\n31623 31623\n255\n", "cells"),
        (png_of(31623, 31623), "cells"),
        (b"P5\n8000 8000\n255\nshort", "cannot be read"),
        (b"P5\n0 0\n255\n", "cannot be read"),
        (b"P5\n-4 4\n255\n", "cannot be read"),
        (b"P5\n4", "cannot be read"),
        (b"", "cannot be read"),
        (b"GIF89a\x01\x00\x01\x00", "cannot be read"),
    ],
)
def test_images_with_false_sizes_are_rejected(tmp_path: Path, content: bytes, reason: str) -> None:
    path = ros(tmp_path)
    (tmp_path / "m.pgm").write_bytes(content)
    before = peak()
    with pytest.raises(MapFileError, match=reason):
        MapGrid2D.load(path)
    assert peak() - before < 200e6


def test_files_outside_of_the_folder_are_rejected(tmp_path: Path) -> None:
    jail, away = tmp_path / "maps", tmp_path / "away"
    for folder in (jail, away):
        folder.mkdir()
        ros(folder)
    assert cells(jail / "m.yaml", jail=jail)
    for image in ("../away/m.pgm", str(away / "m.pgm"), "/dev/zero", "/etc/passwd"):
        path = ros(jail, USUAL.replace("m.pgm", image))
        with pytest.raises(MapFileError, match="is outside of"):
            MapGrid2D.load(path, jail=jail)
    (jail / "link.pgm").symlink_to(away / "m.pgm")
    with pytest.raises(MapFileError, match="is outside of"):
        MapGrid2D.load(ros(jail, USUAL.replace("m.pgm", "link.pgm")), jail=jail)
    with pytest.raises(MapFileError, match="is outside of"):
        MapGrid2D.load(away / "m.yaml", jail=jail)
    (jail / "x.map").write_text("MapName m\nRosMapData ../away/m.yaml\n")
    with pytest.raises(MapFileError, match="is outside of"):
        MapGrid2D.load(jail / "x.map", jail=jail)
    (jail / "c.ini").write_text("mapfile: ../away/x.map\n")
    with pytest.raises(MapFileError, match="is outside of"):
        load_maps(jail / "c.ini", jail=jail)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_rejected(tmp_path: Path) -> None:
    path = ros(tmp_path, USUAL.replace("m.pgm", "p.pgm"))
    os.mkfifo(tmp_path / "p.pgm")
    with pytest.raises(MapFileError, match="is not a file"):
        MapGrid2D.load(path)


@pytest.mark.parametrize("name", ["", "a/b", "../b", "a\\b", ".hidden", "a\0b", "a\nb", "x" * 201])
def test_a_map_whose_name_is_not_a_file_name_is_not_saved(tmp_path: Path, name: str) -> None:
    grid = MapGrid2D.of(np.zeros((1, 1), np.uint8), name=name)
    with pytest.raises(MapFileError, match="cannot be saved"):
        grid.save(tmp_path / "x.map")
    with pytest.raises(MapFileError, match="cannot be saved"):
        save_maps({name: grid}, tmp_path / "c.ini")
    assert not list(tmp_path.iterdir())


def test_a_failed_save_leaves_no_temporary_files(tmp_path: Path) -> None:
    grid = MapGrid2D.of(np.full((2, 2), MapFlag.KEEP_OUT), name="m")
    with pytest.raises(MapFileError, match="No such file"):
        grid.save(tmp_path / "none" / "m.map")
    (tmp_path / "m_grid.pgm").mkdir()
    with pytest.raises(MapFileError, match="directory"):
        grid.save(tmp_path / "m.map")
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]
    for wrong, reason in (
        ({"image": "gif"}, "pgm, png or bmp"),
        ({"mode": "scale"}, "png"),
        ({"mode": "x"}, "mode must be"),
    ):
        with pytest.raises(MapFileError, match=reason):
            grid.save(tmp_path / "m.yaml", **wrong)
