"""Reads ``.msg`` text: what fields a ROS message has, in which order.

The grammar is ROS 1's (http://wiki.ros.org/msg), and of ROS 2's what names the same things otherwise: bounds
(``string<=10``, ``int32[<=5]``), default values, ``builtin_interfaces/Time``, names with ``/msg/`` between.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

MAX_TEXT = 1 << 20  # longest definition that is read, in characters
MAX_ARRAY = 1 << 24  # longest array of a fixed length

PRIMITIVES = {
    "bool": 1, "int8": 1, "uint8": 1, "byte": 1, "char": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4,
    "int64": 8, "uint64": 8, "float32": 4, "float64": 8,
}  # fmt: skip
"""Bytes of each number type."""

STRINGS = ("string", "wstring")
TIMES = ("time", "duration")

_SEPARATOR = re.compile(r"^={20,}[ \t]*$", re.MULTILINE)
_TYPE = re.compile(r"([A-Za-z][\w/]*)(?:<=\d+)?(\[(?:<=)?(\d*)\])?")
_LINE = re.compile(r"(\S+)\s+([A-Za-z_]\w*)\s*(?:(=)\s*(.*)|(\S.*))?")
_BUILTIN_TIMES = {"builtin_interfaces/Time": "time", "builtin_interfaces/Duration": "duration"}


class DefinitionError(ValueError):
    """A ``.msg`` text that cannot be read, or a type of which none is known."""


Constants = dict[str, int | float | str | bool]


@dataclass(frozen=True, slots=True)
class MessageField:
    """One field."""

    name: str  # its name
    type: str  # a number type, ``string``, ``time``, ``duration``, or another message's ``package/Name``
    is_array: bool = False  # whether it holds any number of these
    length: int = 0  # of an array of a fixed length; else 0

    @property
    def is_message(self) -> bool:
        """Whether its type is another message's."""
        return "/" in self.type


@dataclass(frozen=True, slots=True)
class MessageDefinition:
    """A message type, ``package/Name``, with its fields in the order of the text, and its constants by name."""

    name: str
    fields: tuple[MessageField, ...]
    constants: Constants


def full_name(name: str, package: str = "") -> str:
    """A type's name as ``package/Name``: ``Header``, ``std_msgs/msg/String`` and names within a package become that."""
    parts = [part for part in name.split("/") if part]
    if name == "Header" or name == "roslib/Header":
        return "std_msgs/Header"
    if len(parts) == 1 and package:
        return f"{package}/{parts[0]}"
    if len(parts) == 3 and parts[1] == "msg":
        return f"{parts[0]}/{parts[2]}"
    if len(parts) != 2:
        raise DefinitionError(f"{name!r} is not the name of a ROS message: write package/Name, as in std_msgs/String")
    return "/".join(parts)


def parse(text: str, name: str) -> dict[str, MessageDefinition]:
    """The definitions of a text by name: ``name``'s own, then those behind lines of ``=`` and ``MSG: package/Name``.

    Raises `DefinitionError`, which names the type and the line that cannot be read.
    """
    if len(text) > MAX_TEXT:
        raise DefinitionError(f"the definition of {name} is longer than {MAX_TEXT} characters")
    own, *rest = _SEPARATOR.split(text.replace("\r\n", "\n"))
    found = {full_name(name): _definition(own, full_name(name))}
    for part in rest:
        head, _, body = part.lstrip("\n").partition("\n")
        if not head.startswith("MSG:"):
            raise DefinitionError(
                f"the definition of {name} has a section that does not begin with 'MSG: package/Name' but {head[:60]!r}"
            )
        nested = full_name(head.removeprefix("MSG:").strip())
        found.setdefault(nested, _definition(body, nested))
    return found


def _definition(text: str, name: str) -> MessageDefinition:
    fields: dict[str, MessageField] = {}
    constants: Constants = {}
    package = name.split("/")[0]
    for number, line in enumerate(text.split("\n"), 1):
        try:
            _read_line(line.strip(), package, fields, constants)
        except (ValueError, KeyError) as err:
            where = f"line {number}, {line.strip()[:80]!r}"
            raise DefinitionError(f"the definition of {name} cannot be read: {where}: {err}") from None
    return MessageDefinition(name, tuple(fields.values()), constants)


def _read_line(line: str, package: str, fields: dict[str, MessageField], constants: Constants) -> None:
    bare = line.partition("#")[0].strip()
    # A constant string takes the rest of its line, comments and all.
    is_text = line.startswith(STRINGS) and "=" in bare.replace("<=", "")
    bare = line if is_text else bare
    if not bare:
        return
    match = _LINE.fullmatch(bare)
    if match is None:
        raise ValueError("expected '<type> <name>'")
    type_text, name, is_constant, value, _default = match.groups()
    if is_constant:
        constants[name] = _constant(type_text, value.strip())
        return
    if name in fields:
        raise ValueError(f"there are two fields named {name!r}")
    fields[name] = _field(type_text, name, package)


def _field(text: str, name: str, package: str) -> MessageField:
    match = _TYPE.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not a type")
    base, brackets, count = match.groups()
    if base not in PRIMITIVES and base not in STRINGS and base not in TIMES:
        base = full_name(base, package)
        base = _BUILTIN_TIMES.get(base, base)
    length = int(count) if count and "<=" not in brackets else 0
    if length > MAX_ARRAY:
        raise ValueError(f"an array of more than {MAX_ARRAY} elements")
    return MessageField(name, "string" if base in STRINGS else base, brackets is not None, length)


def _constant(type_text: str, value: str) -> int | float | str | bool:
    base = type_text.partition("<")[0]
    if base in STRINGS:
        return value
    if base == "bool":
        return {"true": True, "1": True, "false": False, "0": False}[value.lower()]
    if base.startswith("float"):
        return float(value)
    if base in PRIMITIVES:
        return int(value, 0)
    raise ValueError(f"no constant of type {base!r} exists")
