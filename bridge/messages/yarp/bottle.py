"""The default content of a port: the Bottle that YARP's own converter creates from a ROS message.

The Bottle has the fields of the ROS 1 type, because YARP's converter supports only ROS 1 types: the header has ``seq``,
which ROS 2's header lacks. Bottles written by hand are accepted, too. They may have integers in place of floats, and
may use typed lists and blobs; but each list must have the right number of values, and each value must fit. Errors name
the field.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.messages.definitions.schema import (
    PRIMITIVE_SIZES,
    STRUCT_FORMATS,
    TIME_DEFINITIONS,
    Definition,
    FieldType,
    Schema,
    Shape,
    World,
)
from bridge.messages.definitions.text import closure, parse_full
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.messages.values import dtype, join, wrong
from bridge.messages.yarp.codec import Codec, EncodedMessage, has_header, stamp_of, with_stamp
from bridge.messages.yarp.layout import Layout, MismatchError
from yarp_compat.wire import binary
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import to_text

Convert = Callable[[bytes], bytes]


class RosBottle(Codec):
    """Messages as nested lists in field order, converted via the ROS 1 serialization.

    ``stamped`` means that the messages begin with a header.
    """

    def __init__(
        self, schema: Schema, to_ros1: Convert, to_cdr: Convert, profile: Profile, *, stamped: bool = False
    ) -> None:
        self._profile, self._stamped = profile, stamped
        self._to_ros1, self._to_cdr = to_ros1, to_cdr
        self._schema = schema
        self._layouts = {known: Layout(self._schema, known) for known in Profile}

    @override
    def to_yarp(self, cdr: bytes) -> EncodedMessage:
        bottle = self._layouts[self._profile].to_bottle(self._to_ros1(cdr))
        return EncodedMessage([bottle], (stamp_of(cdr) or None) if self._stamped else None)

    @override
    def to_hub(self, payload: Buffer, profile: Profile | None, stamp_ns: int | None) -> bytes:
        """Convert a Bottle as `Codec` specifies, including one written by hand."""
        data = bytes(payload)
        try:
            ros1 = self._layouts[profile or self._profile].to_ros1(data)
        except MismatchError:
            ros1 = to_ros1(self._schema, decode_arrays(data, profile))
        cdr = self._to_cdr(ros1)
        return with_stamp(cdr, stamp_ns) if self._stamped else cdr


class BottleCodec(RosBottle):
    """Messages of one type as nested lists in field order; raises `MessageTypeError`."""

    def __init__(self, registry: Registry, type_name: str, type_hash: str, profile: Profile) -> None:
        out = registry.hub_to_ros1(type_name, type_hash)
        back = registry.ros1_to_hub(out.target.name, out.target.type_id)
        assert out.convert is not None
        assert back.convert is not None
        stamped = has_header(registry.schema(type_name, type_hash))
        schema = ros1_schema(out.target.name, out.target.definition)
        super().__init__(schema, out.convert, back.convert, profile, stamped=stamped)


def ros1_schema(name: str, definition: str) -> Schema:
    """Return a ROS 1 type with its nested types, from its full definition."""
    types = parse_full(definition, name, World.ROS1)
    return closure(types[name], types)


def decode_arrays(data: Buffer, profile: Profile | None) -> Any:
    """Decode a Bottle. Each list of numbers becomes an array, including the Bottle itself if it is such a list.

    Raises `ConversionError` if the bytes are not a Bottle.
    """
    try:
        return binary.decode_arrays(data, profile)
    except WireError as err:
        raise ConversionError(f"not a Bottle: {err}") from None


_SIGNED = {"byte": "b"}  # ROS 1's ``byte`` is signed, unlike ROS 2's


def to_ros1(schema: Schema, values: Sequence[Any]) -> bytes:
    """Encode a Bottle's values as a ROS 1 message; raises `ConversionError`, which names the field that is wrong."""
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
                f"{where or 'the Bottle'} has {len(values)} values, but {definition.name} has"
                f" {len(definition.fields)} fields ({names}): {shown(values)}"
            )
        for field, value in zip(definition.fields, values, strict=True):
            self._field(field.type, value, join(where, field.name))

    def _field(self, kind: FieldType, value: Any, where: str) -> None:
        if kind.shape is Shape.SINGLE:
            self._element(kind, value, where)
            return
        if isinstance(value, bytes) and PRIMITIVE_SIZES.get(kind.base) == 1:
            value = np.frombuffer(value, dtype(kind.base))
        if not isinstance(value, list | tuple | np.ndarray):
            raise wrong(where, "a list", value)
        if kind.shape is Shape.ARRAY and len(value) != kind.length:
            raise ConversionError(f"{where} must have {kind.length} elements, not {len(value)}")
        if kind.shape is Shape.SEQUENCE:
            self.out.append(struct.pack("<I", len(value)))
        if isinstance(value, np.ndarray) and kind.base.startswith("float") and value.dtype.kind in "fi":
            self.out.append(floats(kind.base, value, where).tobytes())
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


def floats(base: str, values: np.ndarray, where: str) -> np.ndarray:
    """Convert numbers to a float type; raises `ConversionError`, which names the first finite number out of range."""
    with np.errstate(over="ignore", invalid="ignore"):
        converted = values.astype(dtype(base))
    if converted.dtype.itemsize < values.dtype.itemsize:
        beyond = np.isinf(converted) & np.isfinite(values)
        if beyond.any():
            first = int(beyond.argmax())
            raise wrong(f"{where}[{first}]", base, values[first].item())
    return converted


def pack_number(base: str, value: Any, where: str, code: str) -> bytes:
    """Encode a number.

    A negative value for an unsigned type is encoded with its two's complement bits, because YARP writes large unsigned
    values as negative numbers.
    """
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
    """Return the beginning of a Bottle as text, for errors."""
    values = values.tolist() if isinstance(values, np.ndarray) else values
    text = to_text(values[:20])
    return text[:80] + ("..." if len(text) > 80 or len(values) > 20 else "")
