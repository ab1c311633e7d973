"""Messages as Python values: a message is a mapping with ROS 2's field names, and an array of numbers a numpy array.

Subclasses, such as those in `bridge.messages.json`, may represent single numbers and arrays differently.
numpy is imported with the first array, because a worker that only forwards bytes does not need its 6 MB.
"""

from __future__ import annotations

import difflib
import functools
import struct
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeGuard

from bridge.messages.definitions.schema import (
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

if TYPE_CHECKING:
    import numpy as np

HEADER = b"\0\1\0\0"  # header of little-endian CDR
_STRUCTS = {base: struct.Struct("<" + code) for base, code in STRUCT_FORMATS.items()}


@functools.cache
def dtype(base: str) -> np.dtype[Any]:
    """Return numpy's type for a ROS 2 primitive."""
    import numpy as np

    return np.dtype("<" + STRUCT_FORMATS[base])


def is_array(value: object) -> TypeGuard[np.ndarray]:
    """Whether a value is a numpy array; the check does not import numpy."""
    return isinstance(value, getattr(sys.modules.get("numpy"), "ndarray", ()))


class MessageReader:
    """Reads a message that has been checked; arrays of numbers share the message's memory."""

    def __init__(self, schema: Schema, cdr: bytes) -> None:
        self.schema = schema
        self.data = memoryview(cdr)
        self.at = len(HEADER)

    def message(self) -> dict[str, Any]:
        """Read the whole message."""
        return self.structure(self.schema.root)

    def structure(self, definition: Definition) -> dict[str, Any]:
        """Read a nested message."""
        if not definition.fields:
            self.at += 1
        single = Shape.SINGLE
        return {
            field.name: self.element(field.type) if field.type.shape is single else self.value(field.type)
            for field in definition.fields
        }

    def value(self, kind: FieldType) -> Any:
        """Read an array or a sequence."""
        count = kind.length if kind.shape is Shape.ARRAY else int(self.number("uint32"))
        if kind.base in PRIMITIVE_SIZES:
            size = PRIMITIVE_SIZES[kind.base]
            return self.numbers(self.read_bytes(size, count * size) if count else b"", kind.base)
        return [self.element(kind.element) for _ in range(count)]

    def element(self, kind: FieldType) -> Any:
        """Read a field of one value, or one element of an array."""
        base = kind.base
        struct_ = _STRUCTS.get(base)
        if struct_ is not None:  # true of most fields; repeats `number` to save a call
            start = self.at + -(self.at - 4) % struct_.size
            self.at = start + struct_.size
            return self.plain(struct_.unpack_from(self.data, start)[0], base)
        if kind.nested:
            return self.structure(self.schema.types[base])
        if base == "string":
            end = int(self.number("uint32")) + self.at
            start, self.at = self.at, end
            return str(self.data[start : end - 1], "utf-8", "replace")
        units = self.read_bytes(4, 4 * int(self.number("uint32")))  # a wstring: two of every four bytes
        content = bytearray(len(units) // 2)
        content[::2], content[1::2] = units[::4], units[1::4]
        return content.decode("utf-16-le", errors="replace")

    def plain(self, value: Any, base: str) -> Any:  # noqa: ARG002 - for subclasses
        """Return one number in the form that the caller gets."""
        return value

    def numbers(self, content: memoryview | bytes, base: str) -> Any:
        """Return an array of numbers in the form that the caller gets."""
        import numpy as np

        return np.frombuffer(content, dtype(base))

    def number(self, base: str) -> Any:
        """Read the next number."""
        struct_ = _STRUCTS[base]
        start = self.at + -(self.at - len(HEADER)) % struct_.size
        self.at = start + struct_.size
        return struct_.unpack_from(self.data, start)[0]

    def read_bytes(self, alignment: int, size: int) -> memoryview:
        """Skip the padding, and read the next bytes."""
        self.at += -(self.at - len(HEADER)) % alignment
        start, self.at = self.at, self.at + size
        return self.data[start : self.at]


class MessageWriter:
    """Writes a message; ``where`` is the path of the current value, for errors."""

    def __init__(self, schema: Schema) -> None:
        self.schema = schema
        self.data = bytearray()

    def message(self, value: Mapping[str, Any]) -> bytes:
        """Write a message in CDR, with defaults for missing fields; raises `ConversionError`, which names the field."""
        self.structure(self.schema.root, value, "")
        return HEADER + self.data

    def structure(self, definition: Definition, value: Any, where: str) -> None:
        """Write a nested message."""
        if not isinstance(value, Mapping):
            raise wrong(where, f"an object with the fields of {definition.name}", value)
        names = [field.name for field in definition.fields]
        for name in value:
            if name not in names:
                near = difflib.get_close_matches(str(name), names, 1)
                hint = f"did you mean {near[0]!r}?" if near else f"its fields: {', '.join(names) or 'none'}"
                raise ConversionError(f"{definition.name} has no field {join(where, str(name))!r}; {hint}")
        if not definition.fields:
            self.data.append(0)
        for field in definition.fields:
            if field.name in value:
                self.value(field.type, value[field.name], join(where, field.name))
            else:
                self.default(definition, field, where)

    def default(self, definition: Definition, field: Field, where: str) -> None:
        """Write a missing field; its bytes, which depend on the padding, are kept in the schema."""
        start = len(self.data)
        place = definition.name, field.name, start % 8
        kept = self.schema.defaults.get(place)
        if kept is not None:
            self.data += kept
            return
        self.write_default(field, where)
        self.schema.defaults[place] = bytes(self.data[start:])

    def write_default(self, field: Field, where: str) -> None:
        """Write a missing field value by value."""
        self.value(field.type, _default(field), join(where, field.name))

    def value(self, kind: FieldType, value: Any, where: str) -> None:
        """Write a field."""
        if kind.shape is Shape.SINGLE:
            self.element(kind, value, where)
            return
        items = self.items(kind, value, where)
        if kind.shape is Shape.ARRAY and len(items) != kind.length:
            raise ConversionError(f"{where} must have {kind.length} elements, not {len(items)}")
        if kind.shape is Shape.SEQUENCE:
            if kind.length and len(items) > kind.length:
                raise ConversionError(f"{where} must have at most {kind.length} elements, not {len(items)}")
            self.number("uint32", len(items), where)
        if isinstance(items, bytes):
            self.data += items
            return
        if is_array(items):
            import numpy as np

            self.align(PRIMITIVE_SIZES[kind.base] if len(items) else 1)
            with np.errstate(over="ignore", invalid="ignore"):  # values that are too large become infinite
                self.data += np.ascontiguousarray(items, dtype(kind.base)).view(np.uint8).data
            return
        for number, item in enumerate(items):
            self.element(kind.element, item, f"{where}[{number}]")

    def items(self, kind: FieldType, value: Any, where: str) -> Sequence[Any] | np.ndarray | bytes:
        """Return the elements of an array or sequence."""
        if is_array(value) and value.ndim == 1 and kind.base in PRIMITIVE_SIZES:
            return value
        if isinstance(value, list | tuple):
            return value
        raise wrong(where, "a list", value)

    def element(self, kind: FieldType, value: Any, where: str) -> None:
        """Write a field of one value, or one element of an array."""
        if kind.nested:
            self.structure(self.schema.types[kind.base], value, where)
        elif kind.base in PRIMITIVE_SIZES:
            self.number(kind.base, value, where)
        else:
            self.text(kind, value, where)

    def text(self, kind: FieldType, value: Any, where: str) -> None:
        """Write a string."""
        if not isinstance(value, str):
            raise wrong(where, "text", value)
        wide = kind.base == "wstring"
        try:
            content = value.encode("utf-16-le" if wide else "utf-8")
        except UnicodeEncodeError as err:
            raise ConversionError(f"{where} cannot be encoded: {err}") from None
        length = len(content) // 2 if wide else len(content)
        if kind.string_bound and length > kind.string_bound:
            unit = "UTF-16 units" if wide else "bytes"
            raise ConversionError(f"{where} must have at most {kind.string_bound} {unit}, not {length}")
        if wide:
            self.number("uint32", length, where)
            units = bytearray(2 * len(content))
            units[::4], units[1::4] = content[::2], content[1::2]
            self.data += units
        else:
            self.number("uint32", length + 1, where)
            self.data += content + b"\0"

    def number(self, base: str, value: Any, where: str) -> None:
        """Write a number."""
        self.align(PRIMITIVE_SIZES[base])
        try:
            self.data += struct.pack("<" + STRUCT_FORMATS[base], self.plain(base, value, where))
        except (struct.error, OverflowError):
            raise wrong(where, base, value) from None

    def plain(self, base: str, value: Any, where: str) -> bool | int | float:
        """Return the value in the form for ``base``; a bool is not accepted as a number, nor a number as a bool."""
        if base == "bool":
            if isinstance(value, bool):
                return value
        elif base.startswith("float"):
            if isinstance(value, int | float) and not isinstance(value, bool):
                return float(value)
        elif not isinstance(value, bool) and (
            isinstance(value, int) or (isinstance(value, float) and value.is_integer())
        ):
            return int(value)
        raise wrong(where, base, value)

    def align(self, alignment: int) -> None:
        """Pad to a multiple of ``alignment``."""
        self.data += bytes(-len(self.data) % alignment)


def _default(field: Field) -> Any:
    """Return the value of a field that is missing."""
    if field.default is not None:
        return field.default
    kind = field.type
    if kind.shape is Shape.SEQUENCE:
        return ()
    if kind.shape is Shape.ARRAY and kind.base in PRIMITIVE_SIZES:
        import numpy as np

        return np.zeros(kind.length, dtype(kind.base))
    single: Any = {} if kind.nested else "" if kind.base in STRING_TYPES else False if kind.base == "bool" else 0
    return single if kind.shape is Shape.SINGLE else (single,) * kind.length


def join(where: str, name: str) -> str:
    """Return the path of the field ``name`` of the message at the path ``where``."""
    return f"{where}.{name}" if where else name


def wrong(where: str, wanted: str, value: Any) -> ConversionError:
    """Return the error for a value that does not fit its field."""
    shown = repr(value)
    return ConversionError(
        f"{where or 'the message'} must be {wanted}, not {shown[:60] + ('...' if len(shown) > 60 else '')}"
    )
