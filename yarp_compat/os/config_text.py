"""YARP's configuration files (`yarp/os/Property.cpp`, "yarp_config_file" in its documentation).

A line has a key and its values, ``key value ...`` or ``key = value``; brackets may span several lines, and a backslash
at the end continues the line. ``[GROUP]`` begins a group, ``[LIST GROUP]`` also adds its name to a list,
``[include "file.ini"]`` includes a file, ``[include GROUP "file.ini"]`` as a group, ``[import context file.ini]`` from
another context. ``//``, or ``#`` after a space, begins a comment; ``$NAME``, ``${NAME}`` and ``$(NAME)`` become the
values of environment variables or keys.
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

DEEPEST = 32  # maximum levels of nested includes

_VARIABLE = re.compile(r"(\\.)|\$([({]?)([A-Za-z0-9_]*)", re.DOTALL)

Entries = dict[str, Any]

FindImport = Callable[[str, str], str]
"""Returns the path of a file, given the names of its context and the file; empty if not found."""


class Environment(Protocol):
    """A source of values for variables."""

    def find(self, key: str, /) -> Any:
        """Return the value of a key; its ``toString()`` is the text."""


class KeyPlace(NamedTuple):
    """The file and line (from 1) of a key."""

    file: str
    line: int


Places = dict[tuple[str, ...], KeyPlace]
"""Where keys were last defined: ``("GROUP", "key")`` for a key of a group, ``("GROUP",)`` for the group itself."""


def read_file(
    name: str,
    entries: Entries,
    env: Environment | None,
    wipe: bool,
    places: Places | None = None,
    *,
    find_import: FindImport | None = None,
    tried: list[Path] | None = None,
) -> bool:
    """Read a file, or all files of a folder, into a dict of entries; return False, and change nothing, if not found.

    ``env`` has values for variables; ``wipe`` first empties ``entries``; ``places`` receives the file and line of each
    key, for error messages; ``find_import`` returns the files of ``[import ...]``; ``tried`` receives the paths of the
    file and of those that it includes, also where they were searched in vain.
    """
    places, tried = {} if places is None else places, [] if tried is None else tried
    return _File(env, places, find_import, tried).read(name, entries, wipe)


def read_folder(
    name: str, section: str, entries: Entries, wipe: bool, *, find_import: FindImport | None = None
) -> bool:
    """Read all ``.ini`` files of a folder; with a section, each as a group, whose name is the file's path.

    The section then lists these names.
    """
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
    """Read the text of a configuration file into a dict of entries."""
    _File(env, {}, find_import, []).parse(text, entries)


@dataclass
class _File:
    """One file, with its variables and include folders; ``within`` are the groups that include it."""

    env: Environment | None
    places: Places
    find_import: FindImport | None
    tried: list[Path]
    folders: list[str] = field(default_factory=list)
    depth: int = 0
    name: str = ""
    within: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.env is not None and not self.folders and (path := self.env.find("CONFIG_PATH").toString()):
            self.folders = path.split(";")

    def read(self, name: str, entries: Entries, wipe: bool) -> bool:
        """Read a file or folder by its name."""
        if self.depth > DEEPEST:
            log.error("cannot read %s: includes are nested more than %d deep", name, DEEPEST)
            return False
        for folder in ("", *self.folders):
            path = Path(folder, name)
            self.tried.append(path)
            text = _text(path)
            if text is not None:
                if wipe:
                    entries.clear()
                folders = [*self.folders, str(path.parent)]
                replace(self, folders=folders, depth=self.depth + 1, name=str(path)).parse(text, entries)
                return True
        log.error("cannot read the configuration file %s", name)
        return False

    def parse(self, text: str, entries: Entries) -> None:
        """Parse all lines into entries."""
        group = ""
        content: list[Any] = []
        for number, line in _lines(text):
            # a line that is incomplete at the end of the file is used unchanged, as in YARP
            buf = self._expand(_without_comment(line), entries) if is_complete(line) else line
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
        """Execute a header in brackets; return the name of the group that begins, or ""."""
        parts = [plain_text(value) for value in from_text(header)] if " " in header else []
        if len(parts) > 1 and parts[0] == "include":
            self._include(parts[1:], entries)
            return ""
        if len(parts) > 2 and parts[0] == "import":
            self._import(parts[1], parts[2], entries)
            return ""
        if len(parts) == 2:
            _list_name(parts[0], parts[1], entries)
            return parts[1]
        return header

    def _include(self, arguments: list[str], entries: Entries) -> None:
        """Include another file: at the top level, or as a group, whose name may be added to a list."""
        if len(arguments) == 1:
            self.read(arguments[0], entries, wipe=False)
            return
        *listed, group, name = arguments
        if len(listed) > 1:
            log.error("[include %s] has too many words", " ".join(arguments))
            return
        if listed:
            _list_name(listed[0], group, entries)
        inner = dict_of(list(entry_values(entries.get(group, ()))))
        within = (*self.within, group)
        replace(self, name="", within=within).read(name, inner, wipe=False)
        if inner:
            merge(entries, dict_of([[group, *entries_of(inner)]]))

    def _import(self, context: str, name: str, entries: Entries) -> None:
        """Include a file from another context."""
        file = self.find_import(context, name) if self.find_import is not None else ""
        if file:
            self.read(file, entries, wipe=False)
        else:
            log.warning("cannot import %s from the context %s", name, context)

    def _expand(self, line: str, entries: Entries) -> str:
        """Return the line with variables replaced."""
        if "$" not in line:
            return line
        out: list[str] = []
        at = 0
        for variable in _VARIABLE.finditer(line):
            if variable[1] is not None or variable.start() < at:
                continue
            end = variable.end()
            if variable[2] and line[end : end + 1] in (")", "}"):
                end += 1
            out += (line[at : variable.start()], self._variable(variable[3], entries).replace("\\", "\\\\"))
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
    r"""Yield logical lines with their first line numbers; open brackets or quotes or a final ``\`` continue a line."""
    pending = ""
    first = 1
    continues = False
    for number, line in enumerate(text.replace("\r", "").replace("\0", "").split("\n"), 1):
        first = first if continues else number
        pending += line
        escaped = (len(line) - len(line.rstrip("\\"))) % 2 == 1
        if escaped:
            pending = pending[:-1]
        continues = escaped or not is_complete(pending)
        if not continues:
            yield first, pending
            pending = ""
    if pending:
        yield first, pending


def _without_comment(line: str) -> str:
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
    """Return the text of a file, or of all ``.ini`` files in a folder, each followed by ``[]``, which ends a group."""
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
    """Return the configuration files of a folder; None if it is not a folder."""
    try:
        return sorted(file for file in path.iterdir() if file.name.endswith(".ini")) if path.is_dir() else None
    except (OSError, ValueError):
        return None
