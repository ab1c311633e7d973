"""Reads configuration files of existing robots unchanged, and notes problems by file and line."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any, TypeVar

from bridge.config.sections.section import Mistake, Section
from yarp_compat.os import config_text
from yarp_compat.os.data.bottle import Property
from yarp_compat.os.resource_places import find_in_context
from yarp_compat.wire.text import plain_text


class IniError(ValueError):
    """A file is invalid; the text lists all errors with file and line."""


S = TypeVar("S", bound=Section)


def laid_under(
    section: S, file: Path | None, read: Callable[[S, Ini], dict[str, Any]], *, merged: Collection[str] = ()
) -> tuple[S, list[str]]:
    """Return a section with a file's values as defaults, and notes on the file, each ``file:line: ...``.

    Values that the section sets itself win. ``read`` returns the fields that a file sets; it merges those in ``merged``
    with the section's values. Raises `RuntimeError` with the place and reason if a file is missing or invalid.
    """
    if file is None:
        return section, []
    try:
        ini = Ini(file)
        fields = read(section, ini)
        ini.check()
    except IniError as err:
        raise RuntimeError(str(err)) from None
    defaults = {key: value for key, value in fields.items() if key in merged or key not in section.model_fields_set}
    return section.model_copy(update=defaults), ini.notes


def mistakes_with_file(
    section: S,
    file: Path,
    read: Callable[[S, Ini], dict[str, Any]],
    misfits: Callable[[S], Iterable[Mistake]],
    *,
    merged: Collection[str],
) -> Iterator[Mistake]:
    """Yield the errors of a section's file, else the ``misfits`` of the section with the file's values.

    The arguments are those of `laid_under`.
    """
    try:
        whole, _ = laid_under(section, file, read, merged=merged)
    except RuntimeError as err:
        for line in str(err).splitlines():
            yield ("ini",), line
    else:
        yield from misfits(whole)


def files_of(path: Path) -> list[Path]:
    """Return a file and those that it includes, also paths at which an included file may appear later."""
    tried: list[Path] = []
    config_text.read_file(str(path), {}, None, wipe=True, find_import=find_in_context, tried=tried)
    return tried


class Ini:
    """A YARP configuration file with its includes; raises `IniError` if it does not exist."""

    def __init__(self, path: Path) -> None:
        self.path = path
        # problems that are not errors: stale keys and implausible values, each ``file:line: ...``
        self.notes: list[str] = []
        self.errors: list[str] = []  # `check` raises them
        entries: dict[str, Any] = {}
        self._entries = Property.of(entries)
        self._places: config_text.Places = {}
        self._read: set[tuple[str, ...]] = set()
        if not config_text.read_file(
            str(path), entries, None, wipe=True, places=self._places, find_import=find_in_context
        ):
            raise IniError(f"{path}: no such file, or it is not readable")

    def __contains__(self, group: str) -> bool:
        return (group,) in self._places

    def group(self, name: str, *, needed: bool = False) -> IniGroup:
        """Return a group of keys; empty if the file has no such group."""
        self._read.add((name,))
        if needed and name not in self:
            self.errors.append(f"{self.path}: the group [{name}] is missing")
        return IniGroup(self, name)

    @property
    def top(self) -> IniGroup:
        """The keys outside any group."""
        return IniGroup(self, "")

    def note_unread(self, stale: Mapping[tuple[str, str], str], others: AbstractSet[str] = frozenset()) -> None:
        """Note every key and group that was not read, except those of ``others``, which belong to other programs.

        ``stale`` gives the reason why a known ``(group, key)`` has no effect.
        """
        groups_read = {keys[0] for keys in self._read}
        for keys, place in self._places.items():
            if keys in self._read or not others.isdisjoint(keys):
                continue
            if len(keys) == 1 and any(other[:1] == keys and len(other) > 1 for other in self._places):
                if keys[0] not in groups_read:
                    self.notes.append(f"{place.file}:{place.line}: the group [{keys[0]}] is ignored")
            elif len(keys) == 1 or keys[0] in groups_read:
                group = keys[-2] if len(keys) > 1 else ""
                reason = stale.get((group, keys[-1]), "Midspan does not use it")
                self.notes.append(f"{place.file}:{place.line}: '{keys[-1]}' is ignored: {reason}")

    def check(self) -> None:
        """Raise `IniError` with all errors, if there are any."""
        if self.errors:
            raise IniError("\n".join(self.errors))

    def value(self, keys: tuple[str, ...]) -> Any:
        """Return the plain value of a key; None if it is missing."""
        self._read.add(keys)
        *groups, key = keys
        entries = self._entries.findGroup(groups[0]) if groups else self._entries
        return entries.find(key).plain if entries.check(key) else None

    def where(self, keys: tuple[str, ...]) -> str:
        """Return ``file:line`` of a key."""
        place = self._places.get(keys)
        return f"{place.file}:{place.line}" if place else str(self.path)


def port_name(text: str) -> str:
    """Return the name of a port or topic with one leading slash and no trailing one."""
    return "/" + text.strip("/")


def frame_name(text: str) -> str:
    """Return the name of a frame in tf2's form, without a leading slash."""
    return text.lstrip("/")


class IniGroup:
    """The keys of one group; problems go to the file's ``notes`` and ``errors``."""

    def __init__(self, ini: Ini, name: str) -> None:
        self._ini, self._name = ini, name

    def number(self, key: str, default: float | None, low: float, high: float, unit: str = "") -> float:
        """Return a number, required without a default; note a number out of range, and use the default or a bound."""
        keys = self._keys(key)
        value = self._ini.value(keys)
        bound = low if default is None else default
        if value is None:
            if default is None:
                self._ini.errors.append(f"{self._ini.where(self._keys())}: '{key}' is missing in [{self._name}]")
            return bound
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            self._ini.errors.append(f"{self._ini.where(keys)}: '{key}' must be a number, not {plain_text(value)!r}")
            return bound
        if not (math.isfinite(value) and low <= value <= high):
            used = default if default is not None else min(max(value, low), high) if math.isfinite(value) else low
            unit = f" {unit}" if unit else ""
            self._ini.notes.append(
                f"{self._ini.where(keys)}: '{key} {value:g}' is out of range ({low:g} to {high:g}{unit}); "
                f"using {used:g}"
            )
            return used
        return float(value)

    def choice(self, key: str, default: int, choices: tuple[int, ...]) -> int:
        """Return an integer, which must be one of ``choices``."""
        value = self._ini.value(self._keys(key))
        if value is None:
            return default
        if value not in choices:
            allowed = ", ".join(map(str, choices))
            self._ini.errors.append(
                f"{self._ini.where(self._keys(key))}: '{key}' must be one of {allowed}, not {value}"
            )
            return default
        return int(value)

    def flag(self, key: str, default: bool) -> bool:
        """Return a boolean, which YARP's files write as 1 or 0, true or false."""
        value = self._ini.value(self._keys(key))
        if value is None:
            return default
        flag = {"true": 1, "false": 0}.get(str(value).lower(), value)
        if flag not in (0, 1):
            self._ini.errors.append(f"{self._ini.where(self._keys(key))}: '{key}' must be 0 or 1, not {value}")
            return default
        return bool(flag)

    def text(self, key: str, default: str) -> str:
        """Return a value as text."""
        value = self._ini.value(self._keys(key))
        return default if value is None else plain_text(value)

    def add_texts(self, fields: dict[str, Any], form: Callable[[str], str], **names: str) -> None:
        """Add the texts that the file has to ``fields``; each of ``names`` is a field and its key."""
        for field, key in names.items():
            if text := self.text(key, ""):
                fields[field] = form(text)

    def has(self, key: str) -> bool:
        """Whether the group has a key."""
        return self._ini.value(self._keys(key)) is not None

    def note(self, key: str, what: str) -> None:
        """Note a problem with a key."""
        self._ini.notes.append(f"{self.where(key)}: '{key}': {what}")

    def where(self, key: str) -> str:
        """Return ``file:line`` of a key."""
        return self._ini.where(self._keys(key))

    def _keys(self, *key: str) -> tuple[str, ...]:
        return (self._name, *key) if self._name else key
