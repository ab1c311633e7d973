"""Short Bottles of chosen fields, as people write them: ``linear.x linear.y deg(angular.z)``.

An entry is the path of a field in ROS 2 names, ``path[2]`` for one element of an array, ``deg(path)`` for an angle
that is in degrees in the Bottle, or a constant: a number, or a text in single quotes. A time is one number in seconds,
and an array is a list.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.messages.definitions.schema import PRIMITIVE_SIZES, TIME_TYPES, FieldType, Schema, Shape
from bridge.messages.errors import ConversionError, MessageTypeError
from bridge.messages.values import MessageReader, MessageWriter, dtype, wrong
from bridge.messages.yarp.bottle import decode_arrays, floats, shown
from bridge.messages.yarp.codec import Codec, EncodedMessage, has_header, split_time, stamp_of
from yarp_compat.wire.binary import encode_parts
from yarp_compat.wire.framing import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Vocab

_ENTRY = re.compile(
    r"(?P<deg>deg\()?(?P<path>[A-Za-z]\w*(?:\.[A-Za-z]\w*)*)(?:\[(?P<index>\d{1,9})\])?(?(deg)\))", re.ASCII
)
_TEXT = re.compile(r"'[^']*'")
_TIMES = frozenset(TIME_TYPES.values())


@dataclass(frozen=True, slots=True)
class BottleEntry:
    """One value of the Bottle."""

    text: str  #: the entry as written, for errors
    path: tuple[str, ...] = ()  #: the field's path from the root; empty for a constant
    index: int | None = None  #: index of an array's element; None for the whole field
    degrees: bool = False  #: whether an angle is in degrees in the Bottle
    constant: int | float | str | None = None  #: the constant value; None for a field

    @classmethod
    def parse(cls, entry: float | str) -> BottleEntry:
        """Read an entry; raises `ValueError`."""
        if isinstance(entry, int | float):
            return cls(str(entry), constant=entry)
        if _TEXT.fullmatch(entry):
            return cls(entry, constant=entry[1:-1])
        match = _ENTRY.fullmatch(entry)
        if not match:
            msg = f"{entry!r} is not a field: give linear.x, deg(angular.z), position[0], a number, or a text in quotes"
            raise ValueError(msg)
        index = None if match["index"] is None else int(match["index"])
        return cls(entry, tuple(match["path"].split(".")), index, match["deg"] is not None)


class FieldsCodec(Codec):
    """Messages as a Bottle of chosen fields; raises `MessageTypeError` if the type lacks one of them.

    ``profile`` is the format of written bytes; ``frame`` is the header's frame if the Bottle has none.
    """

    def __init__(self, schema: Schema, entries: Sequence[BottleEntry], profile: Profile, frame: str = "") -> None:
        self._schema, self._profile, self._frame = schema, profile, frame
        self._header = schema.root.fields[0].name if has_header(schema) else ""
        self._entries = [(entry, _resolve(schema, entry)) for entry in entries]

    @override
    def to_yarp(self, cdr: bytes) -> EncodedMessage:
        message = MessageReader(self._schema, cdr).message()
        values = [_get(message, entry, kind) for entry, kind in self._entries]
        return EncodedMessage(encode_parts(values, self._profile), (stamp_of(cdr) or None) if self._header else None)

    @override
    def to_hub(self, payload: Buffer, profile: Profile | None, stamp_ns: int | None) -> bytes:
        """Convert a Bottle as `Codec` specifies; fields that the Bottle lacks get their defaults."""
        values = decode_arrays(bytes(payload), profile)
        if isinstance(values, np.ndarray):  # a Bottle of integers only, or of floats only
            values = values.tolist()
        if len(values) != len(self._entries):
            wanted = " ".join(entry.text for entry, _ in self._entries)
            raise ConversionError(
                f"the Bottle has {len(values)} values, not the {len(self._entries)} of ({wanted}): {shown(values)}"
            )
        message: dict[str, Any] = {}
        if self._header:
            _assign(message, (self._header, "frame_id"), self._frame)
            _assign(message, (self._header, "stamp"), _time(self.now_ns() if stamp_ns is None else stamp_ns))
        for (entry, kind), value in zip(self._entries, values, strict=True):
            if kind is None:
                _compare(entry, value)
            elif entry.index is not None:
                raise ConversionError(f"{entry.text} is one element of an array, which the Bottle cannot set by itself")
            else:
                _assign(message, entry.path, _field_value(entry, kind, value))
        return MessageWriter(self._schema).message(message)


def _resolve(schema: Schema, entry: BottleEntry) -> FieldType | None:
    """Return the type of an entry's field; None for a constant."""
    if not entry.path:
        return None
    definition, kind = schema.root, FieldType("")
    for number, name in enumerate(entry.path):
        fields = {field.name: field.type for field in definition.fields}
        if name not in fields:
            names = ", ".join(fields) or "none"
            raise MessageTypeError(f"{definition.name} has no field {name!r} ({entry.text})", f"its fields: {names}")
        kind = fields[name]
        if number + 1 < len(entry.path):
            if not kind.nested or kind.shape is not Shape.SINGLE:
                raise MessageTypeError(f"{name} in {entry.text} has no fields", "end the path there")
            definition = schema.types[kind.base]
    if entry.index is not None:
        if kind.shape is Shape.SINGLE or (kind.shape is Shape.ARRAY and entry.index >= kind.length):
            raise MessageTypeError(f"{entry.text}: {'.'.join(entry.path)} has no such element", "leave the index out")
        kind = kind.element
    if kind.nested and not (kind.base in _TIMES and kind.shape is Shape.SINGLE):
        names = ", ".join(field.name for field in schema.types[kind.base].fields)
        raise MessageTypeError(f"{entry.text} is a whole {kind.base}", f"name one of its fields: {names}")
    if entry.degrees and not (kind.base.startswith("float") and kind.shape is Shape.SINGLE):
        raise MessageTypeError(f"{entry.text}: only a single float can be in degrees", "leave deg() out")
    return kind


def _get(message: Mapping[str, Any], entry: BottleEntry, kind: FieldType | None) -> Any:
    if kind is None:
        return entry.constant
    value: Any = message
    for name in entry.path:
        value = value[name]
    if entry.index is not None:
        if entry.index >= len(value):
            raise ConversionError(f"{entry.text}: the message's array has {len(value)} elements")
        value = value[entry.index]
        value = value.item() if isinstance(value, np.generic) else value
    if kind.base in _TIMES:
        return value["sec"] + value["nanosec"] / 1e9
    if isinstance(value, np.ndarray):
        return value.astype(np.int8) if value.dtype.kind == "?" else value
    return math.degrees(value) if entry.degrees else value


def _assign(message: dict[str, Any], path: Sequence[str], value: Any) -> None:
    for name in path[:-1]:
        message = message.setdefault(name, {})
    message[path[-1]] = value


def _compare(entry: BottleEntry, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float | str) or value != entry.constant:
        raise ConversionError(f"a value of the Bottle is {value!r}, but the rule requires {entry.text}")


def _field_value(entry: BottleEntry, kind: FieldType, value: Any) -> Any:
    """Convert a Bottle's value to a value of the field."""
    if kind.base in _TIMES:
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1 << 31:
            raise wrong(entry.text, "a time in seconds", value)
        return _time(round(value * 1e9))
    if kind.shape is not Shape.SINGLE:
        return _items(entry, kind, value)
    if kind.base == "bool" and isinstance(value, int) and value in (0, 1):
        return bool(value)
    if isinstance(value, Vocab) and kind.base == "string":
        return str(value)
    if kind.base.startswith("float") and isinstance(value, int | float) and not isinstance(value, bool):
        return math.radians(value) if entry.degrees else float(value)
    return value


def _items(entry: BottleEntry, kind: FieldType, value: Any) -> Any:
    if isinstance(value, bytes) and PRIMITIVE_SIZES.get(kind.base) == 1:
        return np.frombuffer(value, dtype(kind.base))
    if isinstance(value, np.ndarray):
        return floats(kind.base, value, entry.text) if kind.base.startswith("float") else value.tolist()
    if isinstance(value, list):
        return value
    raise wrong(entry.text, "a list", value)


def _time(time_ns: int) -> dict[str, int]:
    seconds, nanoseconds = split_time(time_ns)
    return {"sec": seconds, "nanosec": nanoseconds}
