"""The parameters of a master: a tree of values, and the updates that a change causes."""

from __future__ import annotations

import xmlrpc.client
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from bridge.adapters.ros1.master.names import canonical, join, split

MAX_BYTES = 256 * 2**20
"""Limit of the approximate size of all parameters in memory, in bytes."""

MAX_DEPTH = 100
"""Limit of nested namespaces and values."""

_OVERHEAD = 64
_SCALARS = (bool, int, float, str, xmlrpc.client.Binary, xmlrpc.client.DateTime)


class Update(NamedTuple):
    """A new value for the subscribers of a key.

    Attributes:
        subscribed_key: the key that they subscribe to.
        key: the key of the new value: the subscribed key itself, or a key below it.
        value: the new value, ``{}`` for a deleted parameter.
        inner: whether the value is only a part of the value that was set.
    """

    subscribed_key: str
    key: str
    value: Any
    inner: bool


class ParameterTree:
    """The parameters; names are global and canonical, ``/`` is the whole tree. Not thread-safe.

    A change copies the namespaces that contain it, so that a value or subtree that was returned never changes.
    """

    def __init__(self, values: Mapping[str, Any] | None = None) -> None:
        self._values: dict[str, Any] = dict(values or {})
        self._size = _measure(self._values, MAX_DEPTH)

    @property
    def values(self) -> dict[str, Any]:
        """The whole tree."""
        return self._values

    def get(self, key: str) -> Any:
        """Return a value or a subtree; raises `KeyError` if it is not set."""
        value: Any = self._values
        for part in split(key):
            if type(value) is not dict:
                raise KeyError(key)
            value = value[part]
        return value

    def has(self, key: str) -> bool:
        """Return whether a parameter or namespace is set."""
        try:
            self.get(key)
        except KeyError:
            return False
        return True

    def set(self, key: str, value: Any) -> None:
        """Replace a value or subtree; raises `TypeError` or `ValueError` if the value is not valid there."""
        parts = split(key)
        size = _measure(value, MAX_DEPTH - len(parts))
        if not parts:
            if type(value) is not dict:
                raise TypeError("cannot set root of parameter tree to non-dictionary")
            self._check_size(size)
            self._values, self._size = value, size
            return
        old = _measure(self.get(key), MAX_DEPTH) if self.has(key) else 0
        total = self._size + size - old
        self._check_size(total)
        self._values, self._size = _with(self._values, parts, value), total

    @staticmethod
    def _check_size(size: int) -> None:
        if size > MAX_BYTES:
            raise ValueError(f"the parameters would be larger than {MAX_BYTES >> 20} MB")

    def delete(self, key: str) -> None:
        """Remove a value or subtree; raises `KeyError` if it is not set, or is the root."""
        parts = split(key)
        if not parts:
            raise KeyError("cannot delete root of parameter tree")
        size = _measure(self.get(key), MAX_DEPTH)
        self._values = _without(self._values, parts)
        self._size -= size

    def search(self, node: str, key: str) -> str:
        """Return a key's full name in the closest namespace around a node that has the key's first part, else "".

        The search begins in the node's own namespace; a global key is returned if it is set. Raises `ValueError` if the
        key is private or the node's name is not global.
        """
        if not key or key.startswith("~"):
            raise ValueError("invalid key")
        if not node.startswith("/"):
            raise ValueError("namespace must be global")
        if key.startswith("/"):
            return key if self.has(key) else ""
        first = split(key)[0]
        if self.has(join(node, first)):
            return join(node, key)
        parts = split(node)
        for count in range(len(parts) - 1, -1, -1):
            if self.has("/" + "/".join([*parts[:count], first])):
                return "/" + "/".join([*parts[:count], key])
        return ""

    def names(self) -> list[str]:
        """Return the names of all values."""
        return list(_names("/", self._values))

    def updates(self, key: str, value: Any, subscribed: Sequence[str]) -> list[Update]:
        """Return the updates that a new value causes; ``value`` is ``{}`` for a deleted parameter.

        ``subscribed`` are the keys with subscribers. All keys end with a slash.
        """
        key = _with_slash(canonical(key))
        inner = list(_inner_keys(key, value)) if type(value) is dict else None
        updates = []
        for name in subscribed:
            if key.startswith(_with_slash(name)):
                updates.append(Update(name, key, value, inner=False))
            elif inner is not None and _with_slash(name).startswith(key) and name not in inner:
                updates.append(Update(name, name, {}, inner=True))  # the key was only in the old value
        known = set(subscribed)
        for name in inner or ():
            if name in known:
                inside: Any = value
                for part in split(name[len(key) :]):
                    inside = inside.get(part, {}) if type(inside) is dict else {}
                updates.append(Update(name, name, inside, inner=True))
        return updates


def _with(tree: object, parts: list[str], value: Any) -> dict[str, Any]:
    """Return a copy of a tree with another value; a value on the path becomes a namespace."""
    first, *rest = parts
    inner = tree if type(tree) is dict else {}
    return {**inner, first: _with(inner.get(first), rest, value) if rest else value}


def _without(tree: dict[str, Any], parts: list[str]) -> dict[str, Any]:
    first, *rest = parts
    if rest:
        return {**tree, first: _without(tree[first], rest)}
    return {name: value for name, value in tree.items() if name != first}


def _measure(value: Any, depth: int) -> int:
    """Return the approximate size of a value; raises `TypeError` or `ValueError` if it cannot be a parameter."""
    if depth < 0:
        raise ValueError(f"parameters are nested deeper than {MAX_DEPTH} levels")
    if type(value) is dict:
        return _OVERHEAD + sum(_OVERHEAD + len(name) + _measure(v, depth - 1) for name, v in value.items())
    if isinstance(value, list | tuple):
        return _OVERHEAD + sum(_measure(v, depth - 1) for v in value)
    if isinstance(value, int) and not xmlrpc.client.MININT <= value <= xmlrpc.client.MAXINT:
        raise TypeError(f"the number {value} does not fit into the 32 bits of XML-RPC")
    if not isinstance(value, _SCALARS):
        raise TypeError(f"a parameter cannot contain a value of type {type(value).__name__}")
    content = value.data if isinstance(value, xmlrpc.client.Binary) else value
    return _OVERHEAD + (len(content) if isinstance(content, str | bytes) else 0)


def _names(key: str, values: Mapping[str, Any]) -> Iterator[str]:
    for name, value in values.items():
        if type(value) is dict:
            yield from _names(join(key, name), value)
        else:
            yield join(key, name)


def _inner_keys(key: str, values: Mapping[str, Any]) -> Iterator[str]:
    for name, value in values.items():
        inner = join(key, name) + "/"
        yield inner
        if type(value) is dict:
            yield from _inner_keys(inner, value)


def _with_slash(key: str) -> str:
    return key if key.endswith("/") else f"{key}/"
