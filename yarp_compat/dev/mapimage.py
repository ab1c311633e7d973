"""The images of maps: pgm and ppm (binary or ascii), png, bmp, of any depth.

Pillow reads and writes them. Of those that are not packed (binary pgm and ppm, grey bmp) it reads the header alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev.mapfile import MapFileError, write
from yarp_compat.dev.mapflag import MAX_CELLS, too_large
from yarp_compat.wire.message import Buffer

_FORMATS = ("PPM", "PNG", "BMP")


def read_image(path: Path) -> NDArray[Any]:
    """An image's pixels, without copies of more than one.

    Returns:
        of shape (height, width) where they are grey, in bytes or uint16, which reaches from 0 to 65,535 then; else of
        shape (height, width, 3 or 4): red, green, blue and opacity in bytes.

    Raises:
        MapFileError: it is no such image, or too large, which is known before its pixels are read.
    """
    from PIL import Image

    try:
        with Image.open(path, formats=_FORMATS) as image:
            width, height = image.size
            pixels = _pixels(image) if width * height <= MAX_CELLS else None
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise MapFileError(f"{path}: more than {MAX_CELLS} cells: {error}") from None
    except (OSError, ValueError, SyntaxError, EOFError, MemoryError) as error:
        raise MapFileError(f"{path} cannot be read as pgm, ppm, png or bmp: {error}") from None
    if pixels is None:
        raise MapFileError(f"{path}: {too_large(width, height)}")
    return pixels


def grey_image(kind: str, pixels: NDArray[np.uint8]) -> list[Buffer]:
    """The parts of an image's file, in a kind that is ``pgm``, ``png`` or ``bmp``.

    Args:
        kind: of the file.
        pixels: greys of shape (height, width), or red, green, blue and opacity of (height, width, 4), not for pgm.
    """
    if kind == "pgm":
        return _binary(b"P5", pixels)
    import io

    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **({"compress_level": 1} if kind == "png" else {}))
    return [file.getbuffer()]


def write_greys(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write a pgm (P5).

    Raises:
        MapFileError: it cannot be written.
    """
    write(path, *_binary(b"P5", pixels))


def write_colours(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write a ppm (P6) of shape (height, width, 3).

    Raises:
        MapFileError: it cannot be written.
    """
    write(path, *_binary(b"P6", pixels))


def _binary(magic: bytes, pixels: NDArray[np.uint8]) -> list[Buffer]:
    return [b"%b\n%d %d\n255\n" % (magic, pixels.shape[1], pixels.shape[0]), np.ascontiguousarray(pixels).data]


def _uncoded(image: Any) -> NDArray[np.uint8] | None:
    """The bytes of an image that stand in its file as they are, without Pillow's copies; None of any other."""
    if len(image.tile) != 1 or image.mode not in ("L", "RGB"):
        return None
    coding, _, offset, said = image.tile[0]
    if coding != "raw":
        return None
    mode, stride, direction = (said, 0, 1) if isinstance(said, str) else said
    if mode != image.mode:
        return None
    width, height = image.size
    length = width * len(mode)
    rows = np.empty((height, stride or length), np.uint8)
    image.fp.seek(offset)
    if image.fp.readinto(rows.data) != rows.size:
        return None  # Pillow says what is missing
    pixels = rows[::direction, :length]
    return pixels if mode == "L" else pixels.reshape(height, width, 3)


def _pixels(image: Any) -> NDArray[Any]:
    uncoded = _uncoded(image)
    if uncoded is not None:
        return uncoded
    mode = image.mode
    if mode in ("I", "I;16", "I;16B", "I;16L"):
        deep: NDArray[Any] = np.clip(np.asarray(image), 0, 65535).astype(np.uint16)
        return deep
    if "transparency" in image.info or mode in ("LA", "PA"):
        image = image.convert("RGBA")
    elif mode == "1":
        image = image.convert("L")
    elif mode not in ("L", "RGB", "RGBA"):
        image = image.convert("RGB")
    pixels: NDArray[Any] = np.asarray(image)
    return pixels
