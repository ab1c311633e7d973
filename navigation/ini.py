"""Configuration files of existing robots, read as they are, with what is odd in them named by file and line."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any, TypeVar

from yarp_compat.os import config_text
from yarp_compat.os.property import Property
from yarp_compat.wire.text import plain_text


class IniError(ValueError):
    """A file that cannot be used; the text names file and line of all that is wrong."""


S = TypeVar("S")


def laid_under(
    section: S, file: Path | None, with_file: Callable[[S, Ini], tuple[S, list[str]]]
) -> tuple[S, list[str]]:
    """A section with what the file that it names says laid under it.

    Args:
        section: what the configuration says.
        file: None for none.
        with_file: lays what a file says under a section.

    Returns:
        the section, and what is odd in the file, each ``file:line: ...``.

    Raises:
        RuntimeError: the file is not there or cannot be used; the text says where and why.
    """
    if file is None:
        return section, []
    try:
        return with_file(section, Ini(file))
    except IniError as err:
        raise RuntimeError(str(err)) from None


class Ini:
    """A YARP configuration file with all that it includes.

    Args:
        path: the file.

    Attributes:
        notes: what is odd but does not stop it: stale keys, values that are not believed, each ``file:line: ...``.
        errors: what does; `check` raises them.

    Raises:
        IniError: there is no such file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[str] = []
        self.errors: list[str] = []
        entries: dict[str, Any] = {}
        self._entries = Property.of(entries)
        self._places: config_text.Places = {}
        self._read: set[tuple[str, ...]] = set()
        if not config_text.read_file(str(path), entries, None, wipe=True, places=self._places):
            raise IniError(f"{path}: there is no such file, or it cannot be read")

    def __contains__(self, group: str) -> bool:
        return (group,) in self._places

    def group(self, name: str, *, needed: bool = False) -> Group:
        """A group of keys; an empty one where it is not there."""
        self._read.add((name,))
        if needed and name not in self:
            self.errors.append(f"{self.path}: the group [{name}] is missing")
        return Group(self, name)

    @property
    def top(self) -> Group:
        """The keys that stand in no group."""
        return Group(self, "")

    def note_unread(self, stale: Mapping[tuple[str, str], str], others: AbstractSet[str] = frozenset()) -> None:
        """Note every key and group that was not asked for.

        Args:
            stale: ``(group, key)`` that are known to do nothing, with why.
            others: groups and keys that belong to other programs.
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


class Group:
    """One group's keys. What is wrong with them is kept in the file's ``notes`` and ``errors``."""

    def __init__(self, ini: Ini, name: str) -> None:
        self._ini, self._name = ini, name

    def number(self, key: str, default: float | None, low: float, high: float, unit: str = "") -> float:
        """A number.

        Args:
            key: its key.
            default: what holds where it is missing; None where it must be there.
            low: the least that is believed.
            high: the most that is believed; what is beyond is noted, and the default (or this bound) is used.
            unit: for people.
        """
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
