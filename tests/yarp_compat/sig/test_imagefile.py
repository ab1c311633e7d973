"""Images and sounds in files."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import yarp_compat as yarp
from yarp_compat.sig import png

COLORS = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
GRAY = COLORS[:, :, 0].copy()
FLOATS = np.linspace(-1, 1, 15, dtype=np.float32).reshape(5, 3)


@pytest.mark.parametrize(
    ("image", "pixels", "name", "form"),
    [
        (yarp.ImageRgb, COLORS, "a.ppm", None),
        (yarp.ImageRgb, COLORS, "a.png", yarp.FORMAT_PNG),
        (yarp.ImageBgr, COLORS, "a.ppm", yarp.FORMAT_PPM),
        (yarp.ImageMono, GRAY, "a.pgm", None),
        (yarp.ImageMono, GRAY, "a.png", yarp.FORMAT_PNG),
        (yarp.ImageFloat, FLOATS, "a.float", None),
        (yarp.ImageFloat, FLOATS, "a.floatzip", yarp.FORMAT_NUMERIC_COMPRESSED),
    ],
)
def test_images_survive_a_file(tmp_path: Path, image: Any, pixels: NDArray[Any], name: str, form: int | None) -> None:
    path = str(tmp_path / name)
    written, read = image.of(pixels), image()
    assert yarp.write(written, path) if form is None else yarp.write(written, path, form)
    assert yarp.read(read, path)
    assert np.array_equal(read.numpy(), pixels)


def test_files_have_the_bytes_of_yarps_formats(tmp_path: Path) -> None:
    """The bytes that `ImageFile.cpp` of 3.9.1 to 4.0 writes."""
    assert yarp.write(yarp.ImageRgb.of(COLORS), str(tmp_path / "a.ppm"))
    assert (tmp_path / "a.ppm").read_bytes() == b"P6\n7 5\n255\n" + COLORS.tobytes()
    assert yarp.write(yarp.ImageMono.of(GRAY), str(tmp_path / "a.pgm"))
    assert (tmp_path / "a.pgm").read_bytes() == b"P5\n7 5\n255\n" + GRAY.tobytes()
    assert yarp.write(yarp.ImageFloat.of(FLOATS), str(tmp_path / "a.float"))
    assert (tmp_path / "a.float").read_bytes() == struct.pack("<QQ", 5, 3) + FLOATS.tobytes()
    assert yarp.write(yarp.ImageFloat.of(FLOATS), str(tmp_path / "a.floatzip"), yarp.FORMAT_NUMERIC_COMPRESSED)
    packed = (tmp_path / "a.floatzip").read_bytes()
    assert np.frombuffer(zlib.decompress(packed[16:]), "<f4").reshape(5, 4)[:, :3].tolist() == FLOATS.tolist()


def test_files_of_other_programs_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.ppm").write_bytes(b"P6\n# by hand\n2 1 255\n" + bytes(range(6)))
    image, gray = yarp.ImageRgb(), yarp.ImageMono()
    assert yarp.read(image, str(tmp_path / "a.ppm"))
    assert image.getPixel(1, 0) == (3, 4, 5)
    assert yarp.read(gray, str(tmp_path / "a.ppm"))
    (tmp_path / "b").write_bytes((tmp_path / "a.ppm").read_bytes())
    assert yarp.read(image, str(tmp_path / "b"), yarp.FORMAT_PPM)


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("a.ppm", b"P6\n2 2\n255\n123", "need 12 bytes"),
        ("a.ppm", b"P3\n2 2\n255\n1 2 3", "not a binary PGM or PPM"),
        ("a.ppm", b"P6\n2 2\n65535\n123", "not a binary PGM or PPM"),
        ("a.png", b"GIF89a", "not a PNG file"),
        ("a.png", png.write(GRAY)[:40], "truncated"),
        ("a.jpg", b"", "JPEG is not supported"),
        ("a.txt", b"", "unknown format (suffix '.txt')"),
        ("a.float", b"1", "numbers of rows and columns are missing"),
        ("a.float", struct.pack("<QQf", 1, 1, 1.0), "cannot convert its pixels to ImageRgb"),
    ],
)
def test_invalid_files_are_not_read(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str, data: bytes, reason: str
) -> None:
    (tmp_path / name).write_bytes(data)
    assert not yarp.read(yarp.ImageRgb(), str(tmp_path / name))
    assert reason in caplog.text


def test_unsupported_formats_are_not_written(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert not yarp.write(yarp.ImageRgb.of(COLORS), str(tmp_path / "a.jpg"), yarp.FORMAT_JPG)
    assert not yarp.write(yarp.ImageFloat.of(FLOATS), str(tmp_path / "a.ppm"), yarp.FORMAT_PPM)
    assert not yarp.write(yarp.ImageRgb.of(COLORS), str(tmp_path / "no" / "a.ppm"))
    assert "JPEG" in caplog.text
    assert "cannot write an image of floats as FORMAT_PPM" in caplog.text
    assert list(tmp_path.iterdir()) == []


def filtered(kind: int, row: bytes, above: bytes, step: int) -> bytes:
    """Apply a PNG filter to a row."""
    out = bytearray([kind])
    for at, value in enumerate(row):
        left, corner = (row[at - step], above[at - step]) if at >= step else (0, 0)
        wanted = left + above[at] - corner
        near = min((left, above[at], corner), key=lambda value: abs(wanted - value))
        out.append(value - (0, left, above[at], (left + above[at]) // 2, near)[kind] & 255)
    return bytes(out)


@pytest.mark.parametrize("kind", range(5))
def test_every_filter_of_png_is_decoded(kind: int) -> None:
    rows = [row.tobytes() for row in np.random.default_rng(kind).integers(0, 256, (6, 15), np.uint8)]
    packed = b"".join(filtered(kind, row, above, 3) for row, above in zip(rows, [bytes(15), *rows], strict=False))
    plain = png.write(np.zeros((6, 5, 3), np.uint8))
    end = plain.index(b"IDAT") - 4
    data = zlib.compress(packed)
    file = plain[:end] + struct.pack(">I", len(data)) + b"IDAT" + data + b"    " + plain[-12:]
    assert png.read(file).tobytes() == b"".join(rows)


def test_sounds_survive_a_file(tmp_path: Path) -> None:
    sound = yarp.Sound.of(np.array([[1, -2, 3], [4, 5, -32768]]), 16000)
    path = str(tmp_path / "a.wav")
    assert yarp.write(sound, path)
    read, again, data = yarp.Sound(), yarp.Sound(), bytearray()
    assert yarp.read(read, path)
    assert read == sound
    assert yarp.write_bytestream(sound, data)
    assert yarp.read_bytestream(again, data, len(data), ".wav")
    assert again == sound
    assert not yarp.read(read, str(tmp_path / "b.wav"))
