"""Reads configuration files of existing robots as they are, and notes oddities by file and line."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any, TypeVar

from bridge.config.sections.section import Section
from yarp_compat.os import config_text
from yarp_compat.os.data.bottle import Property
from yarp_compat.os.resource_places import find_in_context
from yarp_compat.wire.text import plain_text


class IniError(ValueError):
    """A file that cannot be used; the text names file and line of all that is wrong."""


S = TypeVar("S", bound=Section)


def laid_under(
    section: S, file: Path | None, read: Callable[[S, Ini], dict[str, Any]], *, merged: Collection[str] = ()
) -> tuple[S, list[str]]:
    """A section with its file's values laid under it, and what is odd in the file, each ``file:line: ...``.

    What the section itself sets is stronger. ``read`` returns the fields that a file sets, and lays the file under the
    section itself in those of ``merged``. Raises `RuntimeError` with where and why a file is missing or cannot be used.
    """
    if file is None:
        return section, []
    try:
        ini = Ini(file)
        found = read(section, ini)
        ini.check()
    except IniError as err:
        raise RuntimeError(str(err)) from None
    kept = {key: value for key, value in found.items() if key in merged or key not in section.model_fields_set}
    return section.model_copy(update=kept), ini.notes


class Ini:
    """A YARP configuration file with all that it includes; raises `IniError` if there is no such file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        # what is odd but does not stop it: stale keys, values that are not believed, each ``file:line: ...``
        self.notes: list[str] = []
        self.errors: list[str] = []  # what does; `check` raises them
        entries: dict[str, Any] = {}
        self._entries = Property.of(entries)
        self._places: config_text.Places = {}
        self._read: set[tuple[str, ...]] = set()
        if not config_text.read_file(
            str(path), entries, None, wipe=True, places=self._places, find_import=find_in_context
        ):
            raise IniError(f"{path}: there is no such file, or it cannot be read")

    def __contains__(self, group: str) -> bool:
        return (group,) in self._places

    def group(self, name: str, *, needed: bool = False) -> IniGroup:
        """A group of keys; an empty one where it is not there."""
        self._read.add((name,))
        if needed and name not in self:
            self.errors.append(f"{self.path}: the group [{name}] is missing")
        return IniGroup(self, name)

    @property
    def top(self) -> IniGroup:
        """The keys that stand in no group."""
        return IniGroup(self, "")

    def note_unread(self, stale: Mapping[tuple[str, str], str], others: AbstractSet[str] = frozenset()) -> None:
        """Note every key and group that was not asked for, but those of ``others``, which belong to other programs.

        ``stale`` says why a ``(group, key)`` that is known does nothing.
        """
        asked = {keys[0] for keys in self._read}
        for keys, place in self._places.items():
            if keys in self._read or not others.isdisjoint(keys):
                continue
            if len(keys) == 1 and any(other[:1] == keys and len(other) > 1 for other in self._places):
                if keys[0] not in asked:
                    self.notes.append(f"{place.file}:{place.line}: the group [{keys[0]}] is not read")
            elif len(keys) == 1 or keys[0] in asked:
                group = keys[-2] if len(keys) > 1 else ""
                why = stale.get((group, keys[-1]), "nothing here reads it")
                self.notes.append(f"{place.file}:{place.line}: '{keys[-1]}' does nothing: {why}")

    def check(self) -> None:
        """Raise `IniError` with all errors, if there are any."""
        if self.errors:
            raise IniError("\n".join(self.errors))

    def value(self, keys: tuple[str, ...]) -> Any:
        """The plain value of a key; None where it is not there."""
        self._read.add(keys)
        *groups, key = keys
        found = self._entries.findGroup(groups[0]) if groups else self._entries
        return found.find(key).plain if found.check(key) else None

    def where(self, keys: tuple[str, ...]) -> str:
        """``file:line`` of a key."""
        place = self._places.get(keys)
        return f"{place.file}:{place.line}" if place else str(self.path)


def port_name(text: str) -> str:
    """A port's or topic's name as it is everywhere else: with one slash before it, and none behind."""
    return "/" + text.strip("/")


def frame_name(text: str) -> str:
    """A frame's name as tf2 has it."""
    return text.lstrip("/")


class IniGroup:
    """The keys of one group; problems go to the file's ``notes`` and ``errors``."""

    def __init__(self, ini: Ini, name: str) -> None:
        self._ini, self._name = ini, name

    def number(self, key: str, default: float | None, low: float, high: float, unit: str = "") -> float:
        """A number, needed where there is no default; what is not believed is noted, and default or bound are used."""
        keys = self._keys(key)
        found = self._ini.value(keys)
        bound = low if default is None else default
        if found is None:
            if default is None:
                self._ini.errors.append(f"{self._ini.where(self._keys())}: '{key}' is missing in [{self._name}]")
            return bound
        if isinstance(found, bool) or not isinstance(found, (int, float)):
            self._ini.errors.append(f"{self._ini.where(keys)}: '{key}' is a number, not {plain_text(found)!r}")
            return bound
        if not (math.isfinite(found) and low <= found <= high):
            used = default if default is not None else min(max(found, low), high) if math.isfinite(found) else low
            unit = f" {unit}" if unit else ""
            self._ini.notes.append(
                f"{self._ini.where(keys)}: '{key} {found:g}' is not believed: it is within {low:g} and {high:g}{unit}; "
                f"{used:g} is used"
            )
            return used
        return float(found)

    def choice(self, key: str, default: int, choices: tuple[int, ...]) -> int:
        """One of some whole numbers."""
        found = self._ini.value(self._keys(key))
        if found is None:
            return default
        if found not in choices:
            told = ", ".join(map(str, choices))
            self._ini.errors.append(f"{self._ini.where(self._keys(key))}: '{key}' is one of {told}, not {found}")
            return default
        return int(found)

    def flag(self, key: str, default: bool) -> bool:
        """Yes or no, as YARP's files say it: 1 or 0, true or false."""
        found = self._ini.value(self._keys(key))
        if found is None:
            return default
        word = {"true": 1, "false": 0}.get(str(found).lower(), found)
        if word not in (0, 1):
            self._ini.errors.append(f"{self._ini.where(self._keys(key))}: '{key}' is 0 or 1, not {found}")
            return default
        return bool(word)

    def text(self, key: str, default: str) -> str:
        """Words."""
        found = self._ini.value(self._keys(key))
        return default if found is None else plain_text(found)

    def take_texts(self, found: dict[str, Any], form: Callable[[str], str], **names: str) -> None:
        """Put the words that are there into fields: each of ``names`` is a field and its key."""
        for field, key in names.items():
            if text := self.text(key, ""):
                found[field] = form(text)

    def has(self, key: str) -> bool:
        """Whether a key is there."""
        return self._ini.value(self._keys(key)) is not None

    def note(self, key: str, what: str) -> None:
        """Note that a key is odd."""
        self._ini.notes.append(f"{self.where(key)}: '{key}': {what}")

    def where(self, key: str) -> str:
        """``file:line`` of a key."""
        return self._ini.where(self._keys(key))

    def _keys(self, *key: str) -> tuple[str, ...]:
        return (self._name, *key) if self._name else key
