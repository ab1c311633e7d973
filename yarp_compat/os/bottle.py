"""Bottle: a list of values with text and binary forms, YARP's everyday message (`yarp/os/Bottle.h`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from yarp_compat.os.plain import cloned, integer, plain_of
from yarp_compat.os.searchable import Searchable
from yarp_compat.os.value import NULL, Value
from yarp_compat.os.vocab import word_of
from yarp_compat.wire import tags
from yarp_compat.wire.binary import decode, decode_prefix, encode, encode_parts
from yarp_compat.wire.generation import Generation
from yarp_compat.wire.message import Buffer
from yarp_compat.wire.portable import Portable
from yarp_compat.wire.profile import Profile
from yarp_compat.wire.text import from_text, plain_text, to_text
from yarp_compat.wire.values import Float32, Int8, Int16, Int64, Vocab64

if TYPE_CHECKING:
    from yarp_compat.os.property import Property
    from yarp_compat.wire.reader import Reader
    from yarp_compat.wire.writer import Writer

_UNITS = {0: "mixed", tags.INT32: "int", tags.VOCAB32: "vocab", 10: "float", tags.STRING: "string", tags.BLOB: "blob"}


class Bottle(Portable, Searchable):
    """A list of values.

    YARP's way: ``b.addString("x"); b.addFloat64(1.5); b.get(1).asFloat64()``. Python's: ``b = Bottle(["x", 1.5])``,
    ``b[1]``, ``for value in b``, where values are plain ones (`yarp_compat.wire.values`).

    Args:
        content: the text form, another Bottle, or plain values; they are copied.
    """

    def __init__(self, content: str | Bottle | Iterable[Any] = ()) -> None:
        self._values: list[Any] = from_text(content) if isinstance(content, str) else [plain_of(v) for v in content]
        self._null: bool = isinstance(content, Bottle) and content.isNull()
        self._fixed: bool = False

    @classmethod
    def of(cls, values: list[Any]) -> Bottle:
        """The Bottle of these plain values: the same list, not a copy."""
        made = object.__new__(cls)
        made._values, made._null, made._fixed = values, False, False
        return made

    @property
    def plain(self) -> list[Any]:
        """The list of plain values itself."""
        return self._values

    @staticmethod
    def getNullBottle() -> Bottle:
        """What stands for a list that was not found; it cannot be changed."""
        return _NULL

    def isNull(self) -> bool:
        """Whether it stands for a list that was not found."""
        return self._null

    # to add values

    def addInt8(self, x: int) -> None:
        """Add an int of one byte."""
        self._edit().append(Int8(integer(x, 8)))

    def addInt16(self, x: int) -> None:
        """Add an int of two bytes."""
        self._edit().append(Int16(integer(x, 16)))

    def addInt32(self, x: int) -> None:
        """Add an int of four bytes."""
        self._edit().append(integer(x, 32))

    def addInt64(self, x: int) -> None:
        """Add an int of eight bytes."""
        self._edit().append(Int64(integer(x, 64)))

    def addFloat32(self, x: float) -> None:
        """Add a float of four bytes."""
        self._edit().append(Float32(x))

    def addFloat64(self, x: float) -> None:
        """Add a float of eight bytes."""
        self._edit().append(float(x))

    def addString(self, text: str) -> None:
        """Add a string."""
        if not isinstance(text, str):
            raise TypeError(f"{text!r} is no str")
        self._edit().append(str(text))

    def addVocab32(self, word: str | int, *rest: str) -> None:
        """Add a vocab of four bytes, given by its word, its number, or its characters."""
        self._edit().append(word_of(word, *rest))

    def addVocab64(self, word: str) -> None:
        """Add a vocab of eight bytes, which YARP 3 does not have."""
        self._edit().append(Vocab64(word))

    def add(self, value: Any) -> None:
        """Add a Value, or any plain value."""
        self._edit().append(plain_of(value))

    def addList(self) -> Bottle:
        """Add an empty list, and return it to be filled."""
        inner: list[Any] = []
        self._edit().append(inner)
        return Bottle.of(inner)

    def addDict(self) -> Property:
        """Add an empty dict, and return it to be filled."""
        from yarp_compat.os.property import Property

        inner: dict[str, Any] = {}
        self._edit().append(inner)
        return Property.of(inner)

    def append(self, other: Bottle | Iterable[Any]) -> None:
        """Add copies of all values of another Bottle."""
        self._edit().extend([plain_of(value) for value in other])

    def copy(self, other: Bottle, first: int = 0, len: int | None = None) -> None:  # noqa: A002 - YARP's name
        """Become a copy of another Bottle, or of ``len`` values of it from ``first`` on."""
        self._edit()
        self._null = other._null
        self._values[:] = [cloned(value) for value in other._values[first : None if len is None else first + len]]

    def clear(self) -> None:
        """Remove all values."""
        self._edit().clear()

    def pop(self) -> Value:
        """Remove the last value and return it; null where there is none."""
        return Value.of(self._edit().pop()) if self._values else NULL

    # to look at them

    def size(self) -> int:
        """How many values there are."""
        return len(self._values)

    def get(self, index: int) -> Value:
        """The value at a place; null beyond the end."""
        return Value.of(self._values[index]) if 0 <= index < len(self._values) else NULL

    def find(self, key: str) -> Value:
        """The value after a key: the second of the list that begins with it, or what follows it."""
        for at, value in enumerate(self._values):
            nested = isinstance(value, list)
            if _text(value[0] if value else None) == key if nested else _text(value) == key:
                return Bottle.of(value).get(1) if nested else self.get(at + 1)
        return NULL

    def findGroup(self, key: str) -> Bottle:
        """The list that begins with a key; a null Bottle where there is none."""
        for value in self._values:
            nested = isinstance(value, list)
            if _text(value[0] if value else None) == key if nested else _text(value) == key:
                return Bottle.of(value) if nested else _NULL
        return _NULL

    def tail(self) -> Bottle:
        """All values but the first, in a Bottle of their own."""
        made = Bottle(self._values[1:])
        made._null = self._null
        return made

    # text and bytes

    def toString(self) -> str:
        """The text form."""
        return to_text(self._values)

    def fromString(self, text: str) -> None:
        """Become what a text says."""
        self._edit()[:] = from_text(text)

    def toBinary(self, profile: Profile = Profile.YARP3) -> bytes:
        """The bytes that ports send."""
        return encode(self._values, profile)

    def fromBinary(self, data: Buffer, length: int | None = None, profile: Profile | None = None) -> None:
        """Become what bytes say.

        Raises:
            WireError: they are no Bottle.
        """
        self.from_wire(memoryview(data)[:length], profile)

    def to_wire(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> list[Buffer]:  # noqa: ARG002
        """The bytes in pieces, large blobs uncopied."""
        return encode_parts(self._values, profile)

    def to_bytes(self, profile: Profile = Profile.YARP3, generation: Generation | None = None) -> bytes:  # noqa: ARG002
        """The bytes in one piece."""
        return encode(self._values, profile)

    def from_wire(self, data: Buffer, profile: Profile | None = None) -> None:
        """Become what a whole payload says.

        Raises:
            WireError: it is no Bottle; this one stays as it was.
        """
        self._edit()[:] = decode(data, profile)

    def to_values(self) -> list[Any]:
        """Copies of the plain values."""
        return [cloned(value) for value in self._values]

    def from_values(self, values: Iterable[Any]) -> None:
        """Become these values."""
        self._edit()[:] = [plain_of(value) for value in values]

    def to_text(self) -> str:
        """The text form."""
        return self.toString()

    def from_text(self, line: str) -> None:
        """Become what a text says."""
        self.fromString(line)

    def _write(self, out: Writer) -> None:
        for part in encode_parts(self._values, out.profile):
            out.block(part)

    def _read(self, source: Reader) -> None:
        self._edit()[:], source.at = decode_prefix(source.data, source.profile, source.at)

    # the rest of YARP's names

    def isEqual(self, other: Bottle) -> bool:
        """Whether both have the same text form."""
        return self.toString() == other.toString()

    def notEqual(self, other: Bottle) -> bool:
        """Whether the text forms differ."""
        return not self.isEqual(other)

    def getSpecialization(self) -> int:
        """The tag of all values, where they have the same (YARP 3's)."""
        return int.from_bytes(encode(self._values, Profile.YARP3)[:4], "little") & tags.UNIT

    @staticmethod
    def describeBottleCode(code: int) -> str:
        """What a tag means, in words."""
        unit = _UNITS.get(code & ~(tags.LIST | tags.DICT), "unknown")
        return f"list of {unit}" if code & tags.LIST else f"dict of {unit}" if code & tags.DICT else unit

    def setReadOnly(self, readOnly: bool) -> None:
        """Refuse changes, or allow them again."""
        self._fixed = readOnly

    def hasChanged(self) -> None:
        """Nothing to do: the bytes are made when they are needed."""

    def onCommencement(self) -> None:
        """Nothing to do: the bytes are made when they are needed."""

    # names of YARP 2, which YARP 3 kept for a time
    addInt, addDouble, addVocab = addInt32, addFloat64, addVocab32

    # Python's names

    def __len__(self) -> int:
        return len(self._values)

    def __iter__(self) -> Iterator[Any]:
        return iter(self._values)

    def __getitem__(self, index: int | slice) -> Any:
        return self._values[index]

    def __setitem__(self, index: int, value: Any) -> None:
        self._edit()[index] = plain_of(value)

    def __delitem__(self, index: int | slice) -> None:
        del self._edit()[index]

    def __eq__(self, other: object) -> bool:
        return self._values == (other._values if isinstance(other, Bottle) else other)

    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        return not self._null

    def __repr__(self) -> str:
        return f"Bottle({self.toString()!r})"

    def _edit(self) -> list[Any]:
        if self._fixed:
            raise RuntimeError("this Bottle cannot be changed: it is read-only, or stands for one that was not found")
        self._null = False
        return self._values


def _text(value: Any) -> str:
    return value if type(value) is str else "" if value is None else plain_text(value)


_NULL = Bottle()
_NULL._null = _NULL._fixed = True
