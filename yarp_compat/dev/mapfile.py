"""Files of maps and places that come from anywhere: found where they may be, read up to a size, written at once."""

from __future__ import annotations

import os
import re
import stat
import threading
from pathlib import Path

import numpy as np

from yarp_compat.wire.message import Buffer

LONGEST_TEXT = 1 << 22
"""A text file of more bytes is refused."""

_NO_FILE_NAME = re.compile(r"^$|^\.|[/\\\x00-\x1f\x7f]")


class MapFileError(ValueError):
    """A file that is not there, may not be read or is not what it should be; the text says which, what and why."""


def found(name: str | os.PathLike[str], beside: Path, jail: Path | None) -> Path:
    """The file of a name, which may be absolute or relative.

    Args:
        name: as another file says it.
        beside: the folder that relative names begin at.
        jail: the folder that it must be in, whatever links there are; by default it may be anywhere.

    Raises:
        MapFileError: it is outside of the jail, or no file.
    """
    if "\0" in os.fspath(name):
        raise MapFileError(f"{os.fspath(name)!r:.100} is no file's name")
    path = (beside / name).resolve()
    if jail is not None and not path.is_relative_to(jail.resolve()):
        raise MapFileError(f"{os.fspath(name)!r:.100} is outside of {jail}: only files in that folder are read")
    try:
        kind = path.stat().st_mode
    except OSError as error:
        raise MapFileError(f"{path}: {error.strerror}") from None
    if not stat.S_ISREG(kind):
        raise MapFileError(f"{path} is no file")
    return path


def read_text(path: Path) -> str:
    """A text file's content; bytes that are no UTF-8 stay as surrogate escapes.

    Raises:
        MapFileError: it cannot be read, or is too long.
    """
    try:
        with path.open("rb") as file:
            data = file.read(LONGEST_TEXT + 1)
    except OSError as error:
        raise MapFileError(f"{path}: {error.strerror}") from None
    if len(data) > LONGEST_TEXT:
        raise MapFileError(f"{path} is longer than {LONGEST_TEXT} bytes")
    return data.decode("utf-8-sig", "surrogateescape")


def file_name(name: str) -> str:
    """A map's name, if it can be a part of a file's name.

    Raises:
        MapFileError: it cannot.
    """
    if _NO_FILE_NAME.search(name) or len(name.encode("utf-8", "surrogateescape")) > 200:
        raise MapFileError(
            f"a map named {name!r:.100} cannot be saved: files are named after it, so its name has up to 200 bytes, no "
            "slash, and does not begin with a dot"
        )
    return name


def write(path: Path, *content: Buffer | str) -> None:
    """Write a file, which is as it was or whole at any time.

    Raises:
        MapFileError: it cannot be written.
    """
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
    """A number without an exponent, which some readers of YAML take for a word; it comes back exactly."""
    return np.format_float_positional(number, trim="0")
