"""Messages as JSON values, for people and scripts: ``topic echo`` and ``topic pub``, requests and replies of services.

A message is an object with ROS 2's field names. Arrays of octets (``uint8``, ``byte``, ``char``) are base64 text; NaN
and the infinities are the texts ``"NaN"``, ``"Infinity"`` and ``"-Infinity"``. In the other direction, octets may also
be lists of numbers, missing fields get their defaults, and an unknown field is an error.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from typing_extensions import override

from bridge.messages.definitions.schema import FieldType
from bridge.messages.errors import ConversionError
from bridge.messages.registry import Registry
from bridge.messages.services import ServiceCodec
from bridge.messages.values import MessageReader, MessageWriter, dtype, wrong

OCTETS = frozenset({"uint8", "byte", "char"})  # primitives whose arrays are written as base64
_NOT_NUMBERS = {"nan": math.nan, "infinity": math.inf, "inf": math.inf, "-infinity": -math.inf, "-inf": -math.inf}


def to_json(registry: Registry, type_name: str, cdr: bytes, type_hash: str = "") -> dict[str, Any]:
    """Decode a message; raises `MessageTypeError` for an unknown type, `ConversionError` if the bytes do not fit."""
    checked = registry.hub_check(type_name, type_hash)(cdr)
    return _JsonReader(registry.schema(type_name, type_hash), checked).message()


def from_json(registry: Registry, type_name: str, value: Mapping[str, Any], type_hash: str = "") -> bytes:
    """Encode a message for the hub; missing fields get their defaults.

    Raises `MessageTypeError` for an unknown type, or `ConversionError`, which names the unknown or unsuitable field.
    """
    check = registry.hub_check(type_name, type_hash)
    return check(_JsonWriter(registry.schema(type_name, type_hash)).message(value))


class _JsonReader(MessageReader):
    """Reads messages as JSON values."""

    @override
    def plain(self, value: Any, base: str) -> Any:
        """Return a number, or text for NaN and the infinities; a float32 has only its significant digits."""
        if isinstance(value, float):
            if not math.isfinite(value):
                return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
            if base == "float32":
                return float(str(np.float32(value)))
        return value

    @override
    def numbers(self, content: memoryview | bytes, base: str) -> Any:
        """Return a list, or base64 text for octets."""
        if base in OCTETS:
            return base64.b64encode(content).decode()
        values = np.frombuffer(content, dtype(base)).tolist()
        return [self.plain(value, base) for value in values] if base.startswith("float") else values


class _JsonWriter(MessageWriter):
    """Writes messages from JSON values."""

    @override
    def plain(self, base: str, value: Any, where: str) -> bool | int | float:
        """Return a number, which may be given as a text for NaN or an infinity."""
        if base.startswith("float") and isinstance(value, str) and value.lower() in _NOT_NUMBERS:
            return _NOT_NUMBERS[value.lower()]
        return super().plain(base, value, where)

    @override
    def items(self, kind: FieldType, value: Any, where: str) -> Sequence[Any] | np.ndarray | bytes:
        """Return the elements, which may be given as base64 text."""
        if kind.base not in OCTETS or isinstance(value, np.ndarray):
            return super().items(kind, value, where)
        if isinstance(value, str):
            try:
                return base64.b64decode(value, validate=True)
            except ValueError as err:  # binascii.Error, or non-ASCII text
                raise ConversionError(f"{where} is not base64 text: {err}") from None
        if isinstance(value, bytes | bytearray):
            return bytes(value)
        if isinstance(value, list | tuple):
            return value
        raise wrong(where, "a list or base64 text", value)


class CallCodec(ServiceCodec):
    """Requests and replies of a service as JSON values and back."""

    reader, writer = _JsonReader, _JsonWriter
