"""The model of a message definition: fields, constants, and nested types.

Type names have the form of their world: ``std_msgs/Header`` in ROS 1, ``std_msgs/msg/Header`` in ROS 2
(``pkg/srv/Name_Request`` and ``pkg/action/Name_Goal`` for the parts of services and actions).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from typing_extensions import override

DefaultValue = bool | int | float | str | tuple["DefaultValue", ...]


class World(Enum):
    """The language of a definition: that of ROS 1 or ROS 2."""

    ROS1 = "ROS 1"
    ROS2 = "ROS 2"


class Shape(Enum):
    """Whether a field has one value, a fixed number of values, or any number."""

    SINGLE = "single"
    ARRAY = "array"
    SEQUENCE = "sequence"


STRUCT_FORMATS: Mapping[str, str] = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
"""The `struct` format of each ROS 2 primitive."""

PRIMITIVE_SIZES: Mapping[str, int] = {base: struct.calcsize(f"<{code}") for base, code in STRUCT_FORMATS.items()}
"""Size of each primitive in both wire formats, bytes; ROS 1's ``byte`` is an int8 and ``char`` a uint8, ROS 2's
``byte`` is an octet."""

TIME_TYPES: Mapping[str, str] = {"time": "builtin_interfaces/msg/Time", "duration": "builtin_interfaces/msg/Duration"}
"""ROS 1's two built-in structures (each two 32-bit integers) and the corresponding ROS 2 messages."""

STRING_TYPES = frozenset({"string", "wstring"})


@dataclass(frozen=True, slots=True)
class FieldType:
    """The type of a field: its base type, and its bounds if it is an array, a sequence or a string."""

    base: str  #: a primitive, ``string``, ``wstring``, ROS 1's ``time`` or ``duration``, or the name of a message type
    shape: Shape = Shape.SINGLE  #: one value, a fixed array, or a sequence
    length: int = 0  #: number of elements of a fixed array; maximum of a sequence, 0 if unbounded
    string_bound: int = 0  #: maximum number of a string's bytes or a wstring's UTF-16 units, 0 if unbounded

    @property
    def nested(self) -> bool:
        """Whether the base is another message type."""
        return "/" in self.base

    @property
    def element(self) -> FieldType:
        """The type of one element of an array or sequence."""
        return FieldType(self.base, string_bound=self.string_bound)

    @override
    def __str__(self) -> str:
        """Return the type as spelled in definitions, with the full name of a nested type."""
        bound = f"<={self.string_bound}" if self.string_bound else ""
        match self.shape:
            case Shape.SINGLE:
                count = ""
            case Shape.ARRAY:
                count = f"[{self.length}]"
            case Shape.SEQUENCE:
                count = f"[<={self.length}]" if self.length else "[]"
        return f"{self.base}{bound}{count}"


@dataclass(frozen=True, slots=True)
class Field:
    """A field; ``default`` is ROS 2's default value, if the definition has one."""

    name: str
    type: FieldType
    default: DefaultValue | None = None


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant; ``text`` is the value exactly as written, since ROS 1's md5 covers it."""

    name: str
    base: str
    text: str


@dataclass(frozen=True, slots=True)
class Definition:
    """The definition of one message type, without those of its nested types."""

    name: str
    world: World
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = ()
    text: str = ""  #: the definition as its author wrote it, "" if it was generated

    @property
    def package(self) -> str:
        """The package that the type belongs to."""
        return self.name.split("/", 1)[0]

    def nested_names(self) -> list[str]:
        """Return the names of the message types that the fields use, each once, in order."""
        return list(dict.fromkeys(f.type.base for f in self.fields if f.type.nested))


TIME_DEFINITIONS: Mapping[str, Definition] = {
    "time": Definition("time", World.ROS1, (Field("secs", FieldType("uint32")), Field("nsecs", FieldType("uint32")))),
    "duration": Definition(
        "duration", World.ROS1, (Field("secs", FieldType("int32")), Field("nsecs", FieldType("int32")))
    ),
}
"""ROS 1's built-in structures as messages, for mapping rules that name their fields."""


@dataclass(frozen=True)
class Schema:
    """A message type together with all its nested types, so that it is unambiguous."""

    root: Definition
    types: Mapping[str, Definition]  #: the root and all nested types by name
    fingerprints: dict[str, str] = field(default_factory=dict, init=False, repr=False, compare=False)
    """The fingerprints that `bridge.messages.definitions.hashes` has computed, by function."""

    defaults: dict[tuple[str, str, int], bytes] = field(default_factory=dict, init=False, repr=False, compare=False)
    """The CDR of missing fields, by type, field and position modulo 8; see `bridge.messages.values`."""

    @property
    def name(self) -> str:
        """Name of the root type."""
        return self.root.name

    @property
    def world(self) -> World:
        """The language of the root type's definition."""
        return self.root.world

    def sub(self, name: str) -> Schema:
        """Return the schema of one of the nested types."""
        return Schema(self.types[name], self.types)

    def of(self, kind: FieldType) -> Definition | None:
        """Return the definition of a field's type; None for a primitive or a string."""
        return self.types[kind.base] if kind.nested else TIME_DEFINITIONS.get(kind.base)

    def nested_order(self) -> list[str]:
        """Return the names of the nested types in order of first use, without the root."""
        order: dict[str, None] = {}
        waiting = list(reversed(self.root.nested_names()))
        while waiting:
            name = waiting.pop()
            if name in order or name == self.root.name:
                continue
            order[name] = None
            waiting.extend(reversed(self.types[name].nested_names()))
        return list(order)
