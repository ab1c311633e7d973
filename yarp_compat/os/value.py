"""One value of a Bottle, with YARP's conversions (`yarp/os/Value.h`, `yarp/os/impl/Storable.h`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from yarp_compat.os.plain import cloned, code_of, cut, integer, plain_of
from yarp_compat.os.searchable import Searchable
from yarp_compat.os.vocab import word_of
from yarp_compat.wire import tags
from yarp_compat.wire.binary import decode_prefix, encode
from yarp_compat.wire.errors import WireError
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, plain_text, rounded
from yarp_compat.wire.values import Float32, Int8, Int16, Int64, Vocab, Vocab64

if TYPE_CHECKING:
    from yarp_compat.os.bottle import Bottle
    from yarp_compat.os.property import Property
    from yarp_compat.wire.reader import Reader
    from yarp_compat.wire.writer import Writer


class Value(Portable, Searchable):
    """A value: an int, a float, a string, a vocab, a blob, a list, a dict, or none (null).

    Conversions never fail: what cannot be converted is 0, 0.0, False or an empty string.

    Args:
        value: what it holds; without it, an empty list.
        vocab: whether the value is a vocab, given by its word or its number.
    """

    def __init__(self, value: Any = (), vocab: bool = False) -> None:
        if isinstance(value, bool):
            value = int(value)  # as YARP's bindings take it; `True` in a list of values is true
        self._value = word_of(value) if vocab else plain_of(value)

    @classmethod
    def of(cls, value: Any) -> Value:
        """The value that stands for a plain one: the same list, not a copy. None is null."""
        made = object.__new__(cls)
        made._value = value
        return made

    @property
    def plain(self) -> Any:
        """The plain Python value; None where it is null."""
        return self._value

    # what it is

    def isNull(self) -> bool:
        """Whether it stands for something that was not found."""
        return self._value is None

    def isBool(self) -> bool:
        """Whether it is true or false."""
        return isinstance(self._value, bool)

    def isInt8(self) -> bool:
        """Whether it is an int of one byte."""
        return isinstance(self._value, Int8)

    def isInt16(self) -> bool:
        """Whether it is an int of two bytes."""
        return isinstance(self._value, Int16)

    def isInt32(self) -> bool:
        """Whether it is an int of four bytes."""
        return type(self._value) is int and -0x80000000 <= self._value <= 0x7FFFFFFF

    def isInt64(self) -> bool:
        """Whether it is an int of eight bytes."""
        value = self._value
        return isinstance(value, Int64) or (type(value) is int and not -0x80000000 <= value <= 0x7FFFFFFF)

    def isFloat32(self) -> bool:
        """Whether it is a float of four bytes."""
        return isinstance(self._value, Float32)

    def isFloat64(self) -> bool:
        """Whether it is a float of eight bytes."""
        return type(self._value) is float

    def isString(self) -> bool:
        """Whether it is a string."""
        return type(self._value) is str

    def isVocab32(self) -> bool:
        """Whether it is a vocab of four bytes, or a truth value, which is one too."""
        return isinstance(self._value, bool) or (isinstance(self._value, Vocab) and not self.isVocab64())

    def isVocab64(self) -> bool:
        """Whether it is a vocab of eight bytes."""
        return isinstance(self._value, Vocab) and (
            type(self._value) is Vocab64 or len(self._value.encode(errors="surrogateescape")) > 4
        )

    def isBlob(self) -> bool:
        """Whether it is a blob."""
        return isinstance(self._value, bytes)

    def isList(self) -> bool:
        """Whether it is a list."""
        return isinstance(self._value, list)

    def isDict(self) -> bool:
        """Whether it is a dict."""
        return isinstance(self._value, dict)

    # what it says

    def asBool(self) -> bool:
        """Whether it is an int or vocab other than 0."""
        return isinstance(self._value, (int, Vocab)) and bool(self._value)

    def asInt8(self) -> int:
        """The number, cut to one byte."""
        return cut(self._number(), 8)

    def asInt16(self) -> int:
        """The number, cut to two bytes."""
        return cut(self._number(), 16)

    def asInt32(self) -> int:
        """The number, cut to four bytes."""
        return cut(self._number(), 32)

    def asInt64(self) -> int:
        """The number, cut to eight bytes."""
        return cut(self._number(), 64)

    def asFloat32(self) -> float:
        """The number, with the digits of four bytes."""
        try:
            return rounded(float(self._number()))
        except WireError:
            return float("inf") if self._number() > 0 else float("-inf")

    def asFloat64(self) -> float:
        """The number."""
        return float(self._number())

    def asString(self) -> str:
        """The string, or the word of a vocab."""
        if type(self._value) is str:
            return self._value
        return plain_text(self._value) if isinstance(self._value, (bool, Vocab)) else ""

    def asVocab32(self) -> int:
        """The number of a vocab, of a string as a vocab, or an int."""
        if isinstance(self._value, (str, bool)):
            return code_of(self._value, 4)
        return cut(self._value, 32) if isinstance(self._value, int) else 0

    def asVocab64(self) -> int:
        """The number of a vocab of eight bytes, of a string as a vocab, or an int."""
        if isinstance(self._value, (str, bool)):
            return code_of(self._value, 8)
        return cut(self._value, 64) if isinstance(self._value, int) else 0

    def asBlob(self) -> bytes | None:
        """The blob; None where it is something else."""
        return self._value if isinstance(self._value, bytes) else None

    def asBlobLength(self) -> int:
        """Bytes of the blob."""
        return len(self._value) if isinstance(self._value, bytes) else 0

    def asList(self) -> Bottle | None:
        """The list itself, as a Bottle that can be changed; None where it is something else."""
        from yarp_compat.os.bottle import Bottle

        return Bottle.of(self._value) if isinstance(self._value, list) else None

    def asDict(self) -> Property | None:
        """The dict itself, as a Property that can be changed; None where it is something else."""
        from yarp_compat.os.property import Property

        return Property.of(self._value) if isinstance(self._value, dict) else None

    def asSearchable(self) -> Bottle | Property | None:
        """The dict or list."""
        return self.asDict() if isinstance(self._value, dict) else self.asList()

    # the rest of YARP's names

    def find(self, key: str) -> Value:
        """The value after a key in the list or dict."""
        inner = self.asSearchable()
        return NULL if inner is None else inner.find(key)

    def findGroup(self, key: str) -> Bottle:
        """The list that begins with a key in the list or dict."""
        from yarp_compat.os.bottle import Bottle

        inner = self.asSearchable()
        return Bottle.getNullBottle() if inner is None else inner.findGroup(key)

    def toString(self) -> str:
        """The text form alone, without quotes or brackets around it."""
        return "" if self._value is None else plain_text(self._value)

    def fromString(self, text: str) -> None:
        """Become the one value that a text says; a string where it says several."""
        self._value = Value.makeValue(text)._value

    def clone(self) -> Value:
        """A copy, with lists of its own."""
        return Value.of(cloned(self._value))

    def getCode(self, profile: Profile = Profile.YARP3) -> int:
        """The tag of its type; a list's with that of its elements; -1 for null."""
        if self._value is None:
            return -1
        data = encode([self._value], profile)
        (tag, first) = (int.from_bytes(data[at : at + 4], "little") for at in (0, 8))
        return tag & tags.UNIT or first

    def isLeaf(self) -> bool:
        """False, as for all values that are not part of YARP's insides."""
        return False

    def isEqual(self, other: Value) -> bool:
        """Whether both have the same text form."""
        return self.toString() == other.toString()

    def notEqual(self, other: Value) -> bool:
        """Whether the text forms differ."""
        return not self.isEqual(other)

    makeInt8 = staticmethod(lambda x: Value.of(Int8(integer(x, 8))))
    makeInt16 = staticmethod(lambda x: Value.of(Int16(integer(x, 16))))
    makeInt32 = staticmethod(lambda x: Value.of(integer(x, 32)))
    makeInt64 = staticmethod(lambda x: Value.of(Int64(integer(x, 64))))
    makeFloat32 = staticmethod(lambda x: Value.of(Float32(x)))
    makeFloat64 = staticmethod(lambda x: Value.of(float(x)))
    makeString = staticmethod(lambda text: Value.of(str(text)))
    makeVocab32 = staticmethod(lambda *word: Value.of(word_of(*word)))
    makeVocab64 = staticmethod(lambda word: Value.of(Vocab64(word)))
    makeList = staticmethod(lambda text="": Value.of(from_text(text)))

    @staticmethod
    def makeBlob(data: bytes | bytearray | memoryview, length: int | None = None) -> Value:
        """A blob of the first ``length`` bytes, or all."""
        return Value.of(bytes(data[:length]))

    @staticmethod
    def makeValue(text: str) -> Value:
        """The one value that a text says; a string where it says several, null where none."""
        values = from_text(text)
        return Value.of(text if len(values) > 1 else values[0] if values else None)

    @staticmethod
    def getNullValue() -> Value:
        """What stands for a value that was not found."""
        return NULL

    # names of YARP 2, which YARP 3 kept for a time
    isInt, asInt, makeInt = isInt32, asInt32, makeInt32
    isDouble, asDouble, makeDouble = isFloat64, asFloat64, makeFloat64
    isVocab, asVocab, makeVocab = isVocab32, asVocab32, makeVocab32

    def _number(self) -> int | float:
        value = self._value
        if isinstance(value, bool):
            return 0x31 if value else 0
        if isinstance(value, (int, float)):
            return value
        return code_of(value, 8 if self.isVocab64() else 4) if isinstance(value, Vocab) else 0

    # on the wire: a list of this one value

    def _write(self, out: Writer) -> None:
        out.block(encode([] if self._value is None else [self._value], out.profile))

    def _read(self, source: Reader) -> None:
        values, end = decode_prefix(source.data, source.profile, source.at)
        if len(values) > 1:
            raise WireError(f"one value was expected, {len(values)} came")
        self._value = values[0] if values else []
        source.at = end

    # Python's names

    def __eq__(self, other: object) -> bool:
        return self.isEqual(other) if isinstance(other, Value) else bool(self._value == other)

    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        return self._value is not None

    def __int__(self) -> int:
        return int(self._number())

    def __float__(self) -> float:
        return float(self._number())

    def __repr__(self) -> str:
        return f"Value({self._value!r})"


NULL = Value.of(None)
"""What stands for a value that was not found."""
