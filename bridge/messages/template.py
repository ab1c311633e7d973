"""Messages in which only some numbers change: they are encoded once, and filled in for each message."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.messages.definitions.schema import PRIMITIVE_SIZES, STRUCT_FORMATS, Definition, Field, FieldType, Schema
from bridge.messages.errors import ConversionError
from bridge.messages.values import HEADER, MessageWriter


class MessageTemplate:
    """A message whose texts and array lengths do not change.

    Filling in a `nav_msgs/msg/Odometry` takes a tenth of the time of writing it field by field. Each path in
    ``changing`` leads to a number, or to a part in which all numbers change (``header.stamp``,
    ``transforms[0].transform``). Raises `ConversionError` if a field is unknown, its value does not fit, or a path
    leads to no number.
    """

    def __init__(self, schema: Schema, message: Mapping[str, Any], *changing: str) -> None:
        writer = _PlaceWriter(schema, changing)
        self._name = schema.name
        self._content = writer.message(message)
        if missing := next((path for path in changing if path not in writer.found), None):
            raise ConversionError(f"{schema.name} has no number at {missing!r}")
        self._count = len(writer.places)
        self._runs = _runs(writer.places)

    def fill(self, *numbers: float) -> bytes:
        """Return the message in CDR with new values for all changing numbers, in message order.

        Raises `ConversionError` if their count is wrong or a value does not fit.
        """
        if len(numbers) != self._count:
            raise ConversionError(
                f"{len(numbers)} numbers are given for {self._count} changing numbers of {self._name}"
            )
        content = bytearray(self._content)
        try:
            for run, at, first, end in self._runs:
                run.pack_into(content, at, *numbers[first:end])
        except struct.error as err:
            raise ConversionError(f"a number does not fit its field of {self._name}: {err}") from None
        return bytes(content)


class _PlaceWriter(MessageWriter):
    """Records the offsets and types of the changing numbers, and which of the paths lead to numbers."""

    def __init__(self, schema: Schema, changing: tuple[str, ...]) -> None:
        super().__init__(schema)
        self._changing = changing
        self.places: list[tuple[int, str]] = []
        self.found: set[str] = set()

    @override
    def default(self, definition: Definition, field: Field, where: str) -> None:
        self.write_default(field, where)  # kept bytes would hide numbers

    @override
    def items(self, kind: FieldType, value: Any, where: str) -> Sequence[Any] | bytes:
        items = super().items(kind, value, where)
        return items.tolist() if isinstance(items, np.ndarray) else items

    @override
    def element(self, kind: FieldType, value: Any, where: str) -> None:
        super().element(kind, value, where)
        path = next((path for path in self._changing if _within(where, path)), None)
        if path is not None and kind.base in PRIMITIVE_SIZES:
            self.found.add(path)
            self.places.append((len(HEADER) + len(self.data) - PRIMITIVE_SIZES[kind.base], kind.base))


def _within(where: str, path: str) -> bool:
    return where.startswith(path) and where[len(path) : len(path) + 1] in ("", ".", "[")


def _runs(places: list[tuple[int, str]]) -> list[tuple[struct.Struct, int, int, int]]:
    """Group adjacent numbers; return the format of each group, its offset, and the range of its numbers among all."""
    ends = (at + PRIMITIVE_SIZES[base] for at, base in places)
    gaps = [i for i, (end, (at, _)) in enumerate(zip(ends, places[1:], strict=False), 1) if end != at]
    bounds = [0, *gaps, len(places)] if places else []
    return [
        (
            struct.Struct("<" + "".join(STRUCT_FORMATS[base] for _, base in places[start:end])),
            places[start][0],
            start,
            end,
        )
        for start, end in itertools.pairwise(bounds)
    ]
