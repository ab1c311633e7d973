"""Parses ``.msg`` texts: the fields of a ROS message in their order.

The grammar is ROS 1's (http://wiki.ros.org/msg) with ROS 2's equivalents: bounds (``string<=10``, ``int32[<=5]``),
default values, ``builtin_interfaces/Time``, and ``/msg/`` in names.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

MAX_TEXT = 1 << 20  # characters of the longest accepted definition
MAX_ARRAY = 1 << 24  # longest array of a fixed length

PRIMITIVES = {
    "bool": 1, "int8": 1, "uint8": 1, "byte": 1, "char": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4,
    "int64": 8, "uint64": 8, "float32": 4, "float64": 8,
}  # fmt: skip
"""The bytes of each numeric type."""

STRINGS = ("string", "wstring")
TIMES = ("time", "duration")

_SEPARATOR = re.compile(r"^={20,}[ \t]*$", re.MULTILINE)
_TYPE = re.compile(r"([A-Za-z][\w/]*)(?:<=\d+)?(\[(?:<=)?(\d*)\])?")
_LINE = re.compile(r"(\S+)\s+([A-Za-z_]\w*)\s*(?:(=)\s*(.*)|(\S.*))?")
_BUILTIN_TIMES = {"builtin_interfaces/Time": "time", "builtin_interfaces/Duration": "duration"}


class DefinitionError(ValueError):
    """Raised if a ``.msg`` text is invalid, or a type is unknown."""


Constants = dict[str, int | float | str | bool]


@dataclass(frozen=True, slots=True)
class MessageField:
    """A field of a message."""

    name: str
    type: str  # a numeric type, ``string``, ``time``, ``duration``, or a message's ``package/Name``
    is_array: bool = False
    length: int = 0  # of an array of a fixed length; else 0

    @property
    def is_message(self) -> bool:
        """Whether the type is another message."""
        return "/" in self.type


@dataclass(frozen=True, slots=True)
class MessageDefinition:
    """A message type, ``package/Name``, with its fields in the order of the text, and its constants by name."""

    name: str
    fields: tuple[MessageField, ...]
    constants: Constants


def full_name(name: str, package: str = "") -> str:
    """Return a type's name as ``package/Name``: from ``Header``, ``std_msgs/msg/String``, or a name in ``package``."""
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
    """Parse a text; return its definitions by name: first that of ``name``, then those of the nested types.

    The definition of a nested type follows a line of ``=`` and the line ``MSG: package/Name``. Raises
    `DefinitionError`, which names the type and the invalid line.
    """
    if len(text) > MAX_TEXT:
        raise DefinitionError(f"the definition of {name} is longer than {MAX_TEXT} characters")
    first, *sections = _SEPARATOR.split(text.replace("\r\n", "\n"))
    definitions = {full_name(name): _definition(first, full_name(name))}
    for part in sections:
        head, _, body = part.lstrip("\n").partition("\n")
        if not head.startswith("MSG:"):
            raise DefinitionError(
                f"the definition of {name} has a section that does not begin with 'MSG: package/Name' but {head[:60]!r}"
            )
        nested = full_name(head.removeprefix("MSG:").strip())
        definitions.setdefault(nested, _definition(body, nested))
    return definitions


def _definition(text: str, name: str) -> MessageDefinition:
    fields: dict[str, MessageField] = {}
    constants: Constants = {}
    package = name.split("/")[0]
    for number, line in enumerate(text.split("\n"), 1):
        try:
            _read_line(line.strip(), package, fields, constants)
        except (ValueError, KeyError) as err:
            place = f"line {number}, {line.strip()[:80]!r}"
            raise DefinitionError(f"invalid definition of {name}: {place}: {err}") from None
    return MessageDefinition(name, tuple(fields.values()), constants)


def _read_line(line: str, package: str, fields: dict[str, MessageField], constants: Constants) -> None:
    bare = line.partition("#")[0].strip()
    # A constant string extends to the end of its line, including comments.
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
        raise ValueError(f"two fields are named {name!r}")
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
    raise ValueError(f"constants cannot have the type {base!r}")
