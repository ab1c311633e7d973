"""Values of parameters in ROS 1 (XML-RPC) and in ROS 2 (``rcl_interfaces/msg/ParameterValue``), and their names.

ROS 1 has 32-bit integers, doubles, bools, strings, bytes, lists of anything and namespaces (wiki.ros.org/Parameter
Server). ROS 2 has 64-bit integers, lists with elements of one type and, instead of namespaces, dots in names (Jazzy,
"Parameters").
"""

from __future__ import annotations

import re
import xmlrpc.client
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from typing_extensions import override

from bridge.config.sections.routing import ParameterRule
from bridge.messages.values import is_array
from bridge.routing.rules import glob_regex

MAX_DEPTH = 30
"""Limit of nested namespaces, as in ROS 1's own tools."""

_INT32 = range(-(2**31), 2**31)
_INT64 = range(-(2**63), 2**63)
_NO_XML = re.compile(r"[^\t\n -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_PART = re.compile(r"[A-Za-z0-9_]+")


class ParameterType(IntEnum):
    """``rcl_interfaces/msg/ParameterType``."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9


class UnrepresentableError(Exception):
    """A value that the other network's parameters cannot represent; the text has the reason."""


@dataclass(frozen=True, slots=True)
class Unreadable:
    """Stands for a value on ROS 1's parameter server that cannot be read."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class ParameterValue:
    """A value in ROS 2's types. Values of one kind with the same text are equal, including NaN.

    ``content`` is a bool, int, float, str, bytes, or a list of one of the first four types; None if it is not set.
    """

    kind: ParameterType
    content: Any = None

    @override
    def __eq__(self, other: object) -> bool:
        return isinstance(other, ParameterValue) and repr(self) == repr(other)

    @override
    def __hash__(self) -> int:
        return hash(repr(self))

    @classmethod
    def read(cls, message: Mapping[str, Any]) -> ParameterValue:
        """Return the value of a decoded ``ParameterValue``."""
        try:
            kind = ParameterType(message["type"])
        except ValueError:
            return NOT_SET
        if kind is ParameterType.NOT_SET:
            return NOT_SET
        content = message[_field(kind)]
        if kind is ParameterType.BYTE_ARRAY:
            return cls(kind, bytes(content))
        return cls(kind, content.tolist() if is_array(content) else content)

    def message(self) -> dict[str, Any]:
        """Return the fields of a ``ParameterValue``."""
        content = list(self.content) if self.kind is ParameterType.BYTE_ARRAY else self.content
        return {"type": int(self.kind), **({} if self.kind is ParameterType.NOT_SET else {_field(self.kind): content})}


NOT_SET = ParameterValue(ParameterType.NOT_SET)


def _field(kind: ParameterType) -> str:
    return f"{kind.name.lower()}_value"


def to_ros1(value: ParameterValue) -> Any:
    """Convert a value for ROS 1's parameter server; raises `UnrepresentableError`."""
    content = value.content
    if value.kind is ParameterType.NOT_SET:
        raise UnrepresentableError("it has no value")
    if value.kind is ParameterType.BYTE_ARRAY:
        return xmlrpc.client.Binary(content)
    for item in content if isinstance(content, list) else [content]:
        if isinstance(item, int) and item not in _INT32:
            raise UnrepresentableError(f"{item} does not fit into ROS 1's 32-bit integers")
        if isinstance(item, str) and _NO_XML.search(item):
            raise UnrepresentableError("its text has characters that ROS 1's XML cannot carry")
    return content


def why_not_ros1(value: ParameterValue) -> str:
    """Return why ROS 1's parameter server cannot have a value; "" if it can."""
    try:
        to_ros1(value)
    except UnrepresentableError as err:
        return str(err)
    return ""


def to_ros2(value: Any, like: ParameterType = ParameterType.NOT_SET) -> ParameterValue:
    """Convert a value of ROS 1's parameter server for a ROS 2 node; raises `UnrepresentableError`.

    ``like`` is the type of the node's parameter. To match it, an integer becomes a double, and a double with an integer
    value an integer, because `rosparam set` does not distinguish them. An empty list matches any list type.
    """
    if isinstance(value, xmlrpc.client.Binary):
        return ParameterValue(ParameterType.BYTE_ARRAY, value.data)
    if isinstance(value, list):
        return _list(value, like)
    converted = _scalar(value)
    if converted.kind is ParameterType.INTEGER and like is ParameterType.DOUBLE:
        return ParameterValue(ParameterType.DOUBLE, float(value))
    wanted = (converted.kind, like) == (ParameterType.DOUBLE, ParameterType.INTEGER)
    if wanted and value.is_integer() and int(value) in _INT64:
        return ParameterValue(ParameterType.INTEGER, int(value))
    return converted


def _scalar(value: Any) -> ParameterValue:
    match value:
        case bool():
            return ParameterValue(ParameterType.BOOL, value)
        case int() if value in _INT64:
            return ParameterValue(ParameterType.INTEGER, value)
        case float():
            return ParameterValue(ParameterType.DOUBLE, value)
        case str():
            return ParameterValue(ParameterType.STRING, value)
        case Unreadable():
            raise UnrepresentableError(value.reason)
    raise UnrepresentableError(f"ROS 2 has no parameters like {type(value).__name__} {str(value)[:60]}")


def _list(values: list[Any], like: ParameterType) -> ParameterValue:
    kinds = {_scalar(item).kind for item in values}
    if not kinds:
        return ParameterValue(like if like >= ParameterType.BOOL_ARRAY else ParameterType.STRING_ARRAY, [])
    if kinds == {ParameterType.INTEGER, ParameterType.DOUBLE} or (
        kinds == {ParameterType.INTEGER} and like is ParameterType.DOUBLE_ARRAY
    ):
        return ParameterValue(ParameterType.DOUBLE_ARRAY, [float(item) for item in values])
    if len(kinds) > 1:
        raise UnrepresentableError(f"ROS 2 has no lists of {' and '.join(sorted(kind.name.lower() for kind in kinds))}")
    return ParameterValue(ParameterType(kinds.pop() + ParameterType.BOOL_ARRAY - ParameterType.BOOL), list(values))


def flatten(tree: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield the parameters in a tree of the parameter server by their paths, ``a/b``; "" for the root."""
    if not isinstance(tree, dict):
        yield "", tree
    elif depth == MAX_DEPTH:
        yield "", Unreadable(f"the parameters below have names of more than {MAX_DEPTH} parts")
    else:
        for name, below in tree.items():
            for path, value in flatten(below, depth + 1):
                yield f"{name}/{path}" if path else str(name), value


class ParameterNames:
    """The names that a rule covers, on both networks; paths such as ``a/b`` are relative to `ParameterRule.ros1`."""

    def __init__(self, rule: ParameterRule) -> None:
        self.rule = rule
        self._globs = [glob_regex(glob.strip("/")) for glob in rule.names]

    def covers(self, path: str) -> bool:
        """Return whether the rule covers a parameter."""
        return any(glob.fullmatch(path) for glob in self._globs)

    def ros1(self, path: str) -> str:
        """Return the name on the parameter server."""
        return f"{self.rule.ros1}/{path}" if path else self.rule.ros1

    def ros2(self, path: str) -> str:
        """Return the name on the node."""
        return ".".join(part for part in (self.rule.prefix, path.replace("/", ".")) if part)

    def rest(self, ros2_name: str) -> str | None:
        """Return the path of a node's parameter; None if the rule excludes it, or its name is not valid in ROS 1."""
        name = self._after_prefix(ros2_name)
        if name is None or not _is_valid(name):
            return None
        rest = name.replace(".", "/")
        return rest if self.covers(rest) else None

    def is_skipped(self, ros2_name: str) -> bool:
        """Return whether the rule covers a node's parameter whose name is not valid in ROS 1."""
        name = self._after_prefix(ros2_name)
        return name is not None and not _is_valid(name) and self.covers(name.replace(".", "/"))

    def intended(self, path: str) -> str | None:
        """Return the path with slashes for ``a.b``, with which it would be shared; None for a path without dots."""
        path_of_node = self.rest(self.ros2(path))
        return path_of_node if path_of_node != path else None

    def _after_prefix(self, ros2_name: str) -> str | None:
        """Return the part of a node's parameter after the rule's prefix; None if it does not have the prefix."""
        prefix = self.rule.prefix
        if not prefix:
            return ros2_name or None
        if ros2_name != prefix and not ros2_name.startswith(f"{prefix}."):
            return None
        return ros2_name.removeprefix(prefix).removeprefix(".")


def _is_valid(name: str) -> bool:
    """Return whether each part of a node's parameter can be a part of a name in ROS 1."""
    return not name or all(_PART.fullmatch(part) for part in name.split("."))
