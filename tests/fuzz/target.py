"""Fuzz targets: one for each parser."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

Parse = Callable[[bytes], object]


@dataclass(frozen=True, slots=True)
class Subject:
    """A prepared parser.

    Attributes:
        parse: accepts any bytes; raises only the errors in ``refuses``, and AssertionError if a promise is broken.
        seeds: valid inputs, from Midspan's encoders or recorded from peers.
        refuses: the documented errors.
        tokens: tokens of the format, to be inserted anywhere.
        largest: maximum input size in bytes.
    """

    parse: Parse
    seeds: Sequence[bytes]
    refuses: tuple[type[Exception], ...]
    tokens: Sequence[bytes] = ()
    largest: int = 8192


@dataclass(frozen=True, slots=True)
class Target:
    """A parser's name, its share of a million inputs, and a function that prepares it in the fuzzing process."""

    name: str
    share: int
    make: Callable[[], Subject]


def scratch() -> Path:
    """Return a folder for a parser of files, removed when the process exits."""
    folder = tempfile.mkdtemp(prefix="midspan-fuzz-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def texts(*lines: str) -> list[bytes]:
    """Return texts as seeds."""
    return [line.encode() for line in lines]


JSON_WORDS = (
    b"null", b"true", b"[]", b"{}", b"-1", b"1e999", b"NaN", b'"\\ud800"', b'"\xc3\xa9"', b'"AAA="',
    b"9" * 5000, b"[" * 3000, b'{"a":' * 3000,
)  # fmt: skip
"""JSON fragments that a reader may not expect."""
