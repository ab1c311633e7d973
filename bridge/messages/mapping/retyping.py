"""Converts messages between two versions of a type in which fields have different primitive types.

Numbers convert to numbers and to text, and text converts to a number if it spells one. Values are kept or rounded; a
message with a value that does not fit is refused. The messages are decoded, so this is slower than the virtual machine
of `bridge.messages.transcode`, which converts messages of all other types.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping
from typing import Any

from typing_extensions import override

from bridge.messages.definitions.schema import PRIMITIVE_SIZES, STRING_TYPES, FieldType, Schema, Shape
from bridge.messages.errors import ConversionError
from bridge.messages.mapping.fields import FieldPath, Fields, field_at
from bridge.messages.transcode.conversion import check_cdr
from bridge.messages.values import MessageReader, MessageWriter, dtype, is_array, join, wrong

_INTEGER = re.compile(r"[+-]?\d{1,20}", re.ASCII)
_NUMBER = re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|inf|nan)", re.ASCII | re.IGNORECASE)
_MANTISSA = {"float32": 24, "float64": 53}
"""The number of bits up to which each type holds every integer exactly."""


def obstacle(source: FieldType, target: FieldType) -> str:
    """Return why values of a field cannot become values of a field with another type; "" if they can."""
    if source.nested or target.nested:
        return "a nested message cannot become another type; name its fields by their paths"
    if source.shape is not target.shape or (source.shape is Shape.ARRAY and source.length != target.length):
        return "only one field is an array, or the arrays differ in length or kind"
    if "bool" in (source.base, target.base) and STRING_TYPES & {source.base, target.base}:
        return "text cannot be converted to or from bool"
    return ""


def effect(source: str, target: str) -> str:
    """Return what happens to values of type ``source`` that are converted to ``target``; "" if all stay the same."""
    if target in STRING_TYPES or source == target:
        return ""
    if source in STRING_TYPES:
        return "must be a text with a number, or its message is refused"
    if target in _MANTISSA:
        exact = _MANTISSA[target] >= (_MANTISSA[source] if source in _MANTISSA else _range(source)[1].bit_length())
        return "" if exact else f"is rounded to {target}"
    if source in _MANTISSA:
        return f"is rounded to {target}, and its message is refused beyond the range"
    (low1, high1), (low2, high2) = _range(source), _range(target)
    return "" if low2 <= low1 and high1 <= high2 else f"must be in the range of {target}, or its message is refused"


def _range(base: str) -> tuple[int, int]:
    """Return the least and the greatest value of an integer type or a bool."""
    if base == "bool":
        return 0, 1
    bits = 8 * PRIMITIVE_SIZES[base]
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if base.startswith("int") else (0, (1 << bits) - 1)


class RetypingConverter:
    """Converts messages between two versions in which a field has different primitive types.

    Args:
        source: the version of the messages.
        target: the other version, with default values for its fields.
        fields: the corresponding fields, by the names of a message and its counterpart.
    """

    def __init__(self, source: Schema, target: Schema, fields: Mapping[tuple[str, str], Fields]) -> None:
        self._source, self._target, self._fields = source, target, fields
        self._check = check_cdr(source)

    def convert(self, payload: bytes) -> bytes:
        """Return the converted message; raises `ConversionError`."""
        message = _Reader(self._source, self._check(payload)).message()
        return _Writer(self._target).message(self._structure(self._source.name, self._target.name, message, ""))

    def _structure(self, name1: str, name2: str, message: Mapping[str, Any], where: str) -> dict[str, Any]:
        source, target = self._source.sub(name1), self._target.sub(name2)
        converted: dict[str, Any] = {}
        for path1, path2 in self._fields[name1, name2]:
            kind1, kind2 = field_at(source, path1), field_at(target, path2)
            assert kind1 is not None
            assert kind2 is not None
            inner = converted
            for step in path2[:-1]:
                inner = inner.setdefault(step, {})
            inner[path2[-1]] = self._value(kind1, kind2, _at(message, path1), join(where, ".".join(path1)))
        return converted

    def _value(self, source: FieldType, target: FieldType, value: Any, where: str) -> Any:
        if source.nested:
            if source.shape is Shape.SINGLE:
                return self._structure(source.base, target.base, value, where)
            return [self._structure(source.base, target.base, item, where) for item in value]
        if source.base == target.base:
            return value
        if source.shape is Shape.SINGLE:
            return _element(source.base, target.base, value, where)
        if is_array(value) and target.base not in STRING_TYPES:
            return _numbers(target.base, value, where)
        return [
            _element(source.base, target.base, item, where) for item in (value.tolist() if is_array(value) else value)
        ]


def _at(message: Mapping[str, Any], path: FieldPath) -> Any:
    value: Any = message
    for step in path:
        value = value[step]
    return value


def _element(source: str, target: str, value: Any, where: str) -> Any:
    """Convert one value; the writer refuses numbers beyond the range of ``target``."""
    if target in STRING_TYPES:
        return value if source in STRING_TYPES else _text(source, value)
    if source in STRING_TYPES:
        pattern, number = (_NUMBER, float) if target in _MANTISSA else (_INTEGER, int)
        if not pattern.fullmatch(value.strip()):
            raise wrong(where, "a text with a number", value)
        value = number(value)
    elif source == "bool":
        value = int(value)
    if target in _MANTISSA:
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise wrong(where, target, value)
        value = round(value)
    if target != "bool":
        return value
    if value not in (0, 1):
        raise wrong(where, target, value)
    return bool(value)


def _text(base: str, value: float) -> str:
    """Return the shortest text that reads back as the same value of type ``base``."""
    if base != "float32" or not math.isfinite(value):
        return repr(value)
    texts = (f"{value:.{digits}g}" for digits in range(1, 10))
    return next(text for text in texts if struct.unpack("<f", struct.pack("<f", float(text)))[0] == value)


def _numbers(base: str, values: Any, where: str) -> Any:
    """Convert an array of numbers to type ``base``."""
    import numpy as np

    if base in _MANTISSA:
        with np.errstate(over="ignore"):
            converted = values.astype(dtype(base))
        fits = bool((np.isfinite(converted) == np.isfinite(values)).all())
    else:
        converted, (low, high) = np.rint(values) if values.dtype.kind == "f" else values, _range(base)
        fits = not len(values) or (low <= converted.min().item() and converted.max().item() <= high)
    if not fits:
        raise ConversionError(f"{where} has a value that does not fit {base}")
    return converted.astype(dtype(base))


class _Reader(MessageReader):
    """Reads strings without loss, including those that are not UTF-8."""

    @override
    def element(self, kind: FieldType) -> Any:
        if kind.base != "string":
            return super().element(kind)
        length = int(self.number("uint32"))
        content = self.read_bytes(1, length)
        return str(content[: length - 1], "utf-8", "surrogateescape")


class _Writer(MessageWriter):
    """Writes the strings that `_Reader` reads."""

    @override
    def text(self, kind: FieldType, value: Any, where: str) -> None:
        if kind.base != "string":
            super().text(kind, value, where)
            return
        content = value.encode("utf-8", "surrogateescape")
        if kind.string_bound and len(content) > kind.string_bound:
            raise ConversionError(f"{where} must have at most {kind.string_bound} bytes, not {len(content)}")
        self.number("uint32", len(content) + 1, where)
        self.data += content + b"\0"
