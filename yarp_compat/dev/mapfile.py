"""Files of maps and places from untrusted sources: restricted to a folder, limited in size, written atomically.

Images of maps are pgm and ppm (binary or ascii), png and bmp, of any depth. Pillow reads them (of uncompressed images,
such as binary pgm and ppm or gray bmp, only the header), and writes png and bmp.
"""

from __future__ import annotations

import os
import re
import stat
import threading
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from yarp_compat.dev.mapflag import MAX_CELLS, too_large
from yarp_compat.file_names import forbidden
from yarp_compat.wire.framing import Buffer

LONGEST_TEXT = 1 << 22  # bytes; longer text files are rejected

_NO_FILE_NAME = re.compile(r"^$|^\.|[/\\\x00-\x1f\x7f]")


class MapFileError(ValueError):
    """Raised for a missing, unreadable, forbidden or invalid file; the text names the file and the reason."""


def resolve(name: str | os.PathLike[str], base: Path, jail: Path | None) -> Path:
    """Return the path of a file, absolute or relative to ``base``; with a ``jail`` it must be in that folder.

    Raises `MapFileError` if it is outside of the jail, even through links, or not a regular file.
    """
    if "\0" in os.fspath(name):
        raise MapFileError(f"{os.fspath(name)!r:.100} is not a file name")
    path = (base / name).resolve()
    if jail is not None and not path.is_relative_to(jail.resolve()):
        raise MapFileError(f"{os.fspath(name)!r:.100} is outside of {jail}: only files in that folder can be read")
    try:
        kind = path.stat().st_mode
    except OSError as error:
        raise MapFileError(f"{path}: {error.strerror}") from None
    if not stat.S_ISREG(kind):
        raise MapFileError(f"{path} is not a file")
    return path


def read_text(path: Path) -> str:
    """Read a text file, with surrogate escapes for bytes other than UTF-8.

    Raises `MapFileError` if the file cannot be read, or is too long.
    """
    try:
        with path.open("rb") as file:
            data = file.read(LONGEST_TEXT + 1)
    except OSError as error:
        raise MapFileError(f"{path}: {error.strerror}") from None
    if len(data) > LONGEST_TEXT:
        raise MapFileError(f"{path} is longer than {LONGEST_TEXT} bytes")
    return data.decode("utf-8-sig", "surrogateescape")


class TextFile(ABC):
    """The content of a text file of maps and places."""

    @classmethod
    @abstractmethod
    def from_text(cls, text: str, source: str = "the file") -> Self:
        """Parse a file's text; errors name the file ``source``. Raises `MapFileError` for an invalid line."""

    @abstractmethod
    def to_text(self) -> str:
        """Return the text of a file, sorted by name."""

    @classmethod
    def load(cls, path: str | Path, jail: Path | None = None) -> Self:
        """Read a file, only from the folder ``jail`` if given; raises `MapFileError` if it is missing or invalid."""
        file = resolve(path, Path(), jail)
        return cls.from_text(read_text(file), str(file))

    def save(self, path: str | Path) -> None:
        """Write a file; raises `MapFileError` on failure."""
        write(Path(path), self.to_text())


def file_name(name: str) -> str:
    """Return a map's name if it can be part of a file name; raises `MapFileError` otherwise."""
    if reason := forbidden(name):
        raise MapFileError(f"a map named {name!r:.100} cannot be saved: its files have its name, which {reason}")
    if _NO_FILE_NAME.search(name) or len(name.encode("utf-8", "surrogateescape")) > 200:
        raise MapFileError(
            f"a map named {name!r:.100} cannot be saved: its files have its name, which must have up to 200 bytes, no "
            "slash, and no leading dot"
        )
    return name


def write(path: Path, *content: Buffer | str) -> None:
    """Write a file atomically; raises `MapFileError` on failure."""
    if reason := forbidden(path.name):
        raise MapFileError(f"{path} {reason}")
    fresh = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.new")
    data = [part.encode("utf-8", "surrogateescape") if isinstance(part, str) else part for part in content]
    try:
        try:
            with fresh.open("wb") as file:
                file.writelines(data)
            fresh.replace(path)
        finally:
            fresh.unlink(missing_ok=True)
    except OSError as error:
        raise MapFileError(f"{path}: {error.strerror}") from None


def decimal(number: float) -> str:
    """Format a number without an exponent, which some YAML readers parse as text; the value is preserved exactly."""
    return np.format_float_positional(number, trim="0")


_FORMATS = ("PPM", "PNG", "BMP")


def read_image(path: Path) -> NDArray[Any]:
    """Read an image's pixels, with at most one copy; raises `MapFileError`; rejects a too large image unread.

    Gray images have the shape (height, width), in uint8, or in uint16 with the full range 0 to 65,535; color images
    (height, width, 3 or 4): red, green, blue and opacity in uint8.
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


def gray_image(kind: str, pixels: NDArray[np.uint8]) -> list[Buffer]:
    """Return the parts of an image file of the kind ``pgm``, ``png`` or ``bmp``.

    The pixels are gray, (height, width), or, except for pgm, red, green, blue and opacity, (height, width, 4).
    """
    if kind == "pgm":
        return _binary(b"P5", pixels)
    import io

    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **({"compress_level": 1} if kind == "png" else {}))
    return [file.getbuffer()]


def write_grays(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write a pgm (P5); raises `MapFileError`."""
    write(path, *_binary(b"P5", pixels))


def write_colors(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write a ppm (P6) of shape (height, width, 3); raises `MapFileError`."""
    write(path, *_binary(b"P6", pixels))


def _binary(magic: bytes, pixels: NDArray[np.uint8]) -> list[Buffer]:
    return [b"%b\n%d %d\n255\n" % (magic, pixels.shape[1], pixels.shape[0]), np.ascontiguousarray(pixels).data]


def _uncoded(image: Any) -> NDArray[np.uint8] | None:
    """Return the pixels of an uncompressed image from its file, without Pillow's copies; None for another image."""
    if len(image.tile) != 1 or image.mode not in ("L", "RGB"):
        return None
    coding, _, offset, parameters = image.tile[0]
    if coding != "raw":
        return None
    mode, stride, direction = (parameters, 0, 1) if isinstance(parameters, str) else parameters
    if mode != image.mode:
        return None
    width, height = image.size
    length = width * len(mode)
    rows = np.empty((height, stride or length), np.uint8)
    image.fp.seek(offset)
    if image.fp.readinto(rows.data) != rows.size:
        return None  # Pillow reports what is missing
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
