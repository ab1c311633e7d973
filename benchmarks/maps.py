"""Loading, saving and encoding maps, compared with the bare image or a bare copy, in one process, in turns.

Map files are compared with reading or writing their images with Pillow, from and to NumPy arrays; YARP has two images
(flags and occupancy), ROS has one. Bytes are compared with a copy of the map's two arrays, zipped bytes with zlib on
these. Each figure is the median over the rounds of one call's time. The limits are 3 times Pillow, and 1.5 copies.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import zlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import Row, add_json_option, report
from benchmarks.transcode import compare
from bridge.adapters.memory import keep_memory
from bridge.messages.registry import Registry
from bridge.messages.values import MessageReader
from navigation.maps.grid import from_grid, to_cdr
from yarp_compat.dev.mapflag import UNKNOWN, MapFlag, occupancy_of, picture_of_flags
from yarp_compat.dev.mapgrid import MapGrid2D
from yarp_compat.wire.profile import Profile

GRID = "nav_msgs/msg/OccupancyGrid"

Pair = tuple[Callable[[], object], Callable[[], object]]


def office(size: int) -> MapGrid2D:
    """Return a map of rooms of 80 cells, some unknown or keep-out, with scattered obstacles and gray cells."""
    dice = np.random.default_rng(7)
    rooms = dice.choice([0, 0, 0, 0, 0, 1, 5, 5], (size // 80 + 1, size // 80 + 1)).astype(np.uint8)
    cells = np.repeat(np.repeat(rooms, 80, axis=0), 80, axis=1)[:size, :size]
    flags = np.ascontiguousarray(cells)  # like maps from files and from the wire
    flags[::80] = flags[:, ::80] = MapFlag.WALL
    flags[40::80] = flags[:, 40::80] = MapFlag.FREE
    spots = dice.integers(0, size, (2, size * size // 200))
    flags[spots[0], spots[1]] = dice.integers(0, 6, spots.shape[1])
    occupancy = occupancy_of(flags)
    spots = dice.integers(0, size, (2, size * size // 100))
    gray = occupancy[spots[0], spots[1]] == 0
    occupancy[spots[0][gray], spots[1][gray]] = dice.integers(1, 50, int(gray.sum()))
    assert (occupancy == UNKNOWN).any()
    return MapGrid2D.of(flags, occupancy, name="office", resolution=0.05, origin=(-10.0, -10.0, 0.0))


def files(grid: MapGrid2D, folder: Path) -> dict[str, Pair]:
    """Return the pairs for loading and saving."""
    plain = folder / "plain"
    plain.mkdir()
    grid.save(folder / "office.map")
    colors, pairs = picture_of_flags(grid.flags), dict[str, Pair]()
    grays = read(folder / "office_grid.pgm")
    assert MapGrid2D.load(folder / "office.map") == grid
    pairs["load .map"] = (
        lambda: MapGrid2D.load(folder / "office.map"),
        lambda: (read(folder / "office_grid.pgm"), read(folder / "office_yarpflags.ppm")),
    )
    pairs["save .map"] = (
        lambda: grid.save(folder / "office.map"),
        lambda: [write(*image) for image in ((plain / "g.pgm", grays), (plain / "f.ppm", colors))],
    )
    for kind in ("pgm", "png", "bmp"):
        (folder / kind).mkdir()
        path, image = folder / kind / "office.yaml", folder / kind / f"office.{kind}"
        grid.save(path, image=kind)
        assert (MapGrid2D.load(path).occupancy == grid.occupancy).all()
        pixels = read(image)
        pairs[f"load yaml and {kind}"] = partial(MapGrid2D.load, path), partial(read, image)
        pairs[f"save yaml and {kind}"] = (
            partial(grid.save, path, image=kind),
            partial(write, plain / f"g.{kind}", pixels),
        )
    trinary = folder / "trinary.yaml"  # like most maps; the other files are raw, for the gray cells
    grid.save(trinary, mode="trinary")
    pairs["load yaml and pgm, trinary"] = partial(MapGrid2D.load, trinary), partial(read, folder / "trinary.pgm")
    return pairs


def read(path: Path) -> Any:
    """Read an image's pixels with Pillow."""
    with Image.open(path) as image:
        return np.array(image)


def write(path: Path, pixels: Any) -> Path:
    """Write an image with Pillow, PNG at Midspan's compression level."""
    options: dict[str, Any] = {"compress_level": 1} if path.suffix == ".png" else {}
    Image.fromarray(pixels).save(path, **options)
    return path


def payloads(grid: MapGrid2D) -> dict[str, Pair]:
    """Return the pairs for encoding and decoding."""
    registry = Registry()
    schema = registry.schema(GRID)
    zipped, plain = grid.copy(), grid.copy()
    plain.enable_map_compression_over_network(False)
    wire, packed, cdr = (
        plain.to_bytes(Profile.YARP4),
        zipped.to_bytes(Profile.YARP4),
        bytes(to_cdr(grid)),
    )
    assert MapGrid2D.from_bytes(wire, Profile.YARP4) == grid
    assert (from_grid(MessageReader(schema, cdr).message(), "office").occupancy == grid.occupancy).all()
    source = [bytes(grid.occupancy.data), bytes(grid.flags.data)]
    deflated = [zlib.compress(cells) for cells in source]

    def copy() -> object:
        return [bytearray(cells) for cells in source]

    return {
        "to YARP, pieces": (lambda: plain.to_wire(Profile.YARP4), copy),
        "to YARP, one piece": (lambda: plain.to_bytes(Profile.YARP4), copy),
        "from YARP": (lambda: MapGrid2D.from_bytes(wire, Profile.YARP4), copy),
        "to YARP, zipped": (lambda: zipped.to_bytes(Profile.YARP4), lambda: [zlib.compress(cells) for cells in source]),
        "from YARP, zipped": (
            lambda: MapGrid2D.from_bytes(packed, Profile.YARP4),
            lambda: [zlib.decompress(cells) for cells in deflated],
        ),
        "to CDR": (lambda: to_cdr(grid), copy),
        "from CDR": (lambda: from_grid(MessageReader(schema, cdr).message(), "office"), copy),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, help="rounds of each comparison (default 7)")
    parser.add_argument(
        "--sizes", type=int, nargs="+", default=[1000, 4000], help="cells along a side (default: 1000 4000)"
    )
    add_json_option(parser)
    options = parser.parse_args(arguments)
    keep_memory()  # as in the workers; otherwise both cause page faults in turn
    rows = []
    for size in options.sizes:
        grid = office(size)
        with tempfile.TemporaryDirectory() as folder:
            pairs = {**files(grid, Path(folder)), **payloads(grid)}
            for case, calls in pairs.items():
                ours, peer = compare(*calls, options.rounds)
                rows.append(Row(f"{size}, {case}", ours / 1000, peer / 1000, "ms"))
    report(rows, options.json)


if __name__ == "__main__":
    main()
