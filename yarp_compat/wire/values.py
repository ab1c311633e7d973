"""The values in a Bottle, as plain Python values.

==================  ==============================  ===========================================
Python              on the wire                     in text
==================  ==============================  ===========================================
int                 INT32, INT64 if it is too large  ``5``
float               FLOAT64                         ``1.5``
str                 STRING (UTF-8)                  ``word`` or ``"two words"``
bytes               BLOB                            ``{1 2 255}``
bool                VOCAB32, '1' or 0               ``true``, ``false``
list, tuple         LIST                            ``(1 2)``
dict                DICT                            ``((key value) ...)``
Vocab               VOCAB32, or 64 beyond 4 letters  ``[set]``
Int8, Int16, Int64  INT8, INT16, INT64              ``5``
Float32             FLOAT32                         ``1.5``
==================  ==============================  ===========================================

The subclasses only store the wire type of a value; they compare and compute like their base classes. numpy arrays of
numbers are lists of their element type (unsigned types with the tag of the signed type, like YARP's vectors). Bytes of
a string that are not UTF-8 become surrogate escapes, which are encoded as the same bytes.

A dict's entry is a list on the wire, the key before the values. A single value is stored directly, any other number of
values as a tuple: ``{"n": 1, "GROUP": (["a", 1], ["b", 2])}`` is ``((GROUP (a 1) (b 2)) (n 1))``. For writing,
``{"n": 1, "GROUP": Group(a=1, b=2)}`` is the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from yarp_compat.wire.errors import WireError


class Int8(int):
    """An int written in one byte."""

    __slots__ = ()


class Int16(int):
    """An int written in two bytes."""

    __slots__ = ()


class Int64(int):
    """An int written in eight bytes, even if it fits into four."""

    __slots__ = ()


class Float32(float):
    """A float written in four bytes; the object may be more precise."""

    __slots__ = ()


class Vocab(str):
    """A word of up to eight one-byte characters, written as a number of four bytes, or of eight beyond four characters.

    YARP 3 has no eight-byte vocab: only the first four characters are written, as its programs do.
    """

    __slots__ = ()


class DictKey(str):
    """A dict's key that is not a string but ``value`` on the wire; in Python it compares as its text.

    ``value`` is None for an empty list, ``()``: such an entry has neither a key nor values.
    """

    __slots__ = ("value",)
    value: Any

    @classmethod
    def of(cls, value: Any, text: str) -> DictKey:
        """Return the key for a value and its text."""
        key = cls(text)
        key.value = value
        return key


class Group(dict[str, Any]):
    """A dict whose entries are the values of its key in the outer dict."""


class Vocab64(Vocab):
    """A vocab written in eight bytes, even if it fits into four (YARP 4)."""

    __slots__ = ()


@lru_cache(1024)
def vocab32(number: int) -> Vocab | bool:
    """Return the vocab or bool of a number."""
    if number in (0, 0x31):
        return number != 0
    return Vocab(_letters(number.to_bytes(4, "little", signed=True)))


@lru_cache(1024)
def vocab64(number: int) -> Vocab64:
    """Return the vocab of a number."""
    return Vocab64(_letters(number.to_bytes(8, "little", signed=True)))


def _letters(data: bytes) -> str:
    return data.rstrip(b"\0").decode(errors="surrogateescape")


def entries_of(value: dict[Any, Any]) -> list[list[Any]]:
    """Return a dict's entries as lists, as on the wire, sorted by key."""
    wrong = [key for key in value if not isinstance(key, str)]
    if wrong:
        raise WireError(f"the key {wrong[0]!r} of a dict is not a str")
    return [[*_key_of(key), *entry_values(value[key])] for key in sorted(value)]


def _key_of(key: str) -> tuple[Any, ...]:
    """Return a key as on the wire: one value, or none if the key is an empty list."""
    if type(key) is not DictKey:
        return (key,)
    return () if key.value is None else (key.value,)


def merge(into: dict[str, Any], entries: Mapping[str, Any]) -> None:
    """Update a dict. Equal keys are replaced together with their values: the older key may be of another type."""
    for key in entries:
        into.pop(key, None)
    into.update(entries)


def entry_values(entry: Any) -> Sequence[Any]:
    """Return the values of a dict's entry."""
    if isinstance(entry, Group):
        return entries_of(entry)
    return entry if isinstance(entry, tuple) else [entry]


def plain(value: Any) -> Any:
    """Convert an instance of a subclass, or a numpy scalar, to a plain value; raises `WireError` if unsupported."""
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
    raise WireError(f"a Bottle cannot contain {value!r}, which is a {type(value).__name__}")


def _scalar(value: Any) -> Any:
    kind = value.dtype.str[1:]
    types = {"i1": Int8, "u1": Int8, "i2": Int16, "u2": Int16, "i8": Int64, "u8": Int64, "f2": Float32, "f4": Float32}
    return plain(types.get(kind, lambda item: item)(value.item()))


def begun_by_vocab(values: Sequence[Any]) -> Sequence[Any]:
    """Convert the first value of an answer to a vocab if it is a text in brackets (``[many]``, ``[ok]``)."""
    match values:
        case [str(word), *rest] if word.startswith("[") and word.endswith("]"):
            return [Vocab(word[1:-1]), *rest]
    return values
