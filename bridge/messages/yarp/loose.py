"""A ROS 1 message from a Bottle that says it in other words than YARP's own converter would.

People write Bottles by hand: an integer where a float is meant, lists of one type, blobs. What is wanted is the right
number of values in each list, and values that fit; the error names the field.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from bridge.messages.definition import (
    PRIMITIVE_SIZES,
    STRUCT_FORMATS,
    TIME_DEFINITIONS,
    Definition,
    FieldType,
    Schema,
    Shape,
)
from bridge.messages.errors import ConversionError
from bridge.messages.values import DTYPES, join, wrong
from yarp_compat.wire.text import to_text

_SIGNED = {"byte": "b", "char": "B"}
"""ROS 1's ``byte`` is signed, unlike ROS 2's."""


def to_ros1(schema: Schema, values: Sequence[Any]) -> bytes:
    """A message's ROS 1 bytes from the values of its Bottle.

    Raises:
        ConversionError: the Bottle has the wrong shape, or a value does not fit; names the field.
    """
    writer = _Writer(schema)
    writer.message(schema.root, values, "")
    return b"".join(writer.out)


class _Writer:
    def __init__(self, schema: Schema) -> None:
        self._schema = schema
        self.out: list[bytes] = []

    def message(self, definition: Definition, values: Any, where: str) -> None:
        if not isinstance(values, list | tuple | np.ndarray):
            raise wrong(where, f"a list of the fields of {definition.name}", values)
        if len(values) != len(definition.fields):
            names = " ".join(field.name for field in definition.fields)
            raise ConversionError(
                f"{where or 'the Bottle'} has {len(values)} values, and a {definition.name} has the"
                f" {len(definition.fields)} fields ({names}): {shown(values)}"
            )
        for field, value in zip(definition.fields, values, strict=True):
            self._field(field.type, value, join(where, field.name))

    def _field(self, kind: FieldType, value: Any, where: str) -> None:
        if kind.shape is Shape.SINGLE:
            self._element(kind, value, where)
            return
        if isinstance(value, bytes) and PRIMITIVE_SIZES.get(kind.base) == 1:
            value = np.frombuffer(value, DTYPES[kind.base])
        if not isinstance(value, list | tuple | np.ndarray):
            raise wrong(where, "a list", value)
        if kind.shape is Shape.ARRAY and len(value) != kind.length:
            raise ConversionError(f"{where} has {kind.length} elements, not {len(value)}")
        if kind.shape is Shape.SEQUENCE:
            self.out.append(struct.pack("<I", len(value)))
        if isinstance(value, np.ndarray) and kind.base.startswith("float") and value.dtype.kind in "fi":
            with np.errstate(over="ignore", invalid="ignore"):
                self.out.append(value.astype(DTYPES[kind.base]).tobytes())
            return
        for number, item in enumerate(value.tolist() if isinstance(value, np.ndarray) else value):
            self._element(kind.element, item, f"{where}[{number}]")

    def _element(self, kind: FieldType, value: Any, where: str) -> None:
        nested = TIME_DEFINITIONS.get(kind.base) or (self._schema.types[kind.base] if kind.nested else None)
        if nested is not None:
            self.message(nested, value, where)
        elif kind.base == "string":
            if not isinstance(value, str):
                raise wrong(where, "text", value)
            content = value.encode("utf-8", "surrogateescape")
            self.out.append(struct.pack("<I", len(content)) + content)
        else:
            self.out.append(pack_number(kind.base, value, where, _SIGNED.get(kind.base, STRUCT_FORMATS[kind.base])))


def pack_number(base: str, value: Any, where: str, code: str) -> bytes:
    """A number's bytes; a negative one stands for the unsigned of the same bits, as YARP writes those."""
    if isinstance(value, np.generic):
        value = value.item()
    if base == "bool":
        if isinstance(value, bool | int):
            return b"\1" if value else b"\0"
    elif isinstance(value, int | float):
        if base.startswith("float"):
            value = float(value)
        elif isinstance(value, float) and value.is_integer():
            value = int(value)
        if code in "BHIQ" and isinstance(value, int) and value < 0:
            code = code.lower()
        try:
            return struct.pack("<" + code, value)
        except (struct.error, OverflowError):
            pass
    raise wrong(where, base, value)


def shown(values: Any) -> str:
    """The beginning of a Bottle as people write it, for errors."""
    values = values.tolist() if isinstance(values, np.ndarray) else values
    text = to_text(values[:20])
    return text[:80] + ("..." if len(text) > 80 or len(values) > 20 else "")
