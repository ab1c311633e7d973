"""YARP's configuration files (`yarp/os/Property.cpp`, "yarp_config_file" of its documentation).

A line is a key and its values, ``key value ...`` or ``key = value``; brackets may go on over several lines, and so does
a line that ends in a backslash. ``[GROUP]`` begins a group, ``[LIST GROUP]`` besides adds its name to a list,
``[include "file.ini"]`` takes a file in, ``[include GROUP "file.ini"]`` as a group, ``[import context file.ini]`` from
another context. ``//`` begins a comment, and so does ``#`` after a space; ``$NAME``, ``${NAME}`` and ``$(NAME)`` stand
for environment variables or keys.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from yarp_compat.wire.text import dict_of, from_text, is_complete, plain_text
from yarp_compat.wire.values import entries_of, entry_values, merge

log = logging.getLogger(__name__)

DEEPEST = 32  # the deepest nesting of files that include each other

_VARIABLE = re.compile(r"(\\.)|\$([({]?)([A-Za-z0-9_]*)", re.DOTALL)

Entries = dict[str, Any]

FindImport = Callable[[str, str], str]
"""Finds a file in a context, by the context's and the file's names; empty where it is not found."""


class Environment(Protocol):
    """Where variables are looked up."""

    def find(self, key: str, /) -> Any:
        """The value of a key; its ``toString()`` is the text."""


class KeyPlace(NamedTuple):
    """The file and line (from 1) of a key."""

    file: str
    line: int


Places = dict[tuple[str, ...], KeyPlace]
"""The places of keys: ``("GROUP", "key")``, and ``("GROUP",)`` for the group itself; the last of several."""


def read_file(
    name: str,
    entries: Entries,
    env: Environment | None,
    wipe: bool,
    places: Places | None = None,
    *,
    find_import: FindImport | None = None,
) -> bool:
    """Take a file, or all files of a folder, into a dict of entries; False where none exists, and nothing changes.

    ``env`` knows variables; ``wipe`` first empties ``entries``; ``places`` takes where each key stands, for messages to
    people; ``find_import`` finds what ``[import ...]`` names.
    """
    return _File(env, {} if places is None else places, find_import).read(name, entries, wipe)


def read_folder(
    name: str, section: str, entries: Entries, wipe: bool, *, find_import: FindImport | None = None
) -> bool:
    """Take all ``.ini`` files of a folder; with a section, each as a group named like its file."""
    if not section:
        return read_file(name, entries, None, wipe, find_import=find_import)
    files = _inis(Path(name))
    if files is None:
        log.error("cannot read the folder %s", name)
        return False
    if wipe:
        entries.clear()
    read("".join(f'[include {section} "{file}" "{file}"]\n' for file in files), entries, None, find_import=find_import)
    return True


def read(text: str, entries: Entries, env: Environment | None, *, find_import: FindImport | None = None) -> None:
    """Take a file's text into a dict of entries."""
    _File(env, {}, find_import).take(text, entries)


@dataclass
class _File:
    """One file, with what it may look up and where it may look for others; ``within`` are the groups it stands in."""

    env: Environment | None
    places: Places
    find_import: FindImport | None
    folders: list[str] = field(default_factory=list)
    depth: int = 0
    name: str = ""
    within: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.env is not None and not self.folders and (path := self.env.find("CONFIG_PATH").toString()):
            self.folders = path.split(";")

    def read(self, name: str, entries: Entries, wipe: bool) -> bool:
        """Take a file or folder by its name."""
        if self.depth > DEEPEST:
            log.error("%s is not read: files include each other more than %d deep", name, DEEPEST)
            return False
        for folder in ("", *self.folders):
            path = Path(folder, name)
            text = _text(path)
            if text is not None:
                if wipe:
                    entries.clear()
                folders = [*self.folders, str(path.parent)]
                replace(self, folders=folders, depth=self.depth + 1, name=str(path)).take(text, entries)
                return True
        log.error("cannot read the configuration file %s", name)
        return False

    def take(self, text: str, entries: Entries) -> None:
        """Take all lines."""
        group = ""
        content: list[Any] = []
        for number, line in _lines(text):
            # what is open at the file's end is taken as it is, as YARP does
            buf = self._expanded(_uncommented(line), entries) if is_complete(line) else line
            if buf.startswith("[") and "]" in buf and is_complete(line):
                _close(group, content, entries)
                group, content = self._header(buf[1 : buf.index("]")], entries), []
                self._note(number, group)
                content = list(entry_values(entries.get(group, ())))
                continue
            values = from_text(buf)
            if len(values) > 1 and values[1] == "=":
                del values[1]
            if values:
                self._note(number, group, plain_text(values[0]))
            if values and group:
                content.append(values)
            elif values:
                merge(entries, dict_of([values]))
        _close(group, content, entries)

    def _note(self, line: int, *keys: str) -> None:
        if any(keys):
            self.places[*self.within, *filter(None, keys)] = KeyPlace(self.name, line)

    def _header(self, header: str, entries: Entries) -> str:
        """Reads what stands in brackets; returns the name of the group that begins, or empty."""
        words = [plain_text(value) for value in from_text(header)] if " " in header else []
        if len(words) > 1 and words[0] == "include":
            self._include(words[1:], entries)
            return ""
        if len(words) > 2 and words[0] == "import":
            self._import(words[1], words[2], entries)
            return ""
        if len(words) == 2:
            _list_name(words[0], words[1], entries)
            return words[1]
        return header

    def _include(self, words: list[str], entries: Entries) -> None:
        """Take another file: into all, or into a group, whose name may be put into a list."""
        if len(words) == 1:
            self.read(words[0], entries, wipe=False)
            return
        *listed, group, name = words
        if len(listed) > 1:
            log.error("[include %s] has too many words", " ".join(words))
            return
        if listed:
            _list_name(listed[0], group, entries)
        inner = dict_of(list(entry_values(entries.get(group, ()))))
        within = (*self.within, group)
        replace(self, name="", within=within).read(name, inner, wipe=False)
        if inner:
            merge(entries, dict_of([[group, *entries_of(inner)]]))

    def _import(self, context: str, name: str, entries: Entries) -> None:
        """Take a file of another context."""
        file = self.find_import(context, name) if self.find_import is not None else ""
        if file:
            self.read(file, entries, wipe=False)
        else:
            log.warning("cannot import %s from the context %s", name, context)

    def _expanded(self, line: str, entries: Entries) -> str:
        """The line with variables replaced."""
        if "$" not in line:
            return line
        out: list[str] = []
        at = 0
        for found in _VARIABLE.finditer(line):
            if found[1] is not None or found.start() < at:
                continue
            end = found.end()
            if found[2] and line[end : end + 1] in (")", "}"):
                end += 1
            out += (line[at : found.start()], self._variable(found[3], entries).replace("\\", "\\\\"))
            at = end
        return "".join([*out, line[at:]])

    def _variable(self, name: str, entries: Entries) -> str:
        if text := os.environ.get(name, ""):
            return text
        if self.env is not None and (text := str(self.env.find(name).toString())):
            return text
        values = entry_values(entries.get(name, ()))
        return plain_text(values[0]) if values else "1" if name == "__YARP__" else ""


def _close(group: str, content: list[Any], entries: Entries) -> None:
    if group:
        merge(entries, {group: content[0] if len(content) == 1 else tuple(content)})


def _list_name(key: str, name: str, entries: Entries) -> None:
    """Add a group's name to a list of names."""
    merge(entries, dict_of([[key, *entry_values(entries.get(key, ())), name]]))


def _lines(text: str) -> Iterator[tuple[int, str]]:
    r"""Lines with the numbers of their first; those with open brackets or quotes go on, and those that end in ``\``."""
    pending = ""
    first = 1
    going_on = False
    for number, line in enumerate(text.replace("\r", "").replace("\0", "").split("\n"), 1):
        first = first if going_on else number
        pending += line
        escaped = (len(line) - len(line.rstrip("\\"))) % 2 == 1
        if escaped:
            pending = pending[:-1]
        going_on = escaped or not is_complete(pending)
        if not going_on:
            yield first, pending
            pending = ""
    if pending:
        yield first, pending


def _uncommented(line: str) -> str:
    """The line without a comment."""
    if "//" not in line and "#" not in line:
        return line
    quoted = False
    before = " "
    for at, char in enumerate(line):
        if char == '"':
            quoted = not quoted
        elif not quoted:
            if char == "/" and before == "/":
                return line[: at - 1]
            if char == "#" and before in " \t":
                return line[: max(at - 1, 0)]
        before = '"' if quoted else char
    return line


def _text(path: Path) -> str | None:
    """A file's text, or that of all files in a folder, one group of the next ended by ``[]``."""
    files = _inis(path)
    try:
        if files is None:
            return _read(path)
        return "".join(_read(file) + "\n[]\n" for file in files)
    except (OSError, ValueError):
        return None


def _read(path: Path) -> str:
    return path.read_bytes().decode("utf-8", "surrogateescape")


def _inis(path: Path) -> list[Path] | None:
    """The configuration files of a folder; None where it is none."""
    try:
        return sorted(file for file in path.iterdir() if file.name.endswith(".ini")) if path.is_dir() else None
    except (OSError, ValueError):
        return None
