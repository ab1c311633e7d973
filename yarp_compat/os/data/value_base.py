"""The plain Python values inside Value, Bottle and Property, and the base class of `Value`."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from yarp_compat.overriding import override
from yarp_compat.wire import tags
from yarp_compat.wire.accessors import always
from yarp_compat.wire.binary import decode, decode_prefix, encode
from yarp_compat.wire.elements import ElementReader, ElementWriter
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import plain_text, rounded
from yarp_compat.wire.values import Float32, Group, Int8, Int16, Int64, plain, vocab32
from yarp_compat.wire.values import Vocab as Word
from yarp_compat.wire.values import Vocab64 as Word64

_HALF = 1 << 31
_LEAVES = frozenset({int, float, str, bool, bytes, Int8, Int16, Int64, Float32, Word, Word64})


def plain_of(value: Any) -> Any:
    """Return a deep copy of an object for a Bottle, as a plain value; raises `WireError` for unsupported types."""
    if type(value) in _LEAVES:
        return value
    value = getattr(value, "plain", value)  # for a Value, a Bottle or a Property
    if isinstance(value, dict):
        copy = {key: tuple(map(plain_of, i)) if isinstance(i, tuple) else plain_of(i) for key, i in value.items()}
        return Group(copy) if isinstance(value, Group) else copy
    if isinstance(value, (list, tuple)):
        return [plain_of(item) for item in value]
    if getattr(value, "ndim", 0):  # a numpy array: the numbers keep their types
        return decode(encode(value, Profile.YARP4), Profile.YARP4)
    value = plain(value)
    return plain_of(value) if isinstance(value, list) else value


def deep_copy(value: Any) -> Any:
    """Return a deep copy of a plain value."""
    return value if value is None or type(value) in _LEAVES else plain_of(value)


def integer(value: Any, bits: int) -> int:
    """Return the value as an int; raises `TypeError` if it is not one, `OverflowError` if it does not fit."""
    number = operator.index(value)
    if not -(1 << bits - 1) <= number < 1 << bits - 1:
        raise OverflowError(f"{number} does not fit into {bits} bits")
    return int(number)


def truncate(value: float, bits: int) -> int:
    """Return the lowest bits of a number, as a C++ cast does; floats out of range become the smallest int."""
    if isinstance(value, float):
        smallest = -(1 << max(bits, 32) - 1)
        value = int(value) if math.isfinite(value) and smallest <= value < -smallest else smallest
    half = 1 << bits - 1
    return (value + half & 2 * half - 1) - half


def code_of(word: str | bool, size: int) -> int:
    """Return the number of a vocab, or of a string used as one."""
    if isinstance(word, bool):
        return 0x31 if word else 0
    return int.from_bytes(word.encode(errors="surrogateescape")[:size].ljust(size, b"\0"), "little", signed=True)


def word_of(number: int | str, *rest: str) -> Word | bool:
    """Return the vocab of a number, a word, or a word's characters."""
    if isinstance(number, str):
        number = code_of("".join((number, *rest)), 4)
    return vocab32(truncate(number, 32))


def _is_long(word: Word) -> bool:
    return type(word) is Word64 or len(word.encode(errors="surrogateescape")) > 4


def _whether(check: Callable[[Any], bool], doc: str) -> Callable[[ValueBase], bool]:
    def is_kind(self: ValueBase) -> bool:
        return check(self._value)

    is_kind.__doc__ = doc
    return is_kind


def _truncated_to(bits: int, doc: str) -> Callable[[ValueBase], int]:
    def as_int(self: ValueBase) -> int:
        return truncate(self._number(), bits)

    as_int.__doc__ = doc
    return as_int


def _vocab_of(size: int, doc: str) -> Callable[[ValueBase], int]:
    def as_vocab(self: ValueBase) -> int:
        if isinstance(self._value, (str, bool)):
            return code_of(self._value, size)
        return truncate(self._value, 8 * size) if isinstance(self._value, int) else 0

    as_vocab.__doc__ = doc
    return as_vocab


class ValueBase(Portable):
    """The type checks and conversions of a `Value`; conversions never fail."""

    _value: Any

    isNull = _whether(lambda v: v is None, "Whether it represents a missing value.")
    isBool = _whether(lambda v: isinstance(v, bool), "Whether it is true or false.")
    isInt8 = _whether(lambda v: isinstance(v, Int8), "Whether it is an int of one byte.")
    isInt16 = _whether(lambda v: isinstance(v, Int16), "Whether it is an int of two bytes.")
    isInt32 = _whether(lambda v: type(v) is int and -_HALF <= v < _HALF, "Whether it is an int of four bytes.")
    isInt64 = _whether(
        lambda v: isinstance(v, Int64) or (type(v) is int and not -_HALF <= v < _HALF),
        "Whether it is an int of eight bytes.",
    )
    isFloat32 = _whether(lambda v: isinstance(v, Float32), "Whether it is a float of four bytes.")
    isFloat64 = _whether(lambda v: type(v) is float, "Whether it is a float of eight bytes.")
    isString = _whether(lambda v: type(v) is str, "Whether it is a string.")
    isVocab32 = _whether(
        lambda v: isinstance(v, bool) or (isinstance(v, Word) and not _is_long(v)),
        "Whether it is a vocab of four bytes, or a bool, which is one too.",
    )
    isVocab64 = _whether(lambda v: isinstance(v, Word) and _is_long(v), "Whether it is a vocab of eight bytes.")
    isBlob = _whether(lambda v: isinstance(v, bytes), "Whether it is a blob.")
    isList = _whether(lambda v: isinstance(v, list), "Whether it is a list.")
    isDict = _whether(lambda v: isinstance(v, dict), "Whether it is a dict.")

    # YARP 2's names, which early releases of YARP 3 still had
    isInt, isDouble, isVocab = isInt32, isFloat64, isVocab32

    def asBool(self) -> bool:
        """Return whether it is an int or vocab other than 0."""
        return isinstance(self._value, (int, Word)) and bool(self._value)

    asInt8 = _truncated_to(8, "The number, truncated to one byte.")
    asInt16 = _truncated_to(16, "The number, truncated to two bytes.")
    asInt32 = _truncated_to(32, "The number, truncated to four bytes.")
    asInt64 = _truncated_to(64, "The number, truncated to eight bytes.")

    def asFloat32(self) -> float:
        """Return the number, rounded to a float of four bytes; infinite if it is too large, 0.0 for other types."""
        try:
            return rounded(float(self._number()))
        except WireError:
            return float("inf") if self._number() > 0 else float("-inf")

    def asFloat64(self) -> float:
        """Return the number as a float; 0.0 for other types."""
        return float(self._number())

    def asString(self) -> str:
        """Return the string, or the word of a vocab; "" for other types."""
        if type(self._value) is str:
            return self._value
        return plain_text(self._value) if isinstance(self._value, (bool, Word)) else ""

    asVocab32 = _vocab_of(4, "The number of a vocab, of a string as a vocab, or an int.")
    asVocab64 = _vocab_of(8, "The number of a vocab of eight bytes, of a string as a vocab, or an int.")
    asInt, asDouble, asVocab = asInt32, asFloat64, asVocab32

    def asBlob(self) -> bytes | None:
        """Return the blob; None for other types."""
        return self._value if isinstance(self._value, bytes) else None

    def asBlobLength(self) -> int:
        """Return the length of the blob in bytes; 0 for other types."""
        return len(self._value) if isinstance(self._value, bytes) else 0

    def toString(self) -> str:
        """Return the text form, without quotes or brackets around it."""
        return "" if self._value is None else plain_text(self._value)

    def getCode(self, profile: Profile = Profile.YARP3) -> int:
        """Return the tag of the value's type, for a list combined with the tag of its elements; -1 for null."""
        if self._value is None:
            return -1
        data = encode([self._value], profile)
        (tag, first) = (int.from_bytes(data[at : at + 4], "little") for at in (0, 8))
        return tag & tags.UNIT or first

    isLeaf = always(False, "False: only YARP's internal values are leaves.")

    def _number(self) -> int | float:
        value = self._value
        if isinstance(value, bool):
            return 0x31 if value else 0
        if isinstance(value, (int, float)):
            return value
        return code_of(value, 8 if _is_long(value) else 4) if isinstance(value, Word) else 0

    # on the wire: a list of this one value

    @override
    def _write(self, out: ElementWriter) -> None:
        out.block(encode([] if self._value is None else [self._value], out.profile))

    @override
    def _read(self, source: ElementReader) -> None:
        values, end = decode_prefix(source.data, source.profile, source.at)
        if len(values) > 1:
            raise WireError(f"expected one value, received {len(values)}")
        self._value = values[0] if values else []
        source.at = end

    def __bool__(self) -> bool:
        return self._value is not None

    def __int__(self) -> int:
        return int(self._number())

    def __float__(self) -> float:
        return float(self._number())
