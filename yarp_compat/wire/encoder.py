"""Plain values to a Bottle's bytes, one writer for each profile."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from struct import Struct
from typing import Any

from yarp_compat.wire import tags
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.values import Float32, Group, Int8, Int16, Int64, Key, Vocab, Vocab64

_TWO = Struct("<ii").pack
_WORD = Struct("<i").pack
_TAG_INT8 = Struct("<ib").pack
_TAG_INT16 = Struct("<ih").pack
_TAG_INT64 = Struct("<iq").pack
_TAG_FLOAT = Struct("<if").pack
_TAG_DOUBLE = Struct("<id").pack

_TRUE = 0x31
_FAMILIES: dict[type, str] = {
    float: "float64", int: "int", Int64: "int", str: "string", bytes: "blob", bool: "vocab", Vocab: "vocab",
    Vocab64: "vocab", Int8: "int8", Int16: "int16", Float32: "float32", list: "list", tuple: "list", dict: "dict",
}  # fmt: skip
"""Types that may be written with one tag. Those of two families in one list surely are not."""

_ARRAY_TAGS = {"i1": tags.INT8, "u1": tags.INT8, "i2": tags.INT16, "u2": tags.INT16, "i4": tags.INT32,
               "u4": tags.INT32, "i8": tags.INT64, "u8": tags.INT64}  # fmt: skip


class Encoder:
    """Writes the lists of one profile."""

    def __init__(self, profile: Profile) -> None:
        self._float32 = profile.float32_tag
        self._float64 = profile.float64_tag
        self._vocab64 = profile.vocab64_tag
        self._array_tags = {**_ARRAY_TAGS, "f4": self._float32, "f8": self._float64}
        self._runs: dict[type, tuple[int, str]] = {
            float: (self._float64, "d"), Float32: (self._float32, "f"), Int8: (tags.INT8, "b"),
            Int16: (tags.INT16, "h"), Int64: (tags.INT64, "q"),
        }  # fmt: skip
        self._rare: dict[type, Callable[[Any, list[Buffer], int], None]] = {
            Int8: lambda value, out, _depth: out.append(_TAG_INT8(tags.INT8, value)),
            Int16: lambda value, out, _depth: out.append(_TAG_INT16(tags.INT16, value)),
            Int64: lambda value, out, _depth: out.append(_TAG_INT64(tags.INT64, value)),
            Float32: lambda value, out, _depth: out.append(_TAG_FLOAT(self._float32, value)),
            Vocab: self._number,
            Vocab64: self._number,
            dict: self._dict,
        }

    def bottle(self, values: Any, out: list[Buffer], depth: int = 0) -> None:
        """Append a list's pieces: its header, which is that of a top-level Bottle too, and its elements.

        Raises:
            WireError: there is a value that no Bottle can hold.
        """
        if depth > tags.MAX_DEPTH:
            raise WireError(f"lists are nested deeper than {tags.MAX_DEPTH}")
        if not isinstance(values, (list, tuple)):
            return self._array(values, out, depth)
        kinds = set(map(type, values))
        if len(kinds) == 1:
            (kind,) = kinds
            run = self._runs.get(kind)
            count = len(values)
            if run is not None:
                out.append(struct.pack(f"<ii{count}{run[1]}", tags.LIST | run[0], count, *values))
                return None
            if kind is int:
                try:
                    out.append(struct.pack(f"<ii{count}i", tags.LIST | tags.INT32, count, *values))
                except struct.error:
                    self._family(values, out)
                return None
            if kind in (str, bytes):
                return self._blocks(values, out, kind)
        if any(kind not in _FAMILIES for kind in kinds):
            values = [value if type(value) in _FAMILIES else plain(value) for value in values]
            if any(type(value) not in _FAMILIES for value in values):  # numpy arrays
                return self._mixed(values, out, depth)
            return self.bottle(values, out, depth)
        if {_FAMILIES[kind] for kind in kinds} in ({"int"}, {"vocab"}):
            return self._family(values, out)
        return self._mixed(values, out, depth)

    def _blocks(self, values: Sequence[Any], out: list[Buffer], kind: type) -> None:
        """Strings or blobs only."""
        out.append(_TWO(tags.LIST | (tags.STRING if kind is str else tags.BLOB), len(values)))
        for value in values:
            block = _utf8(value) if kind is str else value
            out.append(_WORD(len(block)))
            out.append(block)

    def _family(self, values: Sequence[Any], out: list[Buffer]) -> None:
        """Ints or vocabs whose tags depend on the values."""
        pairs = [self._tag_and_body(value) for value in values]
        units = {tag for tag, _ in pairs}
        unit = units.pop() if len(units) == 1 else 0
        out.append(_TWO(tags.LIST | unit, len(values)))
        if unit:
            out.extend(body for _, body in pairs)
        else:
            out.extend(_WORD(tag) + body for tag, body in pairs)

    def _tag_and_body(self, value: Any) -> tuple[int, bytes]:
        if value is True or value is False:
            return tags.VOCAB32, _WORD(_TRUE if value else 0)
        if isinstance(value, Vocab):
            letters = _utf8(value)
            if self._vocab64 is None:
                return tags.VOCAB32, letters[:4].ljust(4, b"\0")
            if len(letters) > 8:
                raise WireError(f"the vocab {value!r} is longer than 8 bytes")
            if len(letters) > 4 or type(value) is Vocab64:
                return self._vocab64, letters.ljust(8, b"\0")
            return tags.VOCAB32, letters.ljust(4, b"\0")
        if type(value) is int and -0x80000000 <= value <= 0x7FFFFFFF:
            return tags.INT32, _WORD(value)
        return tags.INT64, value.to_bytes(8, "little", signed=True)

    def _number(self, value: Any, out: list[Buffer], _depth: int) -> None:
        tag, body = self._tag_and_body(value)
        out.append(_WORD(tag) + body)

    def _mixed(self, values: Sequence[Any], out: list[Buffer], depth: int) -> None:
        """Elements each with its tag."""
        add = out.append
        float64 = self._float64
        add(_TWO(tags.LIST, len(values)))
        for value in values:
            kind = type(value)
            if kind is float:
                add(_TAG_DOUBLE(float64, value))
            elif kind is int:
                add(_TWO(tags.INT32, value) if -0x80000000 <= value <= 0x7FFFFFFF else _TAG_INT64(tags.INT64, value))
            elif kind is str:
                block = _utf8(value)
                add(_TWO(tags.STRING, len(block)))
                add(block)
            elif kind is list or kind is tuple:
                self.bottle(value, out, depth + 1)
            elif kind is bool:
                add(_TWO(tags.VOCAB32, _TRUE if value else 0))
            elif kind is bytes:
                add(_TWO(tags.BLOB, len(value)))
                add(value)
            elif kind in self._rare:
                self._rare[kind](value, out, depth)
            else:
                self.bottle(value, out, depth + 1)

    def _dict(self, value: dict[Any, Any], out: list[Buffer], depth: int) -> None:
        out.append(_WORD(tags.LIST | tags.DICT))
        self.bottle(entries_of(value), out, depth + 2)

    def _array(self, values: Any, out: list[Buffer], depth: int) -> None:
        """A numpy array: its numbers as they lie in memory; of more dimensions: lists of lists."""
        if not hasattr(values, "dtype"):
            return self.bottle(list(values), out, depth)
        kind = values.dtype.str[1:]
        if values.ndim != 1 or kind not in self._array_tags:
            wider = {"f2": "<f4", "f16": "<f8", "g16": "<f8"}.get(kind)
            return self.bottle(list(values.astype(wider)) if wider else list(values), out, depth)
        out.append(_TWO(tags.LIST | (self._array_tags[kind] if len(values) else 0), len(values)))
        if len(values):
            out.append(block_of(values))
        return None


def block_of(values: Any) -> Buffer:
    """The little-endian bytes of a numpy array, without a copy where they lie so in memory."""
    if values.dtype.str[0] == ">":
        values = values.astype(values.dtype.newbyteorder("<"))
    if not values.flags.c_contiguous:
        return bytes(values.tobytes())
    return memoryview(values).cast("B")


def entries_of(value: dict[Any, Any]) -> list[list[Any]]:
    """The lists that a dict is on the wire, in the order of their keys."""
    wrong = [key for key in value if not isinstance(key, str)]
    if wrong:
        raise WireError(f"the key {wrong[0]!r} of a dict is no str")
    return [[key.value if type(key) is Key else key, *entry_values(value[key])] for key in sorted(value)]


def entry_values(entry: Any) -> Sequence[Any]:
    """The values after the key of a dict's entry."""
    if isinstance(entry, Group):
        return entries_of(entry)
    return entry if isinstance(entry, tuple) else [entry]


def plain(value: Any) -> Any:
    """The value of a known type that a subclass's instance or a numpy scalar stands for.

    Raises:
        WireError: there is none.
    """
    if isinstance(value, bool):
        return value
    if hasattr(value, "dtype"):
        return value if value.ndim else _scalar(value)
    kind: Any
    for kind in (Vocab64, Vocab, Int8, Int16, Int64, Float32, str, int, float, dict):
        if isinstance(value, kind):
            return kind(value)
    if isinstance(value, (bytes, bytearray, memoryview)):
        return bytes(value)
    if isinstance(value, Sequence) or hasattr(value, "tolist"):
        return list(value)
    raise WireError(f"a Bottle cannot hold {value!r}, which is a {type(value).__name__}")


def _scalar(value: Any) -> Any:
    kind = value.dtype.str[1:]
    made = {"i1": Int8, "u1": Int8, "i2": Int16, "u2": Int16, "i8": Int64, "u8": Int64, "f2": Float32, "f4": Float32}
    return plain(made.get(kind, lambda item: item)(value.item()))


def _utf8(text: str) -> bytes:
    try:
        return text.encode(errors="surrogateescape")
    except UnicodeEncodeError as err:
        raise WireError(f"{text!r} cannot be written as UTF-8: {err.reason}") from None
