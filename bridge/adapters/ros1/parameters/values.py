"""Values of parameters in ROS 1 (XML-RPC) and in ROS 2 (``rcl_interfaces/msg/ParameterValue``), and their names.

ROS 1 knows 32-bit integers, doubles, bools, text, bytes, lists of anything and namespaces (wiki.ros.org/Parameter
Server). ROS 2 knows 64-bit integers, lists of one type each and no namespaces: dots in a name stand for them (Jazzy,
"Parameters").
"""

from __future__ import annotations

import re
import xmlrpc.client
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from bridge.config.sections.parameters import ParameterRule
from bridge.routing.patterns import glob_regex

MAX_DEPTH = 30
"""How deep namespaces nest that are read; ROS 1's own tools do no deeper ones."""

_INT32 = range(-(2**31), 2**31)
_INT64 = range(-(2**63), 2**63)
_NO_XML = re.compile(r"[^\t\n -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_PART = re.compile(r"[A-Za-z0-9_]+")


class Kind(IntEnum):
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


class UnsayableError(Exception):
    """A value that the other world has no word for; says why."""


@dataclass(frozen=True, slots=True, eq=False)
class Value:
    """A value in ROS 2's terms. Equal are those of one kind that read the same, NaN among them.

    Attributes:
        kind: its type.
        content: a bool, int, float, text, bytes, or a list of one of the first four; None where it is not set.
    """

    kind: Kind
    content: Any = None

    def __eq__(self, other: object) -> bool:
        """Whether both read the same."""
        return isinstance(other, Value) and (self.kind, repr(self.content)) == (other.kind, repr(other.content))

    def __hash__(self) -> int:
        """As `__eq__` has it."""
        return hash((self.kind, repr(self.content)))

    @classmethod
    def read(cls, message: Mapping[str, Any]) -> Value:
        """A decoded ``ParameterValue``."""
        try:
            kind = Kind(message["type"])
        except ValueError:
            return NOT_SET
        if kind is Kind.NOT_SET:
            return NOT_SET
        content = message[_field(kind)]
        if kind is Kind.BYTE_ARRAY:
            return cls(kind, bytes(content))
        return cls(kind, content.tolist() if isinstance(content, np.ndarray) else content)

    def message(self) -> dict[str, Any]:
        """For a ``ParameterValue``."""
        content = list(self.content) if self.kind is Kind.BYTE_ARRAY else self.content
        return {"type": int(self.kind), **({} if self.kind is Kind.NOT_SET else {_field(self.kind): content})}


NOT_SET = Value(Kind.NOT_SET)


def _field(kind: Kind) -> str:
    return f"{kind.name.lower()}_value"


def to_ros1(value: Value) -> Any:
    """What ROS 1's parameter server takes; raises `UnsayableError`."""
    content = value.content
    if value.kind is Kind.NOT_SET:
        msg = "it has no value"
        raise UnsayableError(msg)
    if value.kind is Kind.BYTE_ARRAY:
        return xmlrpc.client.Binary(content)
    for one in content if isinstance(content, list) else [content]:
        if isinstance(one, int) and one not in _INT32:
            msg = f"ROS 1 has no integer as large as {one}"
            raise UnsayableError(msg)
        if isinstance(one, str) and _NO_XML.search(one):
            msg = "its text has characters that ROS 1's XML cannot carry"
            raise UnsayableError(msg)
    return content


def to_ros2(value: Any, like: Kind = Kind.NOT_SET) -> Value:
    """What a ROS 2 node takes; raises `UnsayableError`.

    Args:
        value: from ROS 1's parameter server.
        like: the kind that the node's parameter has: whole numbers serve as doubles, and such doubles as integers,
            since `rosparam set` does not tell them apart. An empty list is of any kind.
    """
    if isinstance(value, xmlrpc.client.Binary):
        return Value(Kind.BYTE_ARRAY, value.data)
    if isinstance(value, list):
        return _list(value, like)
    found = _scalar(value)
    if found.kind is Kind.INTEGER and like is Kind.DOUBLE:
        return Value(Kind.DOUBLE, float(value))
    if found.kind is Kind.DOUBLE and like is Kind.INTEGER and value.is_integer() and int(value) in _INT64:
        return Value(Kind.INTEGER, int(value))
    return found


def _scalar(value: Any) -> Value:
    for python, kind in ((bool, Kind.BOOL), (int, Kind.INTEGER), (float, Kind.DOUBLE), (str, Kind.STRING)):
        if isinstance(value, python):
            if kind is Kind.INTEGER and value not in _INT64:
                break
            return Value(kind, value)
    msg = f"ROS 2 has no parameters like {type(value).__name__} {str(value)[:60]}"
    raise UnsayableError(msg)


def _list(values: list[Any], like: Kind) -> Value:
    kinds = {_scalar(one).kind for one in values}
    if not kinds:
        return Value(like if like >= Kind.BOOL_ARRAY else Kind.STRING_ARRAY, [])
    if kinds == {Kind.INTEGER, Kind.DOUBLE} or (kinds == {Kind.INTEGER} and like is Kind.DOUBLE_ARRAY):
        return Value(Kind.DOUBLE_ARRAY, [float(one) for one in values])
    if len(kinds) > 1:
        msg = f"ROS 2 has no lists of {' and '.join(sorted(kind.name.lower() for kind in kinds))}"
        raise UnsayableError(msg)
    return Value(Kind(kinds.pop() + Kind.BOOL_ARRAY - Kind.BOOL), list(values))


def flatten(tree: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """The parameters under a name of the parameter server by what follows it, ``a/b``; "" for that name itself."""
    if not isinstance(tree, dict):
        yield "", tree
    elif depth < MAX_DEPTH:
        for name, below in tree.items():
            for rest, value in flatten(below, depth + 1):
                yield f"{name}/{rest}" if rest else str(name), value


class Names:
    """The names that a rule takes, in both worlds; ``rest`` is what follows `ParameterRule.ros1`, ``a/b``."""

    def __init__(self, rule: ParameterRule) -> None:
        self.rule = rule
        self._globs = [glob_regex(glob.strip("/")) for glob in rule.names]

    def takes(self, rest: str) -> bool:
        """Whether the rule takes a parameter."""
        return any(glob.fullmatch(rest) for glob in self._globs)

    def ros1(self, rest: str) -> str:
        """The name on the parameter server."""
        return f"{self.rule.ros1}/{rest}" if rest else self.rule.ros1

    def ros2(self, rest: str) -> str:
        """The name on the node."""
        return ".".join(part for part in (self.rule.prefix, rest.replace("/", ".")) if part)

    def rest(self, ros2_name: str) -> str | None:
        """What of a node's parameter name follows; None where the rule does not take it, or ROS 1 has no such names."""
        name, prefix = ros2_name, self.rule.prefix
        if prefix:
            if name != prefix and not name.startswith(f"{prefix}."):
                return None
            name = name.removeprefix(prefix).removeprefix(".")
        elif not name:
            return None
        if name and not all(_PART.fullmatch(part) for part in name.split(".")):
            return None
        rest = name.replace(".", "/")
        return rest if self.takes(rest) else None
