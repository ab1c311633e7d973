"""The values of a zenoh configuration; imports neither YAML nor zenoh, because all workers import it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

Tree = dict[str, Any]


def changed(tree: Tree, defaults: Mapping[str, Any]) -> Tree:
    """Return the values of a configuration that differ from zenoh's defaults."""
    values: Tree = {}
    for key, value in tree.items():
        default = defaults.get(key)
        if isinstance(value, dict) and isinstance(default, Mapping):
            below = changed(value, default)
            if below:
                values[key] = below
        elif value is not None and value != default:
            values[key] = value
    return values


def texts(value: Any, path: tuple[str | int, ...]) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Yield each text within a value, with its path; ``path`` is the path of the value."""
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, dict | list):
        for part, inner in value.items() if isinstance(value, dict) else enumerate(value):
            if part != "strategy":
                yield from texts(inner, (*path, part))
