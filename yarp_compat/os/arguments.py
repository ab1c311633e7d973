"""Command lines and URLs as values under keys (`yarp/os/Property.cpp`)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any
from urllib.parse import unquote_plus

from yarp_compat.wire.decoder import dict_of
from yarp_compat.wire.encoder import entry_values
from yarp_compat.wire.text import from_text

_WORD = re.compile(r'"([^"]*)"?|([^ "]+)')


def take(words: Sequence[str], entries: dict[str, Any]) -> None:
    """Put the options of a command line into a dict: ``--key value ...`` and ``--GROUP::key value ...``."""
    options: list[list[Any]] = []
    for word in words:
        if word.startswith("--"):
            options.append([word[2:]])
        elif options:
            options[-1].append(_value(word.replace("\\", "\\\\")))
    for name, *values in options:
        *groups, key = (part for part in name.split("::") if part) if "::" in name else [name]
        if not groups:
            entries.update(dict_of([[key, *values]]))
            continue
        path = [*groups, key]
        tree = [path[0], *entry_values(entries.get(path[0], ()))]
        _put(tree, path[1:], values)
        entries.update(dict_of([tree]))


def _put(tree: list[Any], path: list[str], values: list[Any]) -> None:
    """Set a value in a group, below as many groups as the path has."""
    for entry in tree[1:]:
        if isinstance(entry, list) and entry and entry[0] == path[0]:
            found = entry
            break
    else:
        found = [path[0]]
        tree.append(found)
    if len(path) > 1:
        _put(found, path[1:], values)
    else:
        found[1:] = values


def _value(word: str) -> Any:
    """The one value that a word is; with spaces or the like in it, a string."""
    values = from_text(word)
    return values[0] if len(values) == 1 else word


def split(text: str) -> list[str]:
    """The words of a command line; double quotes hold them together."""
    return [quoted or word for quoted, word in _WORD.findall(text) if quoted or word]


def query(url: str) -> dict[str, str]:
    """What a URL says: ``...?key=value&key=value``."""
    found: dict[str, str] = {}
    for part in url.rpartition("?")[2].split("&"):
        key, _, value = part.partition("=")
        if key and value:
            found[unquote_plus(key)] = unquote_plus(value)
    return found
