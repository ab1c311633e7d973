"""What is fuzzed: one small target for each parser."""

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
    """A parser made ready.

    Attributes:
        parse: takes any bytes; raises nothing but what ``refuses`` names, and AssertionError where a promise is broken.
        seeds: good inputs, made by our encoders or taken from what peers really say.
        refuses: the documented errors.
        words: what the format's own words are, to be put anywhere.
        largest: bytes of the longest input.
    """

    parse: Parse
    seeds: Sequence[bytes]
    refuses: tuple[type[Exception], ...]
    words: Sequence[bytes] = ()
    largest: int = 8192


@dataclass(frozen=True, slots=True)
class Target:
    """A parser's name, its part of a million inputs, and how it is made ready in the process that fuzzes it."""

    name: str
    share: int
    make: Callable[[], Subject]


def scratch() -> Path:
    """A folder for a parser of files, which goes with the process."""
    folder = tempfile.mkdtemp(prefix="midspan-fuzz-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def texts(*lines: str) -> list[bytes]:
    """Seeds given as text."""
    return [line.encode() for line in lines]


JSON_WORDS = (
    b"null", b"true", b"[]", b"{}", b"-1", b"1e999", b"NaN", b'"\\ud800"', b'"\xc3\xa9"', b'"AAA="',
    b"9" * 5000, b"[" * 3000, b'{"a":' * 3000,
)  # fmt: skip
"""What a JSON document may hold that its reader does not expect."""
