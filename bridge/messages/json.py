"""Messages as JSON values, for people and scripts: ``topic echo`` and ``topic pub``.

A message is an object with ROS 2's field names. What JSON cannot say itself: arrays of octets (``uint8``, ``byte``,
``char``) are base64 text, NaN and the infinities are the texts ``"NaN"``, ``"Infinity"`` and ``"-Infinity"``. On the
way back lists of numbers are taken for octets too, fields that are not given have their defaults, and an unknown field
is an error.
"""

from __future__ import annotations

import base64
import difflib
import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bridge.messages.definition import (
    PRIMITIVE_SIZES,
    STRING_TYPES,
    STRUCT_FORMATS,
    Definition,
    Field,
    FieldType,
    Schema,
    Shape,
)
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry

OCTETS = frozenset({"uint8", "byte", "char"})
"""Primitives whose arrays are written as base64."""

_HEADER = b"\0\1\0\0"
_NOT_NUMBERS = {"nan": math.nan, "infinity": math.inf, "inf": math.inf, "-infinity": -math.inf, "-inf": -math.inf}


def to_json(registry: Registry, type_name: str, cdr: bytes, type_hash: str = "") -> dict[str, Any]:
    """Decode a message.

    Args:
        registry: where the type is looked up.
        type_name: ROS 2 name.
        cdr: the message as it is on the hub, with its encapsulation header.
        type_hash: the very definition that is meant, "" for the one known here.

    Raises:
        MessageTypeError: the type is unknown.
        ConversionError: the bytes are no such message.
    """
    checked = registry.hub_check(type_name, type_hash)(cdr)
    schema = registry.schema(type_name, type_hash)
    return _Reader(schema, checked).structure(schema.root)


def from_json(registry: Registry, type_name: str, value: Mapping[str, Any], type_hash: str = "") -> bytes:
    """Encode a message for the hub; fields that are missing have their defaults.

    Raises:
        MessageTypeError: the type is unknown.
        ConversionError: a field is unknown or its value does not fit; names the field.
    """
    check = registry.hub_check(type_name, type_hash)
    schema = registry.schema(type_name, type_hash)
    writer = _Writer(schema)
    writer.structure(schema.root, value, "")
    return check(_HEADER + bytes(writer.data))


class _Reader:
    """Reads a message that was checked before."""

    def __init__(self, schema: Schema, cdr: bytes) -> None:
        self.schema = schema
        self.data = cdr
        self.at = len(_HEADER)

    def structure(self, definition: Definition) -> dict[str, Any]:
        if not definition.fields:
            self.at += 1
        return {field.name: self.value(field.type) for field in definition.fields}

    def value(self, kind: FieldType) -> Any:
        if kind.shape is Shape.SINGLE:
            return self.element(kind)
        count = kind.length if kind.shape is Shape.ARRAY else int(self.number("uint32"))
        if kind.base in PRIMITIVE_SIZES:
            return self.numbers(kind.base, count)
        return [self.element(kind.element) for _ in range(count)]

    def element(self, kind: FieldType) -> Any:
        if kind.nested:
            return self.structure(self.schema.types[kind.base])
        if kind.base == "string":
            end = int(self.number("uint32")) + self.at
            start, self.at = self.at, end
            return self.data[start : end - 1].decode(errors="replace")
        if kind.base == "wstring":
            units = np.frombuffer(self.take(4, 4 * int(self.number("uint32"))), "<u4")
            return units.astype("<u2").tobytes().decode("utf-16-le", errors="replace")
        return _plain(self.number(kind.base), kind.base)

    def number(self, base: str) -> Any:
        size = PRIMITIVE_SIZES[base]
        return struct.unpack("<" + STRUCT_FORMATS[base], self.take(size, size))[0]

    def numbers(self, base: str, count: int) -> Any:
        size = PRIMITIVE_SIZES[base]
        content = self.take(size, count * size) if count else b""
        if base in OCTETS:
            return base64.b64encode(content).decode()
        values = np.frombuffer(content, np.dtype(STRUCT_FORMATS[base]).newbyteorder("<")).tolist()
        return [_plain(value, base) for value in values] if base.startswith("float") else values

    def take(self, alignment: int, size: int) -> bytes:
        self.at += -(self.at - len(_HEADER)) % alignment
        start, self.at = self.at, self.at + size
        return self.data[start : self.at]


class _Writer:
    """Writes a message; ``where`` is the path of the value at hand, for errors."""

    def __init__(self, schema: Schema) -> None:
        self.schema = schema
        self.data = bytearray()

    def structure(self, definition: Definition, value: Any, where: str) -> None:
        if not isinstance(value, Mapping):
            raise _wrong(where, f"an object with the fields of {definition.name}", value)
        names = [field.name for field in definition.fields]
        for name in value:
            if name not in names:
                near = difflib.get_close_matches(str(name), names, 1)
                hint = f"did you mean {near[0]!r}?" if near else f"its fields: {', '.join(names) or 'none'}"
                msg = f"{definition.name} has no field {_join(where, str(name))!r}; {hint}"
                raise ConversionError(msg)
        if not definition.fields:
            self.data.append(0)
        for field in definition.fields:
            given = value[field.name] if field.name in value else _default(field)
            self.value(field.type, given, _join(where, field.name))

    def value(self, kind: FieldType, value: Any, where: str) -> None:
        if kind.shape is Shape.SINGLE:
            self.element(kind, value, where)
            return
        items = _items(kind, value, where)
        if kind.shape is Shape.ARRAY and len(items) != kind.length:
            raise ConversionError(f"{where} has {kind.length} elements, not {len(items)}")
        if kind.shape is Shape.SEQUENCE:
            if kind.length and len(items) > kind.length:
                raise ConversionError(f"{where} has at most {kind.length} elements, not {len(items)}")
            self.number("uint32", len(items), where)
        if isinstance(items, bytes):
            self.data += items
            return
        for number, item in enumerate(items):
            self.element(kind.element, item, f"{where}[{number}]")

    def element(self, kind: FieldType, value: Any, where: str) -> None:
        if kind.nested:
            self.structure(self.schema.types[kind.base], value, where)
        elif kind.base in PRIMITIVE_SIZES:
            self.number(kind.base, value, where)
        else:
            self.text(kind, value, where)

    def text(self, kind: FieldType, value: Any, where: str) -> None:
        if not isinstance(value, str):
            raise _wrong(where, "text", value)
        wide = kind.base == "wstring"
        try:
            content = value.encode("utf-16-le" if wide else "utf-8")
        except UnicodeEncodeError as err:
            raise ConversionError(f"{where} cannot be encoded: {err}") from None
        length = len(content) // 2 if wide else len(content)
        if kind.string_bound and length > kind.string_bound:
            raise ConversionError(f"{where} has at most {kind.string_bound} characters, not {length}")
        if wide:
            self.number("uint32", length, where)
            self.data += np.frombuffer(content, "<u2").astype("<u4").tobytes()
        else:
            self.number("uint32", length + 1, where)
            self.data += content + b"\0"

    def number(self, base: str, value: Any, where: str) -> None:
        size = PRIMITIVE_SIZES[base]
        self.data += bytes(-len(self.data) % size)
        try:
            self.data += struct.pack("<" + STRUCT_FORMATS[base], _number(base, value, where))
        except (struct.error, OverflowError):
            raise _wrong(where, base, value) from None


def _number(base: str, value: Any, where: str) -> bool | int | float:
    """The value as ``base`` wants it; never a bool for a number or the other way round."""
    if base == "bool":
        if isinstance(value, bool):
            return value
    elif base.startswith("float"):
        if isinstance(value, str) and value.lower() in _NOT_NUMBERS:
            return _NOT_NUMBERS[value.lower()]
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
    elif not isinstance(value, bool) and (isinstance(value, int) or (isinstance(value, float) and value.is_integer())):
        return int(value)
    raise _wrong(where, base, value)


def _items(kind: FieldType, value: Any, where: str) -> Sequence[Any] | bytes:
    """The elements of an array or sequence."""
    if kind.base in OCTETS and isinstance(value, str):
        try:
            return base64.b64decode(value, validate=True)
        except ValueError as err:  # binascii.Error, or what is no ASCII
            raise ConversionError(f"{where} is no base64 text: {err}") from None
    if kind.base in OCTETS and isinstance(value, bytes | bytearray):
        return bytes(value)
    if isinstance(value, list | tuple):
        return value
    raise _wrong(where, "a list" + (" or base64 text" if kind.base in OCTETS else ""), value)


def _default(field: Field) -> Any:
    """The value of a field that is not given."""
    if field.default is not None:
        return field.default
    kind = field.type
    if kind.shape is Shape.SEQUENCE:
        return ()
    single: Any = {} if kind.nested else "" if kind.base in STRING_TYPES else False if kind.base == "bool" else 0
    return single if kind.shape is Shape.SINGLE else (single,) * kind.length


def _plain(value: Any, base: str) -> Any:
    """A number as JSON has it; the digits of a float32 are no more than it holds."""
    if isinstance(value, float):
        if not math.isfinite(value):
            return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
        if base == "float32":
            return float(str(np.float32(value)))
    return value


def _join(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _wrong(where: str, wanted: str, value: Any) -> ConversionError:
    shown = repr(value)
    return ConversionError(
        f"{where or 'the message'} is {wanted}, not {shown[:60] + ('...' if len(shown) > 60 else '')}"
    )
