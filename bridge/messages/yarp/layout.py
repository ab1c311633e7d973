"""The layout of the Bottles that YARP's own converter makes of ROS messages, as a plan of bytes for both directions.

A message is a list of its fields, each with its own tag, even if all have the same type. A nested message is a list of
the same form, and a time is a list of two integers. An array of numbers or strings, even an empty one, is a list of
that one type; octets are one-byte integers; an array of messages is a list of lists. Unsigned numbers are written as
signed numbers with the same bits. The source is ``yarpidl_rosmsg`` (RosTypeCodeGenYarp.cpp) in YARP 3.5, whose readers
accept no other layout.

The ROS 1 serialization has the same fields in the same order without tags, so a plan is a list of steps, each of which
reads one format and writes the other.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Protocol

import numpy as np

from bridge.messages.definitions.schema import PRIMITIVE_SIZES, TIME_DEFINITIONS, Definition, FieldType, Schema, Shape
from bridge.messages.errors import ConversionError, MessageTypeError
from yarp_compat.wire import tags
from yarp_compat.wire.profile import Profile

LONG_RUN = 16  # minimum number of fixed-size messages in an array for numpy to be faster than a loop
_TWO = struct.Struct("<ii")
_COUNT = struct.Struct("<I")
_INTEGERS = {1: tags.INT8, 2: tags.INT16, 4: tags.INT32, 8: tags.INT64}
_TAGS = {base: _INTEGERS[size] for base, size in PRIMITIVE_SIZES.items() if not base.startswith("float")}


class MismatchError(Exception):
    """The bytes have a different layout; they may still be a valid message."""


class _Step(Protocol):
    """One part of a message. Both methods append the converted bytes to ``out``, and return the next position."""

    def to_bottle(self, data: bytes, at: int, out: list[bytes]) -> int:
        """Convert ROS 1 bytes, which have been checked."""

    def to_ros1(self, data: bytes, at: int, out: list[bytes]) -> int:
        """Convert bytes of a Bottle, which have not been checked; raises `MismatchError`."""


class _Run:
    """Fixed-size numbers with the tags before them, or whole messages of such numbers."""

    def __init__(self) -> None:
        self._pairs: list[tuple[bytes, int]] = []
        self._constant = b""

    def constant(self, tag: int, count: int | None = None) -> None:
        """Append constant tags and counts."""
        self._constant += struct.pack("<i", tag) + (b"" if count is None else struct.pack("<i", count))

    def copy(self, size: int) -> None:
        """Append bytes that are the same in both formats."""
        self._pairs.append((self._constant, size))
        self._constant = b""

    @property
    def empty(self) -> bool:
        return not self._pairs and not self._constant

    @property
    def ros1_size(self) -> int:
        """Size in the ROS 1 serialization, in bytes."""
        return sum(size for _, size in self._pairs)

    @property
    def bottle_size(self) -> int:
        """Size in a Bottle, in bytes."""
        return sum(len(before) + size for before, size in self._pairs) + len(self._constant)

    def to_bottle(self, data: bytes, at: int, out: list[bytes]) -> int:
        for before, size in self._pairs:
            out.append(before)
            out.append(data[at : at + size])
            at += size
        out.append(self._constant)
        return at

    def to_ros1(self, data: bytes, at: int, out: list[bytes]) -> int:
        for before, size in self._pairs:
            begin = at + len(before)
            if data[at:begin] != before:
                raise MismatchError
            at = begin + size
            out.append(data[begin:at])
        end = at + len(self._constant)
        if data[at:end] != self._constant or end > len(data):
            raise MismatchError
        return end

    def columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the run's bytes in a Bottle with zeros for the numbers, and a mask of the numbers' bytes."""
        parts = [part for before, size in self._pairs for part in (before, bytes(size))]
        marks = [part for before, size in self._pairs for part in (bytes(len(before)), b"\1" * size)]
        template = np.frombuffer(b"".join([*parts, self._constant]), np.uint8)
        return template, np.frombuffer(b"".join([*marks, bytes(len(self._constant))]), np.bool_)


class _String:
    """A string with its tag."""

    _TAG = struct.pack("<i", tags.STRING)

    def to_bottle(self, data: bytes, at: int, out: list[bytes]) -> int:
        end = at + 4 + _COUNT.unpack_from(data, at)[0]
        out += (self._TAG, data[at:end])
        return int(end)

    def to_ros1(self, data: bytes, at: int, out: list[bytes]) -> int:
        if data[at : at + 4] != self._TAG:
            raise MismatchError
        return _string(data, at + 4, out)


class _Strings:
    """An array or sequence of strings; ``length`` is 0 for a sequence."""

    def __init__(self, length: int) -> None:
        self._length = length

    def to_bottle(self, data: bytes, at: int, out: list[bytes]) -> int:
        count, at = _ros1_count(data, at, self._length)
        out.append(_TWO.pack(tags.LIST | tags.STRING, count))
        begin = at
        for _ in range(count):
            at += 4 + _COUNT.unpack_from(data, at)[0]
        out.append(data[begin:at])
        return at

    def to_ros1(self, data: bytes, at: int, out: list[bytes]) -> int:
        count, at = _bottle_count(data, at, tags.LIST | tags.STRING, self._length, 4, out)
        for _ in range(count):
            at = _string(data, at, out)
        return at


class _Numbers:
    """A sequence of numbers."""

    def __init__(self, tag: int, size: int) -> None:
        self._tag, self._size = tags.LIST | tag, size

    def to_bottle(self, data: bytes, at: int, out: list[bytes]) -> int:
        count, at = _ros1_count(data, at, 0)
        end = at + count * self._size
        out += (_TWO.pack(self._tag, count), data[at:end])
        return end

    def to_ros1(self, data: bytes, at: int, out: list[bytes]) -> int:
        count, at = _bottle_count(data, at, self._tag, 0, self._size, out)
        end = at + count * self._size
        out.append(data[at:end])
        return end


class _MessageArray:
    """An array or sequence of messages; ``length`` is 0 for a sequence."""

    def __init__(self, length: int, steps: list[_Step]) -> None:
        self._length, self._steps = length, steps
        self._run = steps[0] if len(steps) == 1 and isinstance(steps[0], _Run) else None

    def to_bottle(self, data: bytes, at: int, out: list[bytes]) -> int:
        count, at = _ros1_count(data, at, self._length)
        out.append(_TWO.pack(tags.LIST, count))
        if self._run is not None and count >= LONG_RUN:
            return _many_to_bottle(self._run, data, at, count, out)
        for _ in range(count):
            for step in self._steps:
                at = step.to_bottle(data, at, out)
        return at

    def to_ros1(self, data: bytes, at: int, out: list[bytes]) -> int:
        count, at = _bottle_count(data, at, tags.LIST, self._length, 8, out)
        if self._run is not None and count >= LONG_RUN:
            return _many_to_ros1(self._run, data, at, count, out)
        for _ in range(count):
            for step in self._steps:
                at = step.to_ros1(data, at, out)
        return at


def _many_to_bottle(run: _Run, data: bytes, at: int, count: int, out: list[bytes]) -> int:
    template, numbers = run.columns()
    table = np.tile(template, (count, 1))
    if run.ros1_size:
        table[:, numbers] = np.frombuffer(data, np.uint8, count * run.ros1_size, at).reshape(count, -1)
    out.append(table.tobytes())
    return at + count * run.ros1_size


def _many_to_ros1(run: _Run, data: bytes, at: int, count: int, out: list[bytes]) -> int:
    end = at + count * run.bottle_size
    if end > len(data):
        raise MismatchError
    template, numbers = run.columns()
    table = np.frombuffer(data, np.uint8, count * run.bottle_size, at).reshape(count, -1)
    if not np.array_equal(table[:, ~numbers], np.broadcast_to(template[~numbers], (count, int((~numbers).sum())))):
        raise MismatchError
    out.append(table[:, numbers].tobytes())
    return end


def _string(data: bytes, at: int, out: list[bytes]) -> int:
    if at + 4 > len(data):
        raise MismatchError
    end = at + 4 + int(_COUNT.unpack_from(data, at)[0])
    if end > len(data):
        raise MismatchError
    out.append(data[at:end])
    return end


def _ros1_count(data: bytes, at: int, length: int) -> tuple[int, int]:
    return (length, at) if length else (int(_COUNT.unpack_from(data, at)[0]), at + 4)


def _bottle_count(data: bytes, at: int, tag: int, length: int, least: int, out: list[bytes]) -> tuple[int, int]:
    """Read a list's count, and append it if ``length`` is 0 (a sequence); an element has at least ``least`` bytes."""
    if at + 8 > len(data):
        raise MismatchError
    actual, count = _TWO.unpack_from(data, at)
    at += 8
    if actual != tag or count < 0 or (length and count != length) or count * least > len(data) - at:
        raise MismatchError
    if not length:
        out.append(_COUNT.pack(count))
    return count, at


class _Maker:
    """Builds the steps of one type."""

    def __init__(self, schema: Schema, tag_of: Callable[[str], int]) -> None:
        self._schema, self._tag_of = schema, tag_of
        self._run = _Run()
        self.steps: list[_Step] = []

    def message(self, definition: Definition) -> None:
        self._run.constant(tags.LIST, len(definition.fields))
        for field in definition.fields:
            try:
                self._field(field.type)
            except KeyError:
                msg = f"field {field.name} of {definition.name} is a {field.type.base}, which YARP lacks"
                raise MessageTypeError(msg, "choose other fields with 'fields' in an entry of yarp.topics") from None

    def _field(self, kind: FieldType) -> None:
        nested = TIME_DEFINITIONS.get(kind.base) or (self._schema.types[kind.base] if kind.nested else None)
        length = kind.length if kind.shape is Shape.ARRAY else 0
        if kind.shape is Shape.SINGLE:
            if nested is not None:
                self.message(nested)
            elif kind.base == "string":
                self._step(_String())
            else:
                self._run.constant(self._tag_of(kind.base))
                self._run.copy(PRIMITIVE_SIZES[kind.base])
        elif nested is not None:
            inner = _Maker(self._schema, self._tag_of)
            inner.message(nested)
            self._step(_MessageArray(length, inner.finish()))
        elif kind.base == "string":
            self._step(_Strings(length))
        elif length:
            self._run.constant(tags.LIST | self._tag_of(kind.base), length)
            self._run.copy(length * PRIMITIVE_SIZES[kind.base])
        else:
            self._step(_Numbers(self._tag_of(kind.base), PRIMITIVE_SIZES[kind.base]))

    def _step(self, step: _Step) -> None:
        self.finish().append(step)

    def finish(self) -> list[_Step]:
        if not self._run.empty:
            self.steps.append(self._run)
            self._run = _Run()
        return self.steps


class Layout:
    """The layout of a ROS 1 type's Bottle in one profile; raises `MessageTypeError` if YARP lacks a field's type."""

    def __init__(self, schema: Schema, profile: Profile) -> None:
        floats = {"float32": profile.float32_tag, "float64": profile.float64_tag}
        maker = _Maker(schema, (_TAGS | floats).__getitem__)
        maker.message(schema.root)
        self._steps = maker.finish()

    def to_bottle(self, ros1: bytes) -> bytes:
        """Return the Bottle for a ROS 1 message, which has been checked; raises `ConversionError` for extra bytes."""
        out: list[bytes] = []
        at = 0
        for step in self._steps:
            at = step.to_bottle(ros1, at, out)
        if at != len(ros1):
            raise ConversionError(f"{len(ros1) - at} bytes are left over after the last field")
        return b"".join(out)

    def to_ros1(self, bottle: bytes) -> bytes:
        """Return the ROS 1 message for a Bottle; raises `MismatchError` if the Bottle has a different layout."""
        out: list[bytes] = []
        at = 0
        for step in self._steps:
            at = step.to_ros1(bottle, at, out)
        if at != len(bottle):
            raise MismatchError
        return b"".join(out)
