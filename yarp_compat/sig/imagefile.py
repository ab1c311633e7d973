"""Image and sound files: ``yarp.read(image, "a.ppm")``, ``yarp.write(image, "a.png", yarp.FORMAT_PNG)``.

The formats are those of `yarp/sig/ImageFile.h`: binary PGM and PPM with a maximum value of 255, PNG, and files of
floats: the numbers of rows and columns in eight bytes each, then the values, either plain, or with their padding and
compressed with zlib. JPEG is not supported. A file whose pixels differ from the image's is converted, while YARP
refuses it; but floats are not converted to or from other pixels. YARP corrupts plain files of floats with an odd number
of columns; this module writes them as YARP reads them. Sounds are WAV files with two bytes per sample.

On failure the functions log the reason and return False.
"""

from __future__ import annotations

import io
import logging
import re
import struct
import wave
import zlib
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yarp_compat.sig import png
from yarp_compat.sig.image import QUANTUM, Image, ImageFloat, ImageMono, ImageRgb, padded
from yarp_compat.sig.pixels import PixelCode
from yarp_compat.sig.sound import Sound

log = logging.getLogger("yarp.sig.ImageFile")

_SIZES = struct.Struct("<QQ")
_PXM = re.compile(rb"P([56])(?:\s|#[^\n]*\n)+(\d{1,6})(?:\s|#[^\n]*\n)+(\d{1,6})(?:\s|#[^\n]*\n)+(\d{1,6})\s")
_ZIPPED = 1 << 28  # maximum bytes of floats in a compressed file


class ImageFileFormat(IntEnum):
    """The formats of image files."""

    FORMAT_NULL = 0
    FORMAT_ANY = 1
    FORMAT_PGM = 2
    FORMAT_PPM = 3
    FORMAT_JPG = 4
    FORMAT_NUMERIC = 5
    FORMAT_NUMERIC_COMPRESSED = 6
    FORMAT_PNG = 7


_F = ImageFileFormat
_SUFFIXES = {
    ".pgm": _F.FORMAT_PGM, ".ppm": _F.FORMAT_PPM, ".png": _F.FORMAT_PNG, ".jpg": _F.FORMAT_JPG, ".jpeg": _F.FORMAT_JPG,
    ".float": _F.FORMAT_NUMERIC, ".floatzip": _F.FORMAT_NUMERIC_COMPRESSED,
}  # fmt: skip
_NO_JPEG = "JPEG is not supported; use PNG, or PIL.Image and setExternal"


def read(dest: Image | Sound, src: str, format: int | str = _F.FORMAT_ANY) -> bool:  # noqa: A002 - YARP's name
    """Read a file into ``dest``; the suffix selects the format, or else ``format`` does."""
    if isinstance(dest, Sound):
        return _done(lambda: _read_wave(dest, Path(src).read_bytes()), src)

    def load() -> None:
        suffix = Path(src).suffix
        kind = _SUFFIXES.get(suffix) or _F(int(format))
        reader = _READERS.get(kind)
        if reader is None:
            raise ValueError(_NO_JPEG if kind == _F.FORMAT_JPG else f"unknown format (suffix {suffix!r})")
        _become(dest, reader(Path(src).read_bytes()))

    return _done(load, src)


def write(src: Image | Sound, dest: str, format: int | None = None) -> bool:  # noqa: A002 - YARP's name
    """Write a file, by default PGM for gray, PPM for color, and numbers for floats."""
    if isinstance(src, Sound):
        return _done(lambda: Path(dest).write_bytes(_wave_of(src)), dest)

    def save() -> None:
        gray, floats = src.getPixelCode() == PixelCode.MONO, src.getPixelCode() == PixelCode.MONO_FLOAT
        default = _F.FORMAT_PGM if gray else _F.FORMAT_NUMERIC if floats else _F.FORMAT_PPM
        kind = default if format is None else _F(format)
        kinds = {default, *((_F.FORMAT_NUMERIC_COMPRESSED,) if floats else (_F.FORMAT_PNG,))}
        if kind not in kinds:
            of = "floats" if floats else "gray" if gray else "color"
            reason = _NO_JPEG if kind == _F.FORMAT_JPG else f"cannot write an image of {of} as {kind.name}"
            raise ValueError(reason)
        image = src if gray or floats else ImageRgb()
        if image is not src:
            image.copy(src)
        Path(dest).write_bytes(_WRITERS[kind](image.numpy()))

    return _done(save, dest)


def read_bytestream(data: Sound, bytestream: bytes, streamsize: int, format: str = ".wav") -> bool:  # noqa: A002, ARG001
    """Read the sound from a WAV file's first ``streamsize`` bytes."""
    return _done(lambda: _read_wave(data, bytes(bytestream[:streamsize])), "the bytes")


def write_bytestream(data: Sound, bytestream: bytearray, *_: object) -> bool:
    """Replace a bytearray's content by the sound's WAV file."""

    def save() -> None:
        bytestream[:] = _wave_of(data)

    return _done(save, "the bytes")


def _done(action: Callable[[], object], name: str) -> bool:
    try:
        action()
    except (OSError, ValueError, EOFError, wave.Error) as error:
        log.error("%s: %s", name, error)
        return False
    return True


def _become(dest: Image, pixels: NDArray[Any]) -> None:
    kind = ImageFloat if pixels.dtype.kind == "f" else ImageMono if pixels.ndim == 2 else ImageRgb
    source = kind()
    source._fill(pixels)
    if (kind is ImageFloat) != (dest.code == PixelCode.MONO_FLOAT) and dest.code != PixelCode.INVALID:
        raise ValueError(f"cannot convert its pixels to {type(dest).__name__}")
    dest.copy(source)


def _read_pxm(data: bytes) -> NDArray[np.uint8]:
    header = _PXM.match(data)
    if header is None or int(header[4]) != 255:
        raise ValueError("not a binary PGM or PPM file whose maximum value is 255")
    width, height, channels = int(header[2]), int(header[3]), 3 if header[1] == b"6" else 1
    size = width * height * channels
    if len(data) - header.end() < size:
        raise ValueError(f"{width} x {height} pixels need {size} bytes, not {len(data) - header.end()}")
    values = np.frombuffer(data, np.uint8, size, header.end())
    return values.reshape((height, width, 3) if channels == 3 else (height, width))


def _write_pxm(pixels: NDArray[np.uint8]) -> bytes:
    height, width = pixels.shape[:2]
    return b"P%d\n%d %d\n255\n" % (5 if pixels.ndim == 2 else 6, width, height) + pixels.tobytes()


def _sizes(data: bytes) -> tuple[int, int]:
    if len(data) < _SIZES.size:
        raise ValueError("the numbers of rows and columns are missing")
    height, width = _SIZES.unpack_from(data)
    if height * padded(width * 4, QUANTUM) > _ZIPPED:
        raise ValueError(f"{width} x {height} floats are more than {_ZIPPED} bytes")
    return height, width


def _read_floats(data: bytes) -> NDArray[Any]:
    height, width = _sizes(data)
    if len(data) - _SIZES.size < height * width * 4:
        raise ValueError(f"it has fewer than {width} x {height} floats")
    return np.frombuffer(data, "<f4", height * width, _SIZES.size).reshape(height, width)


def _write_floats(pixels: NDArray[Any]) -> bytes:
    return _SIZES.pack(*pixels.shape) + pixels.astype("<f4").tobytes()


def _read_zipped(data: bytes) -> NDArray[Any]:
    height, width = _sizes(data)
    row = padded(width * 4, QUANTUM)
    try:
        opened = zlib.decompressobj().decompress(data[_SIZES.size :], height * row or 1)
    except zlib.error as error:
        raise ValueError(f"cannot decompress its floats: {error}") from None
    if len(opened) < height * row:
        raise ValueError(f"it has fewer than {width} x {height} floats")
    return np.frombuffer(opened, "<f4").reshape(height, -1)[:, :width]


def _write_zipped(pixels: NDArray[Any]) -> bytes:
    height, width = pixels.shape
    rows = np.zeros((height, padded(width * 4, QUANTUM) // 4), "<f4")
    rows[:, :width] = pixels
    return _SIZES.pack(height, width) + zlib.compress(rows.tobytes())


def _read_wave(sound: Sound, data: bytes) -> None:
    with wave.open(io.BytesIO(data)) as file:
        if file.getsampwidth() != 2:
            raise ValueError(f"its samples have {file.getsampwidth()} bytes, not 2")
        values = np.frombuffer(file.readframes(file.getnframes()), "<i2")
        channels = file.getnchannels()
        sound._become(Sound.of(values.reshape(-1, channels).T, file.getframerate()))


def _wave_of(sound: Sound) -> bytes:
    out = io.BytesIO()
    with wave.open(out, "wb") as file:
        file.setparams((max(sound.getChannels(), 1), 2, sound.getFrequency() or 1, 0, "NONE", ""))
        file.writeframes(sound.numpy().T.astype("<i2").tobytes())
    return out.getvalue()


_READERS: dict[ImageFileFormat, Callable[[bytes], NDArray[Any]]] = {
    _F.FORMAT_PGM: _read_pxm,
    _F.FORMAT_PPM: _read_pxm,
    _F.FORMAT_PNG: png.read,
    _F.FORMAT_NUMERIC: _read_floats,
    _F.FORMAT_NUMERIC_COMPRESSED: _read_zipped,
}
_WRITERS: dict[ImageFileFormat, Callable[[NDArray[Any]], bytes]] = {
    _F.FORMAT_PGM: _write_pxm,
    _F.FORMAT_PPM: _write_pxm,
    _F.FORMAT_PNG: png.write,
    _F.FORMAT_NUMERIC: _write_floats,
    _F.FORMAT_NUMERIC_COMPRESSED: _write_zipped,
}
