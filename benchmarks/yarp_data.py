"""YARP's typed data to bytes and back, compared with a bare copy of the same bytes, in one process, in turns.

Each kind is compared with one copy; its limit is one and a half copies plus 10 microseconds. Each figure is the time of
one conversion, as the median over the rounds. A decoded value is a view into its payload; the row "decoded and owned"
includes the copy that the value's first change causes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

if not __package__:  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.rows import Row, add_json_option, report
from benchmarks.transcode import compare
from bridge.adapters.memory import keep_memory
from yarp_compat.dev.rangefinder import LaserScan2D
from yarp_compat.sig.image import FlexImage, Image, ImageFloat, ImageMono, ImageRgb
from yarp_compat.sig.matrix import Matrix
from yarp_compat.sig.pointcloud import LAYOUTS, PointCloud, PointType
from yarp_compat.sig.sound import Sound
from yarp_compat.sig.vector import Vector, VectorFloat, VectorInt
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile

ALLOWED_COPIES = 1.5
ALLOWED_US = 10.0


def image(kind: type[Image], width: int, height: int) -> Image:
    """Return an image with rows padded as in YARP."""
    result = kind()
    result.resize(width, height)
    result.getRawImage()[:] = np.arange(result.getRawImageSize()) % 256
    return result


def numbers(count: int) -> NDArray[np.float64]:
    """Return numbers with many digits."""
    return np.arange(count) / 7


CASES: Mapping[str, Callable[[], Portable]] = {
    "Vector of 10": lambda: Vector.of(numbers(10)),
    "Vector of 1,000": lambda: Vector.of(numbers(1_000)),
    "Vector of 100,000": lambda: Vector.of(numbers(100_000)),
    "VectorInt of 1,000": lambda: VectorInt(list(range(1_000))),
    "VectorFloat of 1,000": lambda: VectorFloat(numbers(1_000)),
    "Matrix 6x6": lambda: Matrix(numbers(36).reshape(6, 6)),
    "LaserScan2D of 1,080": lambda: LaserScan2D(0, 360, 0.1, 30, Vector.of(numbers(1_080)), 1),
    "ImageMono 320x240": lambda: image(ImageMono, 320, 240),
    "ImageRgb 640x480": lambda: image(ImageRgb, 640, 480),
    "ImageFloat 640x480": lambda: image(ImageFloat, 640, 480),
    "ImageRgb 1920x1080": lambda: image(ImageRgb, 1920, 1080),
    "PointCloud of 65,536": lambda: PointCloud.of(np.zeros(65_536, LAYOUTS[PointType.XYZ])),
    "Sound of a second": lambda: Sound.of(np.arange(44_100, dtype=np.int16), 44_100),
}


def measure(case: str, value: Portable, rounds: int) -> list[Row]:
    """Measure one value, and return the rows."""
    payload = value.to_bytes(Profile.YARP3)
    source = bytearray(payload)
    kind = FlexImage if isinstance(value, Image) else type(value)

    def owned() -> object:
        copy_ = kind.from_bytes(payload, Profile.YARP3)
        if isinstance(copy_, Image | Vector):
            copy_._writable()
        return copy_

    conversions: dict[str, Callable[[], object]] = {
        "encoded": lambda: value.to_bytes(Profile.YARP3),
        "decoded": lambda: kind.from_bytes(payload, Profile.YARP3),
        "decoded, dialect unknown": lambda: kind.from_bytes(payload),
        "decoded and owned": owned,
    }
    rows = []
    for conversion, call in conversions.items():
        ours, copy = compare(call, lambda: bytes(source), rounds)
        rows.append(Row(f"{case}, {conversion}, bare copy", ours, copy, "us"))
        rows.append(Row(f"{case}, {conversion}, allowance", ours, ALLOWED_COPIES * copy + ALLOWED_US, "us"))
    return rows


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=9, help="rounds of each comparison (default 9)")
    add_json_option(parser)
    options = parser.parse_args(arguments)
    keep_memory()  # as in the workers; otherwise both cause page faults in turn
    report([row for case, make in CASES.items() for row in measure(case, make(), options.rounds)], options.json)


if __name__ == "__main__":
    main()
