"""Converts plain values to and from YARP's types.

A text or number is a Bottle of one value, an array is a vector, and a point is a vector of x y z. ``/clock`` is YARP's
network clock: a Bottle of two integers, seconds and nanoseconds (``NetworkClock::read`` of YARP 3 and 4).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bridge.messages.errors import ConversionError
from bridge.messages.values import dtype, wrong
from bridge.messages.yarp.codec import Message, Missing, NaturalType
from yarp_compat.sig.vector import read_numbers, write_numbers
from yarp_compat.wire.binary import decode_prefix, encode
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.text import to_text
from yarp_compat.wire.values import Int8, Int16, Int64

_WRITTEN = {"int8": Int8, "uint8": Int8, "byte": Int8, "char": Int8, "int16": Int16, "uint16": Int16, "int64": Int64, "uint64": Int64}  # fmt: skip # noqa: E501


def _bottle(source: ElementReader) -> list[Any]:
    values, source.at = decode_prefix(source.data, source.profile, source.at)
    return values


class _Text:
    """A Bottle of one string; any other Bottle, such as words that a person types, is accepted in its text form."""

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        out.block(encode([message["data"]], out.profile))

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:  # noqa: ARG002
        values = _bottle(source)
        single = len(values) == 1 and isinstance(values[0], str)
        text = str(values[0]) if single else to_text(values)
        return {"data": text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")}


class _Number:
    """A Bottle of one number."""

    def __init__(self, base: str) -> None:
        self._base = base

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        value = message["data"]
        bits = 8 * dtype(self._base).itemsize
        if self._base.startswith("u") and value >> (bits - 1):
            value -= 1 << bits
        out.block(encode([_WRITTEN.get(self._base, type(value))(value)], out.profile))

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:  # noqa: ARG002
        values = _bottle(source)
        if len(values) != 1 or not isinstance(values[0], int | float):
            raise ConversionError(f"the Bottle must be one number: {to_text(values)[:80]}")
        value = values[0]
        if self._base == "bool":
            if value not in (0, 1):
                raise wrong("data", "bool", value)
            return {"data": bool(value)}
        bits = 8 * dtype(self._base).itemsize
        if self._base.startswith("u") and -(1 << (bits - 1)) <= value < 0:
            value += 1 << bits
        return {"data": float(value) if self._base.startswith("float") else value}


class _Array:
    """A vector of the array's element type."""

    def __init__(self, base: str) -> None:
        self._base = base

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        write_numbers(out, message["data"])

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:  # noqa: ARG002
        return {"data": read_numbers(source, dtype(self._base))}


class _Coordinates:
    """A vector of a fixed number of doubles."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        out.block(encode([float(message[name]) for name in self._names], out.profile))

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:  # noqa: ARG002
        numbers = read_numbers(source, dtype("float64")).tolist()
        if len(numbers) != len(self._names):
            raise ConversionError(f"there are {len(numbers)} numbers, not {len(self._names)} ({' '.join(self._names)})")
        return {name: float(number) for name, number in zip(self._names, numbers, strict=True)}


_NUMBERS = {
    "Bool": "bool", "Byte": "byte", "Char": "char", "Int8": "int8", "UInt8": "uint8", "Int16": "int16",
    "UInt16": "uint16", "Int32": "int32", "UInt32": "uint32", "Int64": "int64", "UInt64": "uint64",
    "Float32": "float32", "Float64": "float64",
}  # fmt: skip
_ARRAYS = (name for name in _NUMBERS if name not in ("Bool", "Char"))


CLOCK = "rosgraph_msgs/msg/Clock"


class _Clock:
    """YARP's network clock; also accepted within a list, as YARP's converter of ROS messages would write it."""

    def to_yarp(self, message: Mapping[str, Any], out: ElementWriter) -> None:
        time = message["clock"]
        out.block(encode([time["sec"], time["nanosec"]], out.profile))

    def to_ros(self, source: ElementReader, stamp_ns: int, missing: Missing) -> Message:  # noqa: ARG002
        values, source.at = decode_prefix(source.data, source.profile, source.at)
        if len(values) == 1 and isinstance(values[0], list):
            values = values[0]
        if len(values) != 2 or not all(type(value) is int for value in values) or not 0 <= values[1] < 1_000_000_000:
            raise ConversionError(f"a clock must be two integers, seconds and nanoseconds: {to_text(values)[:80]}")
        return {"clock": {"sec": values[0], "nanosec": values[1]}}


PLAIN: Mapping[str, NaturalType] = {
    "std_msgs/msg/String": _Text(),
    **{f"std_msgs/msg/{name}": _Number(base) for name, base in _NUMBERS.items()},
    **{f"std_msgs/msg/{name}MultiArray": _Array(_NUMBERS[name]) for name in _ARRAYS},
    **{f"geometry_msgs/msg/{name}": _Coordinates("xyz") for name in ("Vector3", "Point")},
    "geometry_msgs/msg/Quaternion": _Coordinates("wxyz"),
    CLOCK: _Clock(),
}
