"""The base class of `Property`: values from text, command lines, URLs and configuration files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Self
from urllib.parse import unquote_plus

from yarp_compat.os import config_text
from yarp_compat.os.config_text import Environment
from yarp_compat.os.data.value_base import plain_of
from yarp_compat.os.resource_places import find_in_context
from yarp_compat.overriding import override
from yarp_compat.wire.binary import decode_prefix, encode_parts
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.text import dict_of, from_text, plain_text, to_text
from yarp_compat.wire.values import entries_of, merge

_WORD = re.compile(r'"([^"]*)"?|([^ "]+)')


def merge_options(words: Sequence[str], entries: dict[str, Any]) -> None:
    """Merge the options of a command line into a dict: ``--key value ...`` and ``--GROUP::key value ...``.

    Words before the first option, and after a bare ``--`` up to the next option, are dropped, as in YARP.
    """
    options: list[tuple[str, list[Any]]] = []
    values: list[Any] = []
    for argument in words:
        if argument.startswith("--"):
            values = []
            if argument != "--":
                options.append((argument[2:], values))
        else:
            values.append(_value(argument.replace("\\", "\\\\")))
    if any("::" in name for name, _ in options):
        for name, values in options:
            _put_in_groups(name, values, entries)
    else:
        merge(entries, dict_of([[_value(name), *values] for name, values in options]))


def _put_in_groups(name: str, values: list[Any], entries: dict[str, Any]) -> None:
    """Set the values of ``GROUP::key`` or ``key``; names that are numbers are ignored if any option names a group."""
    key = _value(name)
    if not isinstance(key, str):
        return
    path = str(key).split("::")
    if len(path) > 1 and not path[-1]:
        del path[-1]
    if len(path) == 1:
        merge(entries, dict_of([[type(key)(path[0]), *values]]))
        return
    key = next((name for name in entries if name == path[0]), path[0])  # a str subclass may mark a vocab
    (tree,) = entries_of({key: entries.get(key, ())})
    _set_in_group(tree, path[1:], values)
    merge(entries, dict_of([tree]))


def _set_in_group(tree: list[Any], path: list[str], values: list[Any]) -> None:
    """Set a value in a group, through nested groups along the path."""
    group = next((entry for entry in tree if _name_of(entry) == path[0]), None)
    if not isinstance(group, list):
        group = [path[0]]
        tree.append(group)
    if len(path) > 1:
        _set_in_group(group, path[1:], values)
    else:
        group[:] = [path[0], *values]


def _name_of(entry: Any) -> str:
    """Return the key of a list's element: the text of its first value, or of the element itself."""
    first = (entry[0] if entry else "") if isinstance(entry, list) else entry
    return plain_text(first)


def _value(word: str) -> Any:
    """Parse a word as one value; a word that contains several stays a string."""
    values = from_text(word)
    return values[0] if len(values) == 1 else word


def split_words(text: str) -> list[str]:
    """Split a command line into words; double quotes group words."""
    return [quoted or plain for quoted, plain in _WORD.findall(text) if quoted or plain]


def query_of(url: str) -> dict[str, str]:
    """Return the query of a URL, ``...?key=value&key=value``, as a dict."""
    values: dict[str, str] = {}
    for part in url.rpartition("?")[2].split("&"):
        key, _, value = part.partition("=")
        if key and value:
            values[unquote_plus(key)] = unquote_plus(value)
    return values


class PropertyBase(Portable):
    """The base class of `Property`: plain values under keys, with their readers and writers."""

    _entries: dict[str, Any]

    def put(self, key: str, value: Any) -> None:
        """Set the value of a key; a bool becomes an int, as in YARP's bindings."""
        plain = plain_of(int(value) if isinstance(value, bool) else value)
        merge(self._entries, {key: () if plain is None else plain})

    def unput(self, key: str) -> None:
        """Remove a key."""
        self._entries.pop(key, None)

    def clear(self) -> None:
        self._entries.clear()

    # sources of values

    def toString(self) -> str:
        """Return the text form, sorted by key."""
        return to_text(entries_of(self._entries))

    def fromString(self, text: str, wipe: bool = True) -> None:
        """Read a text: lists, each with a key and its values. ``wipe``, here and below: first remove all keys."""
        self._merge(dict_of(from_text(text)), wipe)

    def fromCommand(self, argv: Sequence[str], skipFirst: bool = True, wipe: bool = True) -> None:
        """Read a command line, ``--key value ...`` and ``--GROUP::key value ...``, after the program's name."""
        if wipe:
            self.clear()
        merge_options(list(argv)[1 if skipFirst else 0 :], self._entries)

    def fromArguments(self, text: str, wipe: bool = True) -> None:
        """Read a command line as one text; double quotes group words."""
        self.fromCommand(split_words(text), skipFirst=False, wipe=wipe)

    def fromQuery(self, url: str, wipe: bool = True) -> None:
        """Read the query of a URL."""
        self._merge(query_of(url), wipe)

    def fromConfigFile(self, fname: str, env: Environment | bool | None = None, wipe: bool = True) -> bool:
        """Read a configuration file, or all ``.ini`` files of a folder; return False, changing nothing, if not found.

        Files that it includes are also searched in its folder. ``env`` has values for ``$NAMES`` that the environment
        lacks; if ``env`` is left out, ``wipe`` may be the second argument.
        """
        values, wipe = (None, env) if isinstance(env, bool) else (env, wipe)
        return config_text.read_file(str(fname), self._entries, values, wipe, find_import=find_in_context)

    def fromConfigDir(self, dirname: str, section: str = "", wipe: bool = True) -> bool:
        """Read all ``.ini`` files of a folder; with a section, each as a group, listed under ``section``."""
        return config_text.read_folder(str(dirname), section, self._entries, wipe, find_import=find_in_context)

    def fromConfig(self, txt: str, env: Environment | bool | None = None, wipe: bool = True) -> None:
        """Read the text of a configuration file."""
        values, wipe = (None, env) if isinstance(env, bool) else (env, wipe)
        if wipe:
            self.clear()
        config_text.read(txt, self._entries, values, find_import=find_in_context)

    # as a message: YARP sends and reads the values of the text form, sorted by key

    @override
    def _write(self, out: ElementWriter) -> None:
        for part in encode_parts(from_text(self.toString()), out.profile):
            out.block(part)

    @override
    def _read(self, source: ElementReader) -> None:
        values, end = decode_prefix(source.data, source.profile, source.at)
        self._merge(dict_of(from_text(to_text(values))), wipe=True)
        source.at = end

    to_text = toString

    @override
    def from_text(self, line: str) -> None:
        self.fromString(line)

    # Python's names

    def __getitem__(self, key: str) -> Any:
        return self._entries[key]

    def __setitem__(self, key: str, value: Any) -> None:
        merge(self._entries, {key: plain_of(value)})

    def __delitem__(self, key: str) -> None:
        del self._entries[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __bool__(self) -> bool:
        return True

    def keys(self) -> Sequence[str]:
        """Return the keys."""
        return list(self._entries)

    def items(self) -> Sequence[tuple[str, Any]]:
        """Return the keys with their plain values."""
        return list(self._entries.items())

    def get(self, key: str, default: Any = None) -> Any:
        """Return the plain value under a key, or a default."""
        return self._entries.get(key, default)

    def _merge(self, entries: Mapping[str, Any], wipe: bool) -> None:
        if wipe:
            self.clear()
        merge(self._entries, entries)

    @override
    def _become(self, other: Self) -> None:
        self._merge(dict(other._entries), wipe=True)
