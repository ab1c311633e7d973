"""Digests of the files that a configuration names, by which a reload detects changed contents."""

from __future__ import annotations

import hashlib
import stat
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from bridge.config.sections.section import Section


def digest_of(files: Iterable[Path]) -> str:
    """Return a digest of the files' paths and contents, "" without files.

    A file that is missing, unreadable or not a regular one counts as such.
    """
    lines = [f"{file}\0{_content(file)}" for file in files]
    return hashlib.sha256("\n".join(lines).encode(errors="surrogateescape")).hexdigest() if lines else ""


def _content(file: Path) -> str:
    try:
        if not stat.S_ISREG(file.stat().st_mode):
            return "not a file"
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as err:
        return f"error {err.errno}"


def digests(section: Section, place: str = "") -> Iterator[tuple[str, str]]:
    """Yield the digests of the sections within a section that name files, each with its key, ``modules.mapper2d``."""
    for name, inner in section:
        if isinstance(inner, Section):
            key = f"{place}.{name}" if place else name
            if inner.digest:
                yield key, inner.digest
            yield from digests(inner, key)


def section_of(section: Section, key: str) -> Section | None:
    """Return the section with a key of `digests` within a section; None if it is unknown."""
    inner: Any = section
    for name in key.split("."):
        inner = getattr(inner, name, None)
    return inner if isinstance(inner, Section) else None


def set_digests(section: Section, values: Mapping[str, str]) -> None:
    """Set the `digests` of the sections within a section; keys of unknown sections are ignored."""
    for key, digest in values.items():
        if (inner := section_of(section, key)) is not None:
            inner.set_digest(digest)
