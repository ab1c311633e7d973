"""Sample messages with a different value in each field, made by walking a type's definition."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bridge.messages.definitions.schema import FieldType, Schema, Shape

RANGES = {
    "byte": 127,  # rosbags reads larger octets as negative numbers
    "char": 255,
    "int8": 127,
    "uint8": 255,
    "int16": 32767,
    "uint16": 65535,
    "int32": 2**31 - 1,
    "uint32": 2**32 - 1,
    "int64": 2**63 - 1,
    "uint64": 2**64 - 1,
}
DATA = Path(__file__).parent / "data"
GENPY = Path("/usr/lib/python3/dist-packages")


def sample(schema: Schema, length: int = 2) -> dict[str, Any]:
    """Return a message as a dict of plain values; sequences have ``length`` elements, octets are lists of numbers."""
    return _Sampler(schema, length).structure(schema.name)


class _Sampler:
    def __init__(self, schema: Schema, length: int) -> None:
        self.schema = schema
        self.length = length
        self.counter: Iterator[int] = itertools.count(1)

    def structure(self, name: str) -> dict[str, Any]:
        values = {field.name: self.value(field.type) for field in self.schema.types[name].fields}
        if "nanosec" in values:
            # genpy moves whole seconds from the nanoseconds to the seconds.
            values["nanosec"] %= 10**9
        return values

    def value(self, kind: FieldType) -> Any:
        if kind.shape is Shape.SINGLE:
            return self.element(kind)
        length = self.length
        if kind.shape is Shape.ARRAY or (kind.length and kind.length < length):
            length = kind.length
        return [self.element(kind.element) for _ in range(length)]

    def element(self, kind: FieldType) -> Any:
        number = next(self.counter)
        if kind.nested:
            return self.structure(kind.base)
        if kind.base in ("time", "duration"):
            return {"secs": number, "nsecs": number + 1}
        if kind.base == "string":
            return ("x" * (number % 9) + str(number))[: kind.string_bound or None]
        if kind.base == "wstring":
            return f"é€😀{number}"
        if kind.base == "bool":
            return number % 2 == 1
        if kind.base.startswith("float"):
            return number + 0.25
        # Spread over the whole range, so that all bytes of a number differ from those of others.
        return number * 0x0102030405060708 % (RANGES[kind.base] + 1)


def standard_pairs() -> list[str]:
    """Return the ROS 2 names of the types that are both in Noetic's and in Jazzy's type store of rosbags."""
    from rosbags.typesys.stores import ros1_noetic, ros2_jazzy

    return sorted(name for name in ros2_jazzy.FIELDDEFS if name in ros1_noetic.FIELDDEFS)


def genpy_types() -> list[str]:
    """Return the ROS 1 names of all messages that are installed on the system."""
    return sorted(f"{path.parts[-3]}/{path.stem[1:]}" for path in GENPY.glob("*/msg/_*.py") if path.stem != "__init__")
